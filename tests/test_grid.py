"""Cells, metres and degrees agree with each other and with pyproj."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygain.grid import Grid
from skygain.ground.errors import InputError

grids = st.builds(
    Grid,
    shape=st.tuples(st.integers(1, 50), st.integers(1, 50)),
    spacing_m=st.floats(0.5, 50),
    origin_m=st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
)


@given(grids, st.integers(-100, 100), st.integers(-100, 100))
def test_cell_centre_lies_in_its_cell(grid: Grid, row: int, col: int) -> None:
    assert grid.cells_at(grid.xy_m((row, col))).tolist() == [row, col]


def test_rows_grow_to_the_north_and_columns_to_the_east() -> None:
    grid = Grid((3, 4), 4.0, (10.0, 20.0))
    assert grid.xy_m((1, 0)).tolist() == [10.0, 24.0]
    assert grid.xy_m((0, 1)).tolist() == [14.0, 20.0]
    assert grid.bounds_m == (8.0, 18.0, 24.0, 30.0)


@given(grids)
def test_flat_index_matches_raveled_order(grid: Grid) -> None:
    assert (grid.flat(grid.cells) == np.arange(grid.size)).all()


def test_contains_is_false_just_outside() -> None:
    grid = Grid((3, 4), 4.0)
    assert grid.contains([(0, 0), (2, 3), (3, 0), (0, 4), (-1, 0)]).tolist() == [
        True,
        True,
        False,
        False,
        False,
    ]


def test_crop_keeps_coordinates() -> None:
    grid = Grid((10, 10), 4.0, (3.0, 3.0))
    assert np.allclose(grid.cropped(2, 5, (3, 3)).xy_m((1, 1)), grid.xy_m((3, 6)))


def test_crop_that_does_not_fit_says_so() -> None:
    with pytest.raises(InputError, match="smaller crop"):
        Grid((10, 10), 4.0).cropped(8, 0, (3, 3))


def test_degrees_round_trip_and_agree_with_pyproj() -> None:
    pyproj = pytest.importorskip("pyproj")
    grid = Grid((100, 100), 4.0, (689_000.0, 3_985_000.0), crs="EPSG:32617")
    cells = np.array([(0, 0), (99, 3), (50, 99)])
    latlon = grid.latlon(cells)
    assert (grid.cells_at_latlon(latlon) == cells).all()
    lon, lat = pyproj.Proj("EPSG:32617")(*grid.xy_m(cells).T, inverse=True)
    assert np.allclose(latlon, np.stack([lat, lon], axis=-1), atol=1e-7)


def test_local_grid_has_no_latitudes() -> None:
    with pytest.raises(InputError, match="georeferenced"):
        Grid((2, 2), 4.0).latlon((0, 0))
