"""A map uses every reading, is honest about its error, and says where to go on."""

from __future__ import annotations

import json

import numpy as np
import pytest

from skygain.app.chart import chart, run_map
from skygain.app.requests import MapRequest
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments import Recording, on_grid, read_recording
from skygain.survey.mapping import cross_validated, next_places, radio_map

GRID = Grid((24, 30), 10.0, (5.0, 5.0))


def plane(xy):
    """A smooth field in dBm."""
    return -70.0 - 0.05 * xy[:, 0] - 4.0 * np.sin(xy[:, 1] / 40.0)


@pytest.fixture
def walked():
    rng = np.random.default_rng(1)
    xy = rng.uniform((0, 0), (300, 240), (160, 2))
    level = plane(xy) + rng.normal(0, 1.0, len(xy))
    return on_grid(Recording(level, "power", "walk.csv", xy_m=xy), GRID)


def log(path, n=120, cells=(1,), seed=0):
    rng = np.random.default_rng(seed)
    lines = ["lat,lon,pci,rsrp"]
    for _ in range(n):
        dx, dy = rng.uniform(0, 240, 2)
        for k, cell in enumerate(cells):
            level = -70 - 0.05 * (dx if k == 0 else 240 - dx)
            lines.append(f"{48.2 + dy / 111000:.7f},{16.37 + dx / 74000:.7f},{cell},{level:.1f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_every_reading_counts_and_a_constant_shifts_the_map(walked):
    chart_ = radio_map(walked, predictor="idw", validate=False)
    at = tuple(walked.cell.T)
    np.testing.assert_allclose(chart_.mean_db[at], walked.level_db, atol=1e-6)
    assert np.isfinite(chart_.mean_db).all()


def test_kriging_beats_idw_on_a_smooth_field(walked):
    scores = radio_map(walked, predictor="kriging-blind").scores
    for how in ("random", "blocks"):
        ours, theirs = scores[how]["kriging-blind"], scores[how]["idw"]
        assert ours.low_db <= ours.rmse_db <= ours.high_db
        assert ours.rmse_db < theirs.rmse_db
        assert 0.6 < ours.coverage90 <= 1.0
    assert scores["blocks"]["idw"].rmse_db > scores["random"]["idw"].rmse_db


def test_left_out_readings_are_not_seen(walked):
    # Noise alone cannot be predicted better than by its own spread.
    rng = np.random.default_rng(2)
    noise = on_grid(
        Recording(rng.normal(-90, 6, 200), "gain", "n", xy_m=rng.uniform(0, 240, (200, 2))), GRID
    )
    scores, _ = cross_validated(noise, radio_map(noise, predictor="idw", validate=False).scenario,
                                ("knn", "kriging-blind"))  # fmt: skip
    for found in scores.values():
        assert all(score.rmse_db > 4.0 for score in found.values())


def test_the_next_places_are_where_nothing_was_measured(walked):
    west = on_grid(
        Recording(
            np.full(60, -80.0) - np.arange(60) / 30,
            "power",
            "west.csv",
            xy_m=np.random.default_rng(0).uniform((0, 0), (100, 240), (60, 2)),
        ),
        GRID,
    )
    chart_ = radio_map(west, predictor="kriging-blind", validate=False)
    cells = next_places(chart_, 5)
    assert len(np.unique(cells, axis=0)) == 5
    assert (cells[:, 1] >= 10).all()
    assert not chart_.gridded.recorded[tuple(cells.T)].any()
    apart = np.abs(cells[:, None] - cells[None]).max(axis=2) + 99 * np.eye(5)
    assert apart.min() >= 2


def test_the_folder_reads_back_as_power(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    xr = pytest.importorskip("xarray")
    source = log(tmp_path / "a.csv")
    out = tmp_path / "out"
    told = run_map(
        MapRequest(readings=(source,), spacing_m=10.0, threshold_db=-75.0, next_places=3, out=out)
    )
    assert "RMSE, blocks left out: kriging-blind" in told
    again, first = read_recording(out / "measurements.csv"), read_recording(source)
    assert again.quantity == "power"
    assert abs(np.median(again.level_db) - np.median(first.level_db)) < 1.0
    with rasterio.open(out / "radio_map.tif") as raster:
        assert raster.descriptions == ("mean_dbm", "std_db", "measured_dbm")
        assert raster.units[0] == "dBm"
        bounds = raster.bounds
    assert xr.open_dataset(out / "radio_map.nc").mean_dbm.attrs["units"] == "dBm"
    results = json.loads((out / "results.json").read_text())
    (series,) = results["series"]
    assert series["readings"] == 120
    assert 0 < series["covered"] < 1
    for name in ("contours", "coverage", "next"):
        content = json.loads((out / f"{name}.geojson").read_text())
        assert content["features"], name
    pyogrio = pytest.importorskip("pyogrio")
    for name in ("next.kml", "next.gpx"):
        layer = {"layer": "waypoints"} if name.endswith("gpx") else {}
        assert len(pyogrio.read_dataframe(out / name, **layer)) == 3
    area = pyogrio.read_dataframe(out / "coverage.geojson").to_crs(raster.crs).area.sum()
    whole = (bounds.right - bounds.left) * (bounds.top - bounds.bottom)
    assert area / whole == pytest.approx(series["covered"], abs=0.1)
    assert "map.png" in {path.name for path in out.iterdir()}
    with pytest.raises(InputError, match="overwrite=True"):
        run_map(MapRequest(readings=(source,), out=out))


def test_one_map_for_each_cell_and_the_strongest_server(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    source = log(tmp_path / "two.csv", cells=(101, 257))
    with pytest.raises(InputError, match="different signals"):
        chart(MapRequest(readings=(source,)))
    out = tmp_path / "out"
    run_map(MapRequest(readings=(source,), by="pci", spacing_m=10.0, validate=False, out=out))
    with rasterio.open(out / "radio_map.tif") as raster:
        bands = dict(zip(raster.descriptions, raster.read(), strict=True))
    first, second = bands["mean_dbm_101"], bands["mean_dbm_257"]
    np.testing.assert_allclose(bands["strongest_dbm"], np.maximum(first, second))
    np.testing.assert_allclose(bands["second_dbm"], np.minimum(first, second))
    assert set(np.unique(bands["server"])) == {0.0, 1.0}
    # the first cell's level falls to the east, the other's rises
    assert first[:, :3].mean() > second[:, :3].mean()
    assert first[:, -3:].mean() < second[:, -3:].mean()


def test_several_logs_are_one_campaign(tmp_path):
    logs = (log(tmp_path / "a.csv", 40), log(tmp_path / "b.csv", 40, seed=1))
    (found,) = chart(MapRequest(readings=logs, spacing_m=10.0, validate=False))
    assert found.gridded.count.sum() == 80


def test_the_area_is_where_the_map_is(tmp_path):
    pytest.importorskip("rasterio")
    source = log(tmp_path / "a.csv")
    ring = [[16.37, 48.2], [16.3715, 48.2], [16.3715, 48.3], [16.37, 48.3], [16.37, 48.2]]
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    request = MapRequest(readings=(source,), area=area, spacing_m=10.0, validate=False)
    (found,) = chart(request)
    share = np.isfinite(found.mean_db).mean()
    assert 0.3 < share < 0.6
    cells = next_places(found, 4)
    assert found.wanted[tuple(cells.T)].all()


@pytest.mark.parametrize("predictor", ["kriging-inferred", "kriging-blind"])
def test_a_constant_in_dbm_shifts_the_whole_map(predictor):
    rng = np.random.default_rng(3)
    grid = Grid((24, 24), 4.0)
    cells = rng.permutation(grid.size)[:40]
    xy = grid.xy_m(grid.cells[cells])
    level = -70.0 - 0.2 * np.hypot(*(xy - 20.0).T) + rng.normal(0, 2, 40)
    maps = []
    for shift in (0.0, 40.0):
        heard = Recording(level - shift, "power", "log", xy_m=xy)
        chart = radio_map(on_grid(heard, grid), predictor=predictor, validate=False)
        maps.append((chart.mean_db + shift, chart.std_db))
    np.testing.assert_allclose(maps[1], maps[0], atol=1e-3)


def test_the_next_legs_lie_on_the_streets(tmp_path):
    """The west is measured; of two streets the eastern one teaches more, and legs have a length."""
    geopandas = pytest.importorskip("geopandas")
    shapely = pytest.importorskip("shapely")
    log(tmp_path / "log.csv")
    lat, lon = 48.2 + np.array([0, 240]) / 111000, 16.37 + np.array([20, 420]) / 74000
    lines = [shapely.LineString([(x, lat[0]), (x, lat[1])]) for x in lon]
    geopandas.GeoSeries(lines, crs=4326).to_file(tmp_path / "streets.geojson")
    run_map(
        MapRequest(
            readings=(tmp_path / "log.csv",),
            streets=tmp_path / "streets.geojson",
            next_places=2,
            box=(16.3695, 48.1995, 16.3765, 48.2030),
            spacing_m=10.0,
            validate=False,
            out=tmp_path / "map",
        )
    )
    found = geopandas.read_file(tmp_path / "map" / "next.geojson").to_crs(32633)
    assert found.order.tolist() == [1, 2]
    assert found.length.between(30, 90).all()
    streets = geopandas.GeoSeries(lines, crs=4326).to_crs(32633)
    assert found.distance(streets[1])[0] < 1.0
    assert found.distance(streets.union_all()).max() < 1.0
    assert found.distance(found.geometry[1])[0] > 30
    assert len(geopandas.read_file(tmp_path / "map" / "next.gpx", layer="routes")) == 2
    assert "<LineString>" in (tmp_path / "map" / "next.kml").read_text()
    with pytest.raises(InputError, match="`next_places`"):
        MapRequest(readings=(tmp_path / "log.csv",), streets=tmp_path / "streets.geojson")
