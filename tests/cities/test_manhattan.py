"""Manhattan cities: the protocol's layout, whatever the seed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
from skygain.city import Building, City
from skygain.ground.errors import InputError
from skygain.scenario import check_transmitter

seeds = st.integers(0, 2**63)


def edges(city: City) -> np.ndarray:
    """``[building, (west, south, east, north)]``."""
    return np.array([[*b.footprint_m[0], *b.footprint_m[2]] for b in city.buildings])


def test_grid_is_the_protocols() -> None:
    grid = manhattan_city(0).grid
    assert grid.shape == (121, 121)
    np.testing.assert_array_equal(grid.x_m, 3 + 4 * np.arange(121))
    np.testing.assert_array_equal(grid.y_m, 3 + 4 * np.arange(121))
    assert grid.crs is None


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_buildings_neither_overlap_nor_leave_the_square(seed: int) -> None:
    e = edges(manhattan_city(seed))
    assert (e[:, :2] > 0).all()
    assert (e[:, 2:] < 486).all()
    assert (e[:, :2] < e[:, 2:]).all()
    low = np.maximum(e[:, None, :2], e[None, :, :2])
    high = np.minimum(e[:, None, 2:], e[None, :, 2:])
    overlap = np.prod(np.maximum(high - low, 0), axis=-1)
    assert np.triu(overlap, 1).max() == 0


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_four_streets_cross_the_square_each_way(seed: int) -> None:
    """No building stands in the four streets at least 11.75 m wide (12 m, less the rounding of
    corners) in x, nor in y."""
    e = edges(manhattan_city(seed))
    for axis in (0, 1):
        order = np.argsort(e[:, axis])
        reach = np.maximum.accumulate(e[order, axis + 2])
        gaps = e[order, axis][1:] - reach[:-1]
        assert (
            gaps >= 11.75
        ).sum() >= 4 - 1  # an entirely open row of blocks merges two streets into one wide gap


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_raster_says_what_the_polygons_say(seed: int) -> None:
    city = manhattan_city(seed)
    x, y = city.grid.x_m[None, :, None], city.grid.y_m[:, None, None]
    e = edges(city)
    inside = (x > e[:, 0]) & (x < e[:, 2]) & (y > e[:, 1]) & (y < e[:, 3])  # [row, col, building]
    heights = np.array([b.height_m for b in city.buildings])
    np.testing.assert_array_equal(
        city.height_m, np.where(inside.any(-1), heights[inside.argmax(-1)], 0)
    )
    assert 0.15 < (city.height_m > 0).mean() < 0.55
    assert heights.min() >= 8 - 0.125
    assert heights.max() <= 48 + 0.125


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_no_wall_runs_through_a_cell_centre_and_storage_is_exact(seed: int) -> None:
    city = manhattan_city(seed)
    e, heights = edges(city), np.array([b.height_m for b in city.buildings])
    assert not np.isin(e, city.grid.x_m).any()
    np.testing.assert_array_equal(e, e.astype(np.float32))
    np.testing.assert_array_equal(heights, heights.astype(np.float16))
    assert not np.isin(heights, np.arange(60)).any()


def test_a_seed_is_a_city_whatever_came_before() -> None:
    first = manhattan_city(11)
    manhattan_city(np.random.default_rng(3))
    again = manhattan_city(11)
    assert first.height_m.tobytes() == again.height_m.tobytes()
    assert edges(first).tobytes() == edges(again).tobytes()
    assert manhattan_city(12).height_m.tobytes() != first.height_m.tobytes()


def test_a_generator_draws_one_city_after_another() -> None:
    a, b = np.random.default_rng(5), np.random.default_rng(5)
    cities = [manhattan_city(a), manhattan_city(a), manhattan_city(b)]
    assert cities[0].height_m.tobytes() == cities[2].height_m.tobytes()
    assert cities[0].height_m.tobytes() != cities[1].height_m.tobytes()


def test_open_share_one_leaves_an_empty_city() -> None:
    city = manhattan_city(1, ManhattanConfig(open_block_share=1.0))
    assert not city.buildings
    assert not city.height_m.any()
    assert len(transmitter_sites(city)) == 25


@pytest.mark.parametrize(
    "change",
    [
        {"spacing_m": 0.0},
        {"spacing_m": float("nan")},
        {"spacing_m": 0.01},
        {"blocks": 0},
        {"max_lots": 0},
        {"street_width_m": 97.0},
        {"street_width_m": -1.0},
        {"block_variation": 1.0},
        {"open_lot_share": 1.5},
        {"building_share": (0.9, 0.5)},
        {"height_range_m": (-3.0, 5.0)},
        {"extent_m": float("inf")},
    ],
)
def test_impossible_configurations_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError):
        replace(ManhattanConfig(), **change)


def test_negative_seed_is_refused() -> None:
    with pytest.raises(InputError, match="seed"):
        manhattan_city(-1)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_sites_are_outdoor_points_of_the_lattice(seed: int) -> None:
    city = manhattan_city(seed)
    sites = transmitter_sites(city)
    lattice = [48.6, 145.8, 243.0, 340.2, 437.4]
    assert np.isclose(sites[:, :2, None], lattice).any(-1).all()
    assert (sites[:, 2] == 1.5).all()
    assert len(np.unique(sites, axis=0)) == len(sites)
    e = edges(city)
    x, y = sites[:, :1], sites[:, 1:2]
    assert not (
        (x > e[:, 0] - 0.3) & (x < e[:, 2] + 0.3) & (y > e[:, 1] - 0.3) & (y < e[:, 3] + 0.3)
    ).any()
    for site in sites:
        check_transmitter(city, tuple(site))  # a scenario accepts it


def test_a_courtyard_is_outdoors() -> None:
    empty = manhattan_city(1, ManhattanConfig(open_block_share=1.0))
    ring = np.array([[200.0, 200.0], [290.0, 200.0], [290.0, 290.0], [200.0, 290.0]])
    court = np.array([[230.0, 230.0], [230.0, 260.0], [260.0, 260.0], [260.0, 230.0]])
    for holes, sites in (((), 24), ((court,), 25)):
        city = replace(empty, buildings=(Building(ring, 20.0, holes_m=holes),))
        assert len(transmitter_sites(city)) == sites
    bridge = replace(empty, buildings=(Building(ring, 20.0, base_m=5.0),))
    assert len(transmitter_sites(bridge)) == 25


def test_statistics_are_those_of_the_first_data_set(shared_data: Path) -> None:
    """Built share, number, size and height of buildings over 300 cities, against version 0 of the
    data set."""
    xr, zarr = pytest.importorskip("xarray"), pytest.importorskip("zarr")
    store = zarr.storage.ZipStore(shared_data / "manhattan-v0.zarr.zip", mode="r")
    with xr.open_zarr(store, consolidated=False) as data:
        theirs = data.building.values.astype(float)
        their_share = (data.height_m.values > 0).mean()
    cities = [manhattan_city(seed) for seed in range(300)]
    ours = np.concatenate([np.c_[edges(c), [b.height_m for b in c.buildings]] for c in cities])
    their_count = np.isfinite(theirs[..., 0]).sum(axis=1).mean()
    theirs = theirs[np.isfinite(theirs[..., 0])]
    assert np.mean([(c.height_m > 0).mean() for c in cities]) == pytest.approx(
        their_share, abs=0.01
    )
    assert np.mean([len(c.buildings) for c in cities]) == pytest.approx(their_count, abs=2.5)
    percent = [5, 25, 50, 75, 95]
    for measure in (lambda b: b[:, 2] - b[:, 0], lambda b: b[:, 3] - b[:, 1], lambda b: b[:, 4]):
        np.testing.assert_allclose(
            np.percentile(measure(ours), percent),
            np.percentile(measure(theirs), percent),
            rtol=0.05,
        )
