"""One name for every kind of city."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skygain.cities import manhattan_city, open_city, read_city
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
    with pytest.raises(InputError, match="`crs` does not apply"):
        open_city("7", crs="EPSG:4326")
    with pytest.raises(InputError, match="`terrain` does not apply"):
        open_city("7", terrain="none")


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
