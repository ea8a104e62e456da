"""`skygain inspect`: what a file holds and how it would be read."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from skygain.app.inspection import run_inspect
from skygain.app.requests import InspectRequest
from skygain.ground.errors import InputError, MissingExtraError

pytest.importorskip("rasterio")
pytest.importorskip("pyogrio")

DATA = Path(__file__).parents[1] / "cities" / "data"


def test_a_city_is_told_and_drawn(tmp_path: Path) -> None:
    text = run_inspect(
        InspectRequest(file=str(DATA / "nyc_heightroof.geojson"), picture=tmp_path / "c.png")
    )
    assert "6 of 6 buildings without a height" in text
    assert "|@@" in text
    assert (tmp_path / "c.png").stat().st_size > 1000


def test_what_is_refused_is_told_with_the_option() -> None:
    text = run_inspect(InspectRequest(file=str(DATA / "dsm_600.tif")))
    assert "band 1: float32" in text
    assert "give `terrain`" in text.splitlines()[-1]


def test_a_log_is_told_as_readings(tmp_path: Path) -> None:
    lines = [f"48.2{i:03d},16.37,{-70 - i}" for i in range(20)]
    (tmp_path / "log.csv").write_text("\n".join(["lat,lon,rsrp", *lines]))
    text = run_inspect(InspectRequest(file=str(tmp_path / "log.csv")))
    assert "20 readings from -89.0 to -70.0 dBm" in text
    assert "level from 'rsrp'" in text


def test_a_log_of_two_cells_is_shown_with_the_choice(tmp_path: Path) -> None:
    """No refusal: the columns, their values, and what to choose."""
    rows = [f"48.2{i:03d},16.37,{pci},{-70 - i}" for i in range(20) for pci in (101, 257)]
    (tmp_path / "log.csv").write_text("\n".join(["lat,lon,pci,rsrp", *rows]))
    lines = run_inspect(InspectRequest(file=str(tmp_path / "log.csv"))).splitlines()
    assert "  40 lines, 4 columns" in lines
    assert "  'pci': 101 (20), 257 (20)" in lines
    assert "  'rsrp' (level): -89 to -70, 20 values" in lines
    assert "it cannot be read as it stands" in lines[-1]
    assert "`where=pci=101`" in lines[-1]
    chosen = InspectRequest(file=str(tmp_path / "log.csv"), where={"pci": "101"})
    assert "read as 20 readings" in run_inspect(chosen)


def test_a_log_without_a_known_level_shows_its_columns(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("lat,lon,quality\n48.2,16.37,9\n48.3,16.37,\n")
    text = run_inspect(InspectRequest(file=str(tmp_path / "log.csv")))
    assert "'quality': empty (1), 9 (1)" in text
    assert "`columns=level=NAME`" in text


def test_points_are_readings_not_buildings(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    shapely = pytest.importorskip("shapely")
    rows = [{"rsrp": -70.0 - i, "geometry": shapely.Point(16.37, 48.2 + i / 1e3)} for i in range(9)]
    geopandas.GeoDataFrame(rows, geometry="geometry", crs=4326).to_file(tmp_path / "p.geojson")
    text = run_inspect(InspectRequest(file=str(tmp_path / "p.geojson")))
    assert "read as 9 readings" in text


@pytest.mark.parametrize(("name", "package"), [("a.geojson", "pyogrio"), ("a.tif", "rasterio")])
def test_a_package_that_is_not_there_is_asked_for_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str
) -> None:
    (tmp_path / name).write_bytes(b"{}")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=f"{package}.*install it with"):
        run_inspect(InspectRequest(file=str(tmp_path / name)))


def test_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="no file"):
        run_inspect(InspectRequest(file="absent.geojson"))
