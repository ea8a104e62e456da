"""One name for every kind of city."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skygain.cities import central_crop, manhattan_city, open_city, random_crop, read_city
from skygain.cities.raster import save_heights
from skygain.ground.errors import InputError


@pytest.mark.parametrize("spec", [7, "7", "manhattan:7", "manhattan-7", " 7 "])
def test_seeds(spec: str | int) -> None:
    city = open_city(spec)
    assert city.name == "manhattan-7"
    np.testing.assert_array_equal(city.height_m, manhattan_city(7).height_m)


def test_spacing_of_a_seed() -> None:
    assert open_city("7", spacing_m=2.0).grid.shape == (243, 243)


def test_files_by_their_ending(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    save_heights(manhattan_city(2), tmp_path / "M.TIFF")
    assert open_city(str(tmp_path / "M.TIFF")).name == "M"
    coarse = read_city(str(tmp_path / "M.TIFF"), spacing_m=8.0)
    assert coarse.city.grid.spacing_m == 8
    assert str(coarse).startswith("M: ")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("atlantis", "names no city; give a seed .*munich"),
        ("city.xyz", "names no city"),
        ("-3", "names no city"),
        ("", "names no city"),
        ("absent.tif", "no file"),
        ("absent.osm.pbf", "no file"),
    ],
)
def test_what_is_no_city(spec: str, message: str) -> None:
    pytest.importorskip("pyogrio")
    with pytest.raises(InputError, match=message):
        open_city(spec)


def test_options_that_mean_nothing_are_refused() -> None:
    with pytest.raises(InputError, match="crs does not apply"):
        open_city("7", crs="EPSG:4326")
    with pytest.raises(InputError, match="layer does not apply"):
        open_city("a.tif", layer="x")


def test_crops() -> None:
    city = manhattan_city(3)
    middle = central_crop(city, (96, 97))
    np.testing.assert_array_equal(middle.height_m, city.height_m[12:108, 12:109])
    assert middle.grid.origin_m == (51.0, 51.0)
    crops = [random_crop(city, (96, 96), np.random.default_rng(s), rebase=True) for s in (1, 1, 2)]
    assert crops[0].height_m.tobytes() == crops[1].height_m.tobytes()
    assert crops[0].height_m.tobytes() != crops[2].height_m.tobytes()
    assert crops[0].grid.origin_m == (0.0, 0.0)
    assert random_crop(city, (121, 121), np.random.default_rng(0)).grid == city.grid
    for shape in ((122, 10), (0, 5)):
        with pytest.raises(InputError, match="does not fit"):
            central_crop(city, shape)
        with pytest.raises(InputError, match="does not fit"):
            random_crop(city, shape, np.random.default_rng(0))


def test_import_loads_nothing_heavy() -> None:
    """A seed needs neither the geo extra nor the ray tracer."""
    code = (
        "import sys, skygain.cities as c; c.open_city('7');"
        "print(sorted({m.split('.')[0] for m in sys.modules} & "
        "{'rasterio','pyproj','pyogrio','shapely','sionna','mitsuba','torch'}))"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )
