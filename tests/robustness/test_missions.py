"""A mission's commands can be killed at any moment and given again: no reading is lost or doubled,
and every folder can be used."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skygain.app.progress import SILENT
from skygain.missions.commands import run_plan, run_status
from skygain.missions.folder import Mission, made
from skygain.missions.requests import MissionPlanRequest, MissionStatusRequest
from tests.missions.conftest import site, sortie, town  # noqa: F401
from tests.missions.test_ingest import write_log
from tests.missions.town import mission_request

from .processes import TRIALS

KILLS = max(4, TRIALS)
"""of plan, of ingest and of serve"""
IN_FLIGHT = 3 if TRIALS > 1 else 2
"""kills of one flight"""

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")


def killed(
    folder: Path,
    between_s: tuple[float, float],
    kills: int,
    command: str,
    *words: object,
    seed: int = 7,
) -> subprocess.Popen[str]:
    """``command``, killed some times and then left alone."""
    told = [folder, *between_s, seed, kills, command, *words]
    return subprocess.Popen(
        [sys.executable, "-m", "tests.robustness.killed", *map(str, told)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def end(child: subprocess.Popen[str]) -> tuple[list[float], str]:
    """When it was killed, and what it said in the end."""
    out, err = child.communicate(timeout=1200)
    assert child.returncode == 0, err
    assert "Traceback" not in err
    lines = out.splitlines()
    moments = [float(line) for line in lines if line.replace(".", "").isdigit()]
    return moments, out


def test_no_reading_is_lost_or_doubled_by_kills(town, site, tmp_path: Path) -> None:  # noqa: F811
    folder = made(mission_request(town, tmp_path / "mission", planner="random-waypoint"))
    end(killed(folder, (0.0, 2.5), KILLS, "plan"))
    with Mission.opened(folder) as mission:
        (planned,) = mission.sorties()
        assert len(mission.journal.events("planned")) == 1
    names = {p.name for p in (folder / "sorties" / "001").iterdir()}
    assert {"brief.html", "uav0.plan", "uav2.kmz"} <= names
    assert [p.name for p in (folder / "sorties").iterdir()] == ["001"]
    logs = [write_log(site, f, tmp_path / f"uav{f.uav}.csv") for f in planned.flights]
    end(killed(folder, (0.0, 0.8), KILLS, "ingest", *logs))
    expected = sum(len(log.read_text().splitlines()) - 1 for log in logs)
    with Mission.opened(folder) as mission:
        readings = mission.journal.readings()
        assert len(readings) == expected
        assert len({one.hash for one in readings}) == expected
        assert len(mission.journal.events("ingested")) == 3
        assert len(set(mission.journal.reading_events())) == 3


@pytest.mark.parametrize("trial", range(-(-TRIALS // 3)))
def test_a_live_flight_is_taken_over(town, site, sortie, tmp_path: Path, trial: int) -> None:  # noqa: F811
    """Vehicles fly on; what was heard is kept up to the last moment before each kill; whoever takes
    over knows what they have on board."""
    pytest.importorskip("pymavlink")
    from tests.missions.test_whole_mission import apart_m
    from tests.missions.vehicles import SimulatedVehicle, free_port

    from .killed import PACE

    folder = made(mission_request(town, tmp_path / "mission", planner="random-waypoint"))
    first, _, last = sortie.flights  # the second waits long on the ground
    sortie = replace(sortie, flights=(first, last))
    with Mission.opened(folder) as mission:
        mission.journal.add("planned", {"sortie": sortie.as_data()})
    with contextlib.ExitStack() as stack:
        fleet = [
            stack.enter_context(
                SimulatedVehicle(
                    free_port(),
                    tuple(map(float, site.latlon(np.array(flight.pad_m[:2])))),
                    lambda latitude, longitude: -60.0 - 1e3 * (latitude % 0.01),
                    system=flight.uav + 1,
                    autopilot="ARDUPILOTMEGA" if flight.uav == 2 else "PX4",
                    pace=PACE,
                )
            )
            for flight in sortie.flights
        ]
        links = [f"udpin:127.0.0.1:{vehicle.link.destination_addr[1]}" for vehicle in fleet]
        kills, told = end(killed(folder, (0.5, 4.0), IN_FLIGHT, "fly", *links, seed=trial))
    assert "UAV 0 landed, UAV 2 landed" in told or "has been flown" in told, told
    for vehicle in fleet:
        assert not vehicle.armed
        assert np.hypot(*vehicle.xyz[:2]) < 1.0
    assert apart_m(site, fleet) >= site.request.separation_m - 1.0
    with Mission.opened(folder) as mission:
        readings = mission.journal.readings()
    assert len({one.hash for one in readings}) == len(readings)
    for uav, vehicle in zip((0, 2), fleet, strict=True):
        mine = np.sort([r.time_s for r in readings if r.uav == uav])
        sent = np.array(vehicle.sent_s)
        assert len(mine) <= len(sent)
        for begin, kill in zip([0.0, *kills], [*kills, np.inf], strict=True):
            kept = mine[(mine > begin) & (mine < kill)]
            if len(kept):
                last = min(kill - 1.0, sent[-1] + 1.0)
                due = (sent >= kept[0] - 0.05) & (sent <= last)
                assert (kept <= last + 0.05).sum() >= due.sum() - 1, (uav, kill)
    usable(folder)


def usable(folder: Path, sorties: tuple[str, ...] = ("sortie 2",)) -> None:
    """The next commands do what they should."""
    assert "map:" in run_status(MissionStatusRequest(folder=folder), SILENT)
    assert run_plan(MissionPlanRequest(folder=folder), SILENT).startswith(sorties)


def test_a_server_that_is_killed_keeps_what_it_acknowledged(
    town, sortie, tmp_path: Path  # noqa: F811
) -> None:  # fmt: skip
    httpx = pytest.importorskip("httpx")
    pytest.importorskip("uvicorn")
    from skygain.missions.serve import kept_token
    from tests.missions.test_posting import reading
    from tests.missions.vehicles import free_port

    folder = made(mission_request(town, tmp_path / "mission", planner="random-waypoint"))
    with Mission.opened(folder) as mission:
        mission.journal.add("planned", {"sortie": sortie.as_data()})
    head = {"Authorization": f"Bearer {kept_token(folder)}"}
    port = free_port()
    child = killed(folder, (0.5, 3.0), KILLS, "serve", port)
    moments: list[float] = []
    listener = threading.Thread(
        target=lambda: moments.extend(float(line) for line in child.stdout), daemon=True
    )
    listener.start()
    acknowledged, number = [], 0
    until = time.monotonic() + 4.0 * KILLS + 60
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", headers=head, timeout=5) as client:
        after = 0
        while after < 5 and time.monotonic() < until:
            rows = [reading(number + k) for k in range(4)]
            number += 4
            while time.monotonic() < until:  # as a sender that keeps what was not acknowledged
                try:
                    client.post("/api/readings", json=rows).raise_for_status()
                    break
                except httpx.HTTPError:
                    time.sleep(0.02)
            acknowledged += [(row["time"], row["latitude"]) for row in rows]
            after += len(moments) == KILLS
            time.sleep(0.01)
        assert client.get("/api/readings").json()["level"]
    end(child)
    assert len(moments) == KILLS
    with Mission.opened(folder) as mission:
        readings = mission.journal.readings()
    found = Counter((r.time_s, r.latitude) for r in readings)
    assert set(found.values()) == {1}
    assert found.keys() == {(t, round(lat, 8)) for t, lat in acknowledged}
    # a few cells that were posted leave the sortie open
    usable(folder, ("sortie 1", "sortie 2"))
