"""Homes, batteries and the start of a replay, as a survey asks for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.app.fly import fly
from skygain.app.requests import MapRequest, SurveyRequest
from skygain.flight.starts import home_cells
from skygain.ground.errors import InputError
from skygain.scenario import Scenario
from skygain.testing.predictors import example_scenario

DATA = Path(__file__).parents[1] / "cities" / "data"


def request(**options: Any) -> SurveyRequest:
    usual = {"predictor": "kriging-blind", "planner": "random-waypoint", "record_every": 50}
    place = {"city": "7", "crop": 40, "propagation": "over-rooftop", "transmitter": "250,250,60"}
    return SurveyRequest(**{**place, **usual, "uavs": 2, "steps": 40, **options})


@pytest.fixture(scope="module")
def open_ground() -> Scenario:
    return example_scenario((30, 30), transmitter=False)


def test_uavs_that_share_a_home_stand_around_it(open_ground: Scenario) -> None:
    free = np.argwhere(open_ground.flyable)
    home = open_ground.grid.xy_m(free[len(free) // 2])
    cells = home_cells(open_ground, [tuple(home)], 4, apart_m=8.0)
    at = open_ground.grid.xy_m(cells)
    gaps = np.hypot(*np.moveaxis(at[:, None] - at[None], -1, 0))
    assert gaps[~np.eye(4, dtype=bool)].min() >= 8.0
    assert cells[0].tolist() == free[len(free) // 2].tolist()
    assert np.hypot(*(at - home).T).max() < 40.0


def test_homes_that_cannot_be_are_refused(open_ground: Scenario) -> None:
    with pytest.raises(InputError, match="2 homes for 3 UAVs"):
        home_cells(open_ground, [(10.0, 10.0), (20.0, 20.0)], 3)
    with pytest.raises(InputError, match="off the map"):
        home_cells(open_ground, [(-500.0, 10.0)], 1)


def test_a_battery_brings_every_uav_home() -> None:
    """1.2 minutes at 2 m/s are 36 moves of 4 m, fewer than the steps asked for."""
    outcome = fly(request(battery_min=1.2, speed_mps=2.0))
    history = outcome.result.swarm.history
    assert history.shape[1] == 37
    assert (history[:, 0] == history[:, -1]).all()
    assert any("lasts 36 moves" in note for note in outcome.notes)
    assert outcome.result.measurements.time_s.max() == pytest.approx(72.0)
    with pytest.raises(InputError, match=r"no way there and back.*`battery_min`"):
        fly(request(battery_min=0.02))


def test_homes_are_taken_in_degrees_or_metres() -> None:
    pytest.importorskip("geopandas")
    city = {"city": str(DATA / "city.geojson"), "crop": None, "steps": 2}
    city["transmitter"] = "48.2005,16.372,25"
    degrees = fly(request(**city, home="48.20093,16.37130; 48.20092,16.37262"))
    cells = degrees.result.swarm.history[:, 0]
    metres = degrees.grid.xy_m(cells)
    again = fly(request(**city, home=";".join(f"{x},{y}" for x, y in metres)))
    np.testing.assert_array_equal(again.result.swarm.history[:, 0], cells)
    assert any(note.startswith("take-off at") for note in again.notes)
    x, y = again.scenario.city.buildings[1].footprint_m.mean(axis=0)
    with pytest.raises(InputError, match="inside a building"):
        fly(request(**city, uavs=1, home=f"{x},{y}", altitude_m=5.0))
    with pytest.raises(InputError, match=r"seems to be longitude, latitude.*`home="):
        fly(request(**city, uavs=1, home="16.37130,48.20093"))


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log around the six buildings of city_utm.shp, on streets that lie beside its footprints."""
    side = np.linspace(0.0, 1.0, 25)
    south, north, west, east = 48.2000, 48.2018, 16.3700, 16.37404
    lat = np.r_[np.full(25, south), np.full(25, north), south + side * (north - south)]
    lon = np.r_[west + side * (east - west), west + side * (east - west), np.full(25, west)]
    rows = [f"{a:.6f},{o:.6f},{-70 - i % 7}" for i, (a, o) in enumerate(zip(lat, lon, strict=True))]
    path = tmp_path_factory.mktemp("walk") / "walk.csv"
    path.write_text("lat,lon,rsrp\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_a_replay_begins_where_something_was_recorded(walk: Path) -> None:
    for start in ("cluster", "spread"):
        flown = fly(
            SurveyRequest(replay=walk, uavs=2, steps=0, start=start, predictor="kriging-blind")
        )
        assert len(flown.result.measurements) == 2


def test_a_log_on_the_streets_around_a_city_widens_the_map(walk: Path) -> None:
    pytest.importorskip("geopandas")
    city = {"city": str(DATA / "city_utm.shp"), "crs": "EPSG:32633"}
    flown = fly(SurveyRequest(replay=walk, **city, uavs=1, steps=2, predictor="kriging-blind"))
    assert any("city's 32 x 61 cells" in note for note in flown.notes)
    assert np.isfinite(flown.truth_db).sum() > 60
    assert (flown.scenario.city.height_m > 0).any()
    from skygain.app.chart import chart

    (chart_,) = chart(MapRequest(readings=(walk,), **city, validate=False))
    assert chart_.grid == flown.grid
    box = (16.3705, 48.2003, 16.3738, 48.2015)
    with pytest.raises(InputError, match="lie outside the map"):
        fly(SurveyRequest(replay=walk, **city, box=box, uavs=1, steps=2))
