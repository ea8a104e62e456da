"""What a file holds is told without a flight, also where it cannot be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skygain.cities.inspection import inspected, picture, terminal_map
from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError

DATA = Path(__file__).parent / "data"


def test_a_readable_file_is_told_with_its_reading() -> None:
    pytest.importorskip("pyogrio")
    lines, reading = inspected(DATA / "nyc_heightroof.geojson")
    text = "\n".join(lines)
    assert reading is not None
    for said in ("heightroof", "6 of Polygon", "EPSG:32633", "6 of 6 buildings without a height"):
        assert said in text


def test_a_file_that_is_refused_is_told_all_the_same() -> None:
    pytest.importorskip("rasterio")
    lines, reading = inspected(DATA / "dsm_600.tif")
    assert reading is None
    assert any("band 1: float32, 600 to 623" in line for line in lines)
    assert "give `terrain`" in lines[-1]
    lines, reading = inspected(DATA / "dsm_polder.tif")
    assert any("ground -4.5 to -4.5 m" in line for line in lines)


@pytest.mark.parametrize("name", ["overpass.json", "tile.city.json", "city.fgb", "city.kml"])
def test_formats_that_gdal_does_not_list(name: str) -> None:
    pytest.importorskip("pyogrio")
    _, reading = inspected(DATA / name)
    assert reading is not None


def test_nothing_there_is_an_error() -> None:
    with pytest.raises(InputError, match="no file"):
        inspected("absent.tif")


def test_the_map_has_north_up_and_the_highest_darkest() -> None:
    height = np.zeros((8, 16), np.float32)
    height[6:, 12:] = 30.0
    height[:2, :4] = 3.0
    lines = terminal_map(City(Grid((8, 16), 4.0), height)).splitlines()
    assert lines[0] == lines[-1] == "+" + "-" * 16 + "+"
    assert lines[1] == "|            @@@@|"
    assert lines[-2] == "|....            |"
    assert len(lines) == 2 + 4


def test_the_picture_is_a_png(tmp_path: Path) -> None:
    ground = np.arange(64, dtype=float).reshape(8, 8)
    picture(City(Grid((8, 8), 4.0), np.eye(8) * 9, ground_m=ground), tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="cannot write"):
        picture(City(Grid((8, 8), 4.0), np.eye(8)), tmp_path / "none" / "c.png")
