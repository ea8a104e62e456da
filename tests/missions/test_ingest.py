"""Readings come back to where they were taken, once, or are refused in one line."""

from __future__ import annotations

import csv
import json
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from skygain.app.progress import SILENT
from skygain.ground.errors import InputError
from skygain.instruments import read_recording
from skygain.missions.commands import run_ingest, run_plan, run_status
from skygain.missions.folder import Mission, made
from skygain.missions.next_sortie import left_over
from skygain.missions.requests import MissionIngestRequest, MissionPlanRequest, MissionStatusRequest
from skygain.missions.site import Site
from skygain.missions.sortie import Flight
from tests.missions.town import SOUTH_M, WEST_M, mission_request

START = datetime.now(UTC).replace(microsecond=0)


def level(xy: np.ndarray) -> float:
    """A transmitter in a corner of the town."""
    return -40.0 - 0.2 * float(np.hypot(*(xy - (WEST_M + 20, SOUTH_M + 20))))


def write_log(
    site: Site,
    flight: Flight,
    path: Path,
    *,
    share: float = 1.0,
    off_m: float = 0.0,
    hours: float = 0.0,
) -> Path:
    """What a companion computer logs once a second, over the first ``share`` of a flight."""
    ticks = flight.timeline.ticks_m
    moments = np.flatnonzero(np.isfinite(ticks[:, 0]))[::4]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "latitude", "longitude", "altitude", "rsrp_dbm"])
        for k in moments[: int(share * len(moments))]:
            xy = ticks[k, :2] + off_m
            lat, lon = site.latlon(xy)
            when = START + timedelta(seconds=k * 0.25, hours=hours)
            row = [when.isoformat(), f"{lat:.8f}", f"{lon:.8f}", f"{ticks[k, 2]:.1f}"]
            writer.writerow([*row, f"{max(-120.0, level(xy)):.2f}"])
    return path


@pytest.fixture
def folder(town, sortie, tmp_path: Path) -> Path:
    """A mission with one sortie planned."""
    folder = made(mission_request(town, tmp_path / "mission", planner="random-waypoint"))
    with Mission.opened(folder) as mission:
        mission.journal.add("planned", {"sortie": sortie.as_data()})
    return folder


def ingest(folder: Path, *files: Path, **options) -> str:
    return run_ingest(MissionIngestRequest(folder=folder, files=files, **options), SILENT)


def test_logs_find_their_uav_and_count_once(folder, site, sortie, tmp_path: Path) -> None:
    logs = [write_log(site, f, tmp_path / f"{9 - f.uav}.csv") for f in sortie.flights]
    told = ingest(folder, *reversed(logs))
    for flight, log in zip(sortie.flights, logs, strict=True):
        (line,) = [one for one in told.splitlines() if one.startswith(log.name)]
        assert f"sortie 1, UAV {flight.uav}: " in line
        assert "elsewhere" not in line
    assert "nothing new" in ingest(folder, logs[0])
    with Mission.opened(folder) as mission:
        readings = mission.journal.readings()
        assert len(mission.journal.events("ingested")) == 3
        assert left_over(mission, site) == []
    lines = sum(len(log.read_text().splitlines()) - 1 for log in logs)
    assert len(readings) == lines
    assert min(r.time_s for r in readings) == pytest.approx(START.timestamp(), abs=60)


def test_what_was_not_flown_is_flown_first_in_the_next_plan(
    folder, site, sortie, tmp_path: Path
) -> None:
    first, *rest = sortie.flights
    ingest(folder, write_log(site, first, tmp_path / "cut.csv", share=0.4))
    ingest(folder, *(write_log(site, f, tmp_path / f"{f.uav}.csv") for f in rest))
    with Mission.opened(folder) as mission:
        missed = np.concatenate([run.cells for run in left_over(mission, site)])
    planned = {tuple(cell) for cell in first.cells.tolist()}
    assert {tuple(cell) for cell in missed.tolist()} <= planned
    told = run_plan(MissionPlanRequest(folder=folder), SILENT)
    assert told.startswith("sortie 2")
    assert "cells of earlier sorties are flown again" in told
    with Mission.opened(folder) as mission:
        again = {tuple(cell) for cell in mission.sorties()[1].cells.tolist()}
    distinct = {tuple(cell) for cell in missed.tolist()}
    assert len(again & distinct) >= 0.6 * len(distinct)


def test_what_was_flown_elsewhere_counts_where_it_was_flown(
    folder, site, sortie, tmp_path: Path
) -> None:
    flight = sortie.flights[0]
    path = write_log(site, flight, tmp_path / "there.csv", share=0.1)
    with path.open("a", newline="") as file:
        for k in range(8):
            xy = np.array([WEST_M + 5.0, SOUTH_M + 150.0 + k])
            lat, lon = site.latlon(xy)
            when = (START + timedelta(seconds=100 + k)).isoformat()
            csv.writer(file).writerow([when, lat, lon, 30.0, -77.0])
    told = ingest(folder, path)
    on_it = any(
        np.hypot(*(f.route_m[:, :2] - (WEST_M + 5, SOUTH_M + 154)).T).min() < 40
        for f in sortie.flights
    )
    assert on_it or "sortie 1, elsewhere: 8" in told
    with Mission.opened(folder) as mission:
        there = [r for r in mission.journal.readings() if r.level_db == -77.0]
    assert len(there) == 8
    assert {r.sortie for r in there} == {1}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hours": -5.0}, r"5\.\d h before the first plan was made.*`shift_hours=5`"),
        ({"hours": 7.0}, "after now.*`shift_hours=-[78]`"),
        ({"hours": -24 * 400.0}, "400 days before"),
        ({"off_m": 500_000.0}, "lie outside the map|lie far from the map"),
    ],
)
def test_a_log_of_another_mission_or_clock_is_refused(
    folder, site, sortie, tmp_path: Path, change: dict, message: str
) -> None:
    good = write_log(site, sortie.flights[1], tmp_path / "good.csv")
    bad = write_log(site, sortie.flights[0], tmp_path / "bad.csv", **change)
    with pytest.raises(InputError, match=message) as caught:
        ingest(folder, good, bad)
    assert "\n" not in str(caught.value)
    with Mission.opened(folder) as mission:  # nothing of either was kept
        assert mission.journal.readings() == []


def test_a_clock_that_is_off_can_be_put_right(folder, site, sortie, tmp_path: Path) -> None:
    log = write_log(site, sortie.flights[0], tmp_path / "late.csv", hours=-5.0)
    assert "UAV 0" in ingest(folder, log, shift_hours=5.0)


def test_gain_and_power_are_not_mixed(folder, site, sortie, tmp_path: Path) -> None:
    log = write_log(site, sortie.flights[0], tmp_path / "a.csv")
    ingest(folder, log)
    with pytest.raises(InputError, match="holds gain, the mission's readings are power"):
        ingest(folder, log, eirp_dbm=20.0)


def test_a_log_of_seconds_since_boot_has_no_date_to_check(
    folder, site, sortie, tmp_path: Path
) -> None:
    rows = list(csv.reader(write_log(site, sortie.flights[2], tmp_path / "a.csv").open()))
    path = tmp_path / "boot.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([rows[0], *([k, *r[1:]] for k, r in enumerate(rows[1:]))])
    assert read_recording(path, where={"altitude": "*"}).began_s is None
    assert "UAV 2" in ingest(folder, path)


def test_dates_are_those_of_the_log(tmp_path: Path) -> None:
    path = tmp_path / "dated.csv"
    for stamp, expected in (
        ("2025-05-06T09:00:03Z", 1746522003.0),
        ("2025-05-06T11:00:03+02:00", 1746522003.0),
        ("1746522003", 1746522003.0),
        ("1746522003000", 1746522003.0),
        ("09:00:03", None),
    ):
        path.write_text(f"time,lat,lon,rsrp\n{stamp},50.0,9.0,-80\n{stamp},50.001,9.0,-81\n")
        assert read_recording(path).began_s == expected


def test_the_map_grows_and_says_when_to_stop(folder, site, sortie, tmp_path: Path) -> None:
    status = MissionStatusRequest(folder=folder, least_gain_db=0.01)
    assert "fly on" in run_status(status, SILENT)
    assert not (folder / "map").exists()
    ingest(folder, *(write_log(site, f, tmp_path / f"{f.uav}.csv") for f in sortie.flights))
    told = run_status(status, SILENT)
    assert "fly on" in told
    names = {p.name for p in (folder / "map").iterdir()}
    assert {"radio_map.tif", "radio_map.nc", "survey_maps.png", "report.html"} <= names
    results = json.loads((folder / "map" / "results.json").read_text())
    falling = results["scores_over_steps"]["expected_rmse_db"]
    assert len(falling) == 4
    assert falling[-1] < falling[0]
    assert "stop" in run_status(replace(status, least_gain_db=50.0), SILENT)
    with Mission.opened(folder) as mission:
        kinds = [event["kind"] for event in mission.journal.events("advised")]
        assert len(kinds) == 3
        assert mission.journal.events("advised")[0]["stop"] is False
    assert time.time() > START.timestamp()
