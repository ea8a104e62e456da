"""What a survey writes can be read back by the libraries others use, at the right place and the
right way up."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygain.grid import Grid
from skygain.ground.errors import install_command
from skygain.ground.strict_json import json_text, plain
from skygain.reports.export import (
    write_measurements_csv,
    write_radio_map_nc,
    write_radio_map_tif,
    write_results_json,
)
from skygain.reports.geotiff import write_geotiff
from skygain.reports.outcome import Outcome
from skygain.reports.scales import gain_limits

UTM = "EPSG:32617"
HOSTILE = "</script><b>\"'&\x00\ud800 \u2028{{data}} ${x} 東京"

Make = Callable[..., Outcome]


def strict(text: str) -> Any:
    """Parse JSON, refusing the NaN and Infinity that Python would let pass."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def test_readings_survive_the_csv_bit_by_bit(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome()
    assert write_measurements_csv(outcome, tmp_path / "m.csv") is None
    with (tmp_path / "m.csv").open() as file:
        rows = list(csv.DictReader(file))
    readings = outcome.result.measurements
    assert list(rows[0]) == [
        "x_m",
        "y_m",
        "row",
        "col",
        "gain_db",
        "noise_std_db",
        "time_s",
        "uav",
        "censored",
    ]
    assert [float(row["gain_db"]) for row in rows] == readings.gain_db.tolist()
    assert [[int(row["row"]), int(row["col"])] for row in rows] == readings.cell.tolist()
    assert [int(row["uav"]) for row in rows] == readings.uav.tolist()
    xy_m = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    assert (outcome.grid.cells_at(xy_m) == readings.cell).all()


def test_latitudes_lead_back_to_the_cells(make_outcome: Make, tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    outcome = make_outcome(crs=UTM)
    write_measurements_csv(outcome, tmp_path / "m.csv")
    with (tmp_path / "m.csv").open() as file:
        latlon = [[float(row["lat"]), float(row["lon"])] for row in csv.DictReader(file)]
    assert np.allclose(
        outcome.grid.xy_m_at_latlon(latlon),
        outcome.grid.xy_m(outcome.result.measurements.cell),
        atol=0.01,
    )


def test_a_survey_can_be_replayed_from_its_own_csv(make_outcome: Make, tmp_path: Path) -> None:
    from skygain.instruments import on_grid, read_recording

    outcome = make_outcome()
    write_measurements_csv(outcome, tmp_path / "m.csv")
    again = on_grid(read_recording(tmp_path / "m.csv"), outcome.grid)
    readings = outcome.result.measurements
    truth = {
        tuple(cell): gain
        for cell, gain in zip(readings.cell.tolist(), readings.gain_db, strict=True)
    }
    assert {
        tuple(cell): level for cell, level in zip(again.cell.tolist(), again.level_db, strict=True)
    } == pytest.approx(truth)


def test_power_stays_power(make_outcome: Make, tmp_path: Path) -> None:
    from dataclasses import replace

    import xarray as xr

    from skygain.instruments import read_recording

    outcome = replace(make_outcome(crs=None), level_label="received power in dBm")
    write_measurements_csv(outcome, tmp_path / "m.csv")
    again = read_recording(tmp_path / "m.csv")
    assert (again.quantity, again.columns["level"]) == ("power", "power_dbm")
    write_radio_map_nc(outcome, tmp_path / "m.nc")
    with xr.open_dataset(tmp_path / "m.nc", engine="h5netcdf") as dataset:
        assert dataset.mean_dbm.attrs == {"units": "dBm", "long_name": "estimated received power"}
        assert dataset.std_db.attrs["units"] == "dB"
        assert "mean_db" not in dataset


@pytest.mark.parametrize("crs", [None, UTM])
def test_the_geotiff_answers_at_the_metres_of_a_cell(
    make_outcome: Make, tmp_path: Path, crs: str | None
) -> None:
    rasterio = pytest.importorskip("rasterio")
    outcome = make_outcome(crs=crs)
    assert write_radio_map_tif(outcome, tmp_path / "map.tif") is None
    # no side files but the style
    assert {path.name for path in tmp_path.iterdir()} == {"map.tif", "map.qml"}
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.descriptions == ("mean_db", "std_db", "measured")
        assert raster.crs == (None if crs is None else rasterio.crs.CRS.from_string(crs))
        assert tuple(raster.bounds) == outcome.grid.bounds_m
        assert raster.transform.e < 0  # north is up
        assert np.isnan(raster.nodata)
        values = np.array(list(raster.sample(outcome.grid.xy_m(outcome.grid.cells)))).reshape(
            *outcome.grid.shape, 3
        )
    outdoor = outcome.scenario.outdoor
    assert np.isnan(values[~outdoor][:, :2]).all()
    assert np.allclose(values[outdoor][:, 0], outcome.posterior.mean_db[outdoor], atol=1e-4)
    assert np.allclose(values[outdoor][:, 1], outcome.posterior.std_db[outdoor], atol=1e-4)
    readings = outcome.result.measurements
    assert np.allclose(
        values[readings.cell[:, 0], readings.cell[:, 1], 2], readings.gain_db, atol=1e-4
    )
    assert (np.isfinite(values[..., 2]) == readings.visited(outcome.grid.shape)).all()


@pytest.mark.parametrize("crs", [None, UTM])
def test_the_netcdf_answers_at_the_metres_of_a_cell(
    make_outcome: Make, tmp_path: Path, crs: str | None
) -> None:
    xr = pytest.importorskip("xarray")
    outcome = make_outcome(crs=crs)
    assert write_radio_map_nc(outcome, tmp_path / "map.nc") is None
    with xr.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as dataset:
        for row, col in outcome.result.measurements.cell[:5]:
            x, y = outcome.grid.xy_m((row, col))
            there = dataset.sel(x=x, y=y)
            assert float(there.mean_db) == pytest.approx(
                outcome.posterior.mean_db[row, col], abs=1e-4
            )
            assert float(there.measured_db) == pytest.approx(float(there.truth_db), abs=1e-4)
        assert (dataset.outdoor.values == outcome.scenario.outdoor).all()
        assert (dataset.height_m.values == outcome.scenario.city.height_m).all()
        assert dataset.mean_db.attrs["units"] == "dB"
        assert (dataset.y.values == outcome.grid.y_m).all()
        assert ("spatial_ref" in dataset.coords) == (crs is not None)
        if crs is not None:
            pyproj = pytest.importorskip("pyproj")
            assert pyproj.CRS.from_cf(dataset.spatial_ref.attrs) == pyproj.CRS.from_string(crs)


def test_netcdf_and_geotiff_lie_at_the_same_place_for_gdal(
    make_outcome: Make, tmp_path: Path
) -> None:
    rasterio = pytest.importorskip("rasterio")
    outcome = make_outcome(crs=UTM)
    write_radio_map_tif(outcome, tmp_path / "map.tif")
    write_radio_map_nc(outcome, tmp_path / "map.nc")
    with rasterio.open(tmp_path / "map.tif") as raster:
        north_up = raster.read(1)
    import xarray as xr

    with xr.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as dataset:
        west, spacing, _, north, _, down = map(
            float, dataset.spatial_ref.attrs["GeoTransform"].split()
        )
        assert rasterio.Affine(spacing, 0, west, 0, down, north) == raster.transform
        assert np.array_equal(
            dataset.mean_db.sortby("y", ascending=False).values, north_up, equal_nan=True
        )


def test_without_the_geo_extra_the_rest_is_written_and_a_note_names_it(
    make_outcome: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = make_outcome(crs=UTM)
    for module in ("rasterio", "pyproj"):
        monkeypatch.setitem(
            sys.modules, module, None
        )  # importing it now fails as if it were not installed
    remedy = install_command("geo")
    told = write_radio_map_tif(outcome, tmp_path / "radio_map.tif")
    assert told is not None
    assert remedy in told
    assert remedy in str(write_measurements_csv(outcome, tmp_path / "m.csv"))
    assert remedy in str(write_radio_map_nc(outcome, tmp_path / "map.nc"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.csv", "map.nc"]


def test_results_are_strict_sorted_json(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome(
        truth=None, config={"b": {"path": Path("x"), "nan": float("nan")}, "a": np.float32(1.5)}
    )
    write_results_json(outcome, tmp_path / "results.json")
    text = (tmp_path / "results.json").read_text()
    results = strict(text)
    assert results["config"] == {"a": 1.5, "b": {"nan": None, "path": "x"}}
    assert results["survey"]["steps_flown"] == 30
    assert results["scores_over_steps"]["step"] == [0, 5, 10, 15, 20, 25, 30]
    assert len(results["scores_over_steps"]["expected_rmse_db"]) == 7
    assert list(results) == sorted(results)
    assert text == json_text(results)  # reading and writing again changes nothing


numbers = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
nested = st.recursive(
    numbers,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(nested)
def test_any_plain_value_becomes_strict_json_that_reads_back(value: Any) -> None:
    assert strict(json_text(value)) == plain(value)


def test_what_json_cannot_say_is_refused() -> None:
    with pytest.raises(TypeError, match="give plain values"):
        json_text({"a": object()})


def test_same_survey_same_bytes(make_outcome: Make, tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    for folder in ("first", "second"):
        outcome = make_outcome(crs=UTM)
        write_measurements_csv(outcome, tmp_path / folder / "m.csv")
        write_radio_map_tif(outcome, tmp_path / folder / "map.tif")
        write_radio_map_nc(outcome, tmp_path / folder / "map.nc")
    for name in ("m.csv", "map.tif", "map.nc"):
        assert (tmp_path / "first" / name).read_bytes() == (
            tmp_path / "second" / name
        ).read_bytes(), name


def test_hostile_names_do_no_harm(make_outcome: Make, tmp_path: Path) -> None:
    outcome = make_outcome(name=HOSTILE, title=HOSTILE, config={HOSTILE: HOSTILE})
    write_results_json(outcome, tmp_path / "results.json")
    write_radio_map_nc(outcome, tmp_path / "map.nc")
    write_radio_map_tif(outcome, tmp_path / "map.tif")
    assert strict((tmp_path / "results.json").read_text(encoding="utf-8"))["title"].startswith(
        "</script><b>"
    )


def test_the_geotiff_is_cloud_optimised_and_has_a_style(make_outcome: Make, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    outcome = make_outcome(crs=UTM)
    write_radio_map_tif(outcome, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.descriptions[:2] == ("mean_db", "std_db")
    style = ElementTree.parse(tmp_path / "map.qml").getroot()
    shader = style.find(".//colorrampshader")
    assert shader is not None
    ends = float(shader.attrib["minimumValue"]), float(shader.attrib["maximumValue"])
    assert ends == gain_limits(outcome)
    values = [float(item.attrib["value"]) for item in shader]
    assert values[0] == ends[0]
    assert values[-1] == ends[1]
    assert values == sorted(values)


def test_a_small_and_a_large_map_are_cloud_optimised(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    for side in (2, 700):
        values = np.arange(side * side, dtype=float).reshape(side, side)
        path = tmp_path / f"{side}.tif"
        assert write_geotiff(path, Grid((side, side), 5.0), [("a", values, "dB")], {"x": 1}) is None
        with rasterio.open(path) as raster:
            assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert bool(raster.overviews(1)) == (side > 512)
            np.testing.assert_array_equal(raster.read(1)[::-1], values)
