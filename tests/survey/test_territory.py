"""A survey's place as it is asked for: city options, positions, areas, levels above the sea."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.app.fly import fly
from skygain.app.requests import SurveyRequest
from skygain.ground.errors import InputError
from skygain.survey.worlds import open_world

rasterio = pytest.importorskip("rasterio")
geopandas = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")

DATA = Path(__file__).parents[1] / "cities" / "data"


def request(name: str, **options: Any) -> SurveyRequest:
    return SurveyRequest(
        city=str(DATA / name),
        propagation="over-rooftop",
        **{"uavs": 1, "steps": 3, "record_every": 3, **options},
    )


@pytest.fixture
def hill(tmp_path: Path) -> Path:
    """The ground of dsm_harbour_hill.tif."""
    with (
        rasterio.open(DATA / "dsm_harbour_hill.tif") as surface,
        rasterio.open(DATA / "ndsm_nd0.tif") as roofs,
        rasterio.open(tmp_path / "dtm.tif", "w", **surface.profile) as sink,
    ):
        sink.write((surface.read(1) - roofs.read(1)).astype(np.float32), 1)
    return tmp_path / "dtm.tif"


def test_what_a_reader_assumed_goes_with_the_outcome(tmp_path: Path) -> None:
    outcome = fly(request("nyc_heightroof.geojson", transmitter="48.2005,16.372,25"))
    assert outcome.notes[0] == "6 of 6 buildings without a height, taken as 9 m"
    assert outcome.transmitter_m[:2] == pytest.approx((601946, 5339495), abs=1)
    outcome.write(tmp_path)
    stored = json.loads((tmp_path / "results.json").read_text())
    assert stored["notes"][0] == outcome.notes[0]
    assert stored["city"]["source"]["crs"] == "EPSG:32633"
    assert outcome.notes[0] in (tmp_path / "report.html").read_text()


def test_a_transmitter_off_the_map_is_refused() -> None:
    with pytest.raises(InputError, match="latitude comes first"):
        fly(request("city.geojson", transmitter="16.372,48.2005"))


def test_a_flight_follows_the_terrain_or_keeps_a_level(hill: Path, tmp_path: Path) -> None:
    over = request("dsm_harbour_hill.tif", terrain=str(hill), altitude_m=30.0)
    outcome = fly(over)
    assert outcome.scenario.flyable.all()  # no roof is 30 m high
    assert outcome.scenario.altitude_text == "30 m above ground"
    outcome.write(tmp_path)
    with rasterio.open(tmp_path / "radio_map.tif") as written:
        assert written.descriptions[-1] == "ground_m"
        np.testing.assert_array_equal(written.read(4)[::-1], outcome.scenario.city.ground_m)
    level = request("dsm_harbour_hill.tif", terrain=str(hill), altitude_m=60.0, above_sea=True)
    scenario = open_world(level, altitude_m=60.0).scenario()
    assert scenario.altitude_text == "60 m above sea level"
    np.testing.assert_array_equal(scenario.flyable, outcome.scenario.city.surface_m < 60.0)


def test_the_truth_of_a_level_flight_is_that_of_the_same_surface(hill: Path) -> None:
    """Where the ground lies at zero, 60 m above the ground and above the sea are one place."""
    name, where = "dsm_harbour_hill.tif", {"terrain": str(hill), "transmitter": "600050,5339700,8"}
    over = open_world(request(name, **where), altitude_m=60.0)
    level = open_world(request(name, **where, above_sea=True), altitude_m=60.0)
    low = over.city.ground_m == 0
    assert 0.1 < low.mean() < 0.9
    np.testing.assert_allclose(level.truth_db[low], over.truth_db[low], atol=1e-3)


def test_areas_bound_the_map_and_zones_the_flight(tmp_path: Path) -> None:
    west, south, east, north = open_world(request("city.geojson")).city.grid.bounds_m
    half = shapely.box(west, south, (west + east) / 2, north)
    strip = shapely.box(west + 40, south, west + 60, north)
    for name, shape in (("area.geojson", half), ("zone.geojson", strip)):
        series = geopandas.GeoSeries([shape], crs="EPSG:32633")
        series.to_crs(4326).to_file(tmp_path / name)
    outcome = fly(
        request("city.geojson", area=tmp_path / "area.geojson", no_fly=tmp_path / "zone.geojson")
    )
    scenario = outcome.scenario
    assert not scenario.outdoor[:, 31:].any()
    assert scenario.outdoor[:, :30].any()
    assert not scenario.flyable[:, 10:15].any()
    assert np.isnan(outcome.mean_db[:, 31:]).all()
    assert any("zone.geojson: no flight over" in note for note in outcome.notes)
    with pytest.raises(InputError, match="no polygon touches the map"):
        fly(request("dsm_polder.tif", area=tmp_path / "area.geojson"))


def test_a_ceiling_does_not_open_a_zone_to_a_flight_that_keeps_a_level(
    hill: Path, tmp_path: Path
) -> None:
    """Over the hill such a flight may be below the ceiling; the whole zone stays closed."""
    zone = {"ceiling": 30.0, "geometry": shapely.box(600000, 5339680, 600100, 5340000)}
    geopandas.GeoDataFrame([zone], geometry="geometry", crs=32633).to_file(tmp_path / "z.gpkg")
    common = {"terrain": str(hill), "no_fly": tmp_path / "z.gpkg", "altitude_m": 125.0}
    level = fly(request("dsm_harbour_hill.tif", **common, above_sea=True))
    assert level.scenario.no_fly is not None
    assert level.scenario.no_fly.any()
    assert any("keeps a level" in note for note in level.notes)
    over = fly(request("dsm_harbour_hill.tif", **common))
    assert not over.scenario.no_fly.any()


def test_rays_are_sent_over_level_ground_of_any_height() -> None:
    asked = SurveyRequest(city=str(DATA / "dsm_polder.tif"), transmitter="118030,486850,20")
    assert open_world(asked, altitude_m=25.0).city.ground_m.min() == -4.5
