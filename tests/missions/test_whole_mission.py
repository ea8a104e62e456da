"""One whole mission over a town whose truth is known: new, plan, fly with a death and a broken
link, serve, status."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest

pytest.importorskip("pymavlink")
pytest.importorskip("starlette")

from skygain.app.progress import SILENT
from skygain.flight.swarm import Swarm
from skygain.instruments.simulated import PerfectInstrument
from skygain.missions.commands import run_fly, run_new, run_plan, run_status
from skygain.missions.folder import Mission
from skygain.missions.requests import MissionFlyRequest, MissionPlanRequest, MissionStatusRequest
from skygain.missions.state import known_belief, readings_so_far
from skygain.missions.watching import LIVE
from skygain.propagation.truth import trace_truth
from skygain.survey.loop import Survey
from tests.missions.test_serve import served
from tests.missions.town import SOUTH_M, WEST_M
from tests.missions.vehicles import SimulatedVehicle, free_port

PACE = 20.0
EIRP_DBM = 30.0


@pytest.fixture(scope="module")
def truth_db(site) -> np.ndarray:
    """``[row, col]`` gain of a transmitter on a mast in the town's corner, with rays and
    diffraction."""
    mast = np.array([[WEST_M + 20, SOUTH_M + 20, 25.0]])
    return trace_truth(site.city, mast, [30.0], frequency_hz=5e9).gain_db[0, 0].astype(float)


class Flown:
    """What a whole mission left."""

    def __init__(self, site, truth_db: np.ndarray, folder: Path) -> None:
        self.folder, self.lines = folder, []
        run_new(replace(site.request, folder=folder, stop_std_db=30.0), SILENT)
        self.planned = run_plan(MissionPlanRequest(folder=folder), SILENT)
        with Mission.opened(folder) as mission:
            (self.sortie,) = mission.sorties()

        def level(latitude: float, longitude: float) -> float:
            (row, col) = site.grid.cells_at_latlon(np.array([[latitude, longitude]]))[0]
            return float(truth_db[row, col]) + EIRP_DBM

        with contextlib.ExitStack() as stack:
            self.fleet = [
                stack.enter_context(
                    SimulatedVehicle(
                        free_port(),
                        tuple(map(float, site.latlon(np.array(flight.pad_m[:2])))),
                        level,
                        system=flight.uav + 1,
                        autopilot="ARDUPILOTMEGA" if flight.uav == 1 else "PX4",
                        pace=PACE,
                    )
                )
                for flight in self.sortie.flights
            ]
            ports = [vehicle.link.destination_addr[1] for vehicle in self.fleet]
            links = tuple(Path(f"udpin:127.0.0.1:{port}") for port in ports)
            thread = threading.Thread(target=self.trouble, daemon=True)
            thread.start()
            asked = MissionFlyRequest(folder=folder, link=links, arm=True, pace=PACE)
            self.told = run_fly(asked, SILENT)
            thread.join()

    def trouble(self) -> None:
        """UAV 1 is out of reach for 10 s, UAV 2 dies midway."""
        while self.fleet[2].xyz[2] < 25:
            time.sleep(0.01)
        time.sleep(20 / PACE)
        self.fleet[1].cut(10 / PACE)
        time.sleep(40 / PACE)
        self.fleet[2].kill()


@pytest.fixture(scope="module")
def flown(site, truth_db, tmp_path_factory: pytest.TempPathFactory) -> Flown:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("builtins.input", lambda question: "yes")
        return Flown(site, truth_db, tmp_path_factory.mktemp("whole") / "mission")


def test_the_lost_one_is_told_of_and_the_others_come_home(flown) -> None:
    assert "UAV 0 landed, UAV 1 landed, UAV 2 lost" in flown.told
    for vehicle in flown.fleet[:2]:
        assert np.hypot(*vehicle.xyz[:2]) < 1.0
        assert not vehicle.armed
    with Mission.opened(flown.folder) as mission:
        events = mission.journal.events()
    assert [e["uav"] for e in events if e["kind"] == "lost"] == [2]
    offers = [e["id"] for e in events if e["kind"] == "offered"]
    taken = [e["offer"] for e in events if e["kind"] == "replanned"]
    assert taken
    assert set(taken) <= set(offers)
    assert sum(vehicle.uploads for vehicle in flown.fleet) == 3 + len(taken)
    assert events[-1]["kind"] == "flown"
    assert not (flown.folder / LIVE).exists()


def test_no_reading_is_lost_or_doubled(flown) -> None:
    with Mission.opened(flown.folder) as mission:
        readings = mission.journal.readings()
    for uav, vehicle in enumerate(flown.fleet):
        mine = [r for r in readings if r.uav == uav]
        assert len(mine) == len(vehicle.sent_s) > 20
    assert len({r.hash for r in readings}) == len(readings)


def apart_m(site, fleet) -> float:
    """The least distance of any two vehicles in the air at the same moment."""
    least = np.inf
    tracks = []
    for vehicle in fleet:
        t, lat, lon, height = np.array(vehicle.trace).T
        xy = site.grid.xy_m_at_latlon(np.column_stack([lat, lon]))
        tracks.append((t, np.column_stack([xy, height])))
    for i, (t, place) in enumerate(tracks):
        for other_t, other in tracks[:i]:
            at = np.column_stack([np.interp(t, other_t, other[:, k]) for k in range(3)])
            both = (place[:, 2] > 0.5) & (at[:, 2] > 0.5) & (t <= other_t[-1])
            if both.any():
                least = min(least, float(np.linalg.norm(place - at, axis=1)[both].min()))
    return least


def test_nobody_came_too_near(site, flown) -> None:
    """Where each vehicle was, not where it was sent."""
    import shapely

    assert apart_m(site, flown.fleet) >= site.request.separation_m - 1.0  # seen every 0.2 s
    for vehicle in flown.fleet:
        _, lat, lon, height = np.array(vehicle.trace).T
        up = height > 5
        points = shapely.points(site.grid.xy_m_at_latlon(np.column_stack([lat[up], lon[up]])))
        near = min(
            float(shapely.distance(points, one).min())
            for one in (*site.solid, *site.zones, site.area.exterior)
        )
        assert near >= site.request.clearance_m - 0.5


def rmse_db(site, truth_db: np.ndarray, mean_db: np.ndarray) -> float:
    asked = site.scenario.outdoor & site.area_mask & np.isfinite(truth_db)
    return float(np.sqrt(((mean_db - truth_db)[asked] ** 2).mean()))


def test_the_map_is_nearly_as_good_as_a_simulated_surveys(site, flown, truth_db) -> None:
    """The same predictor and planner, and readings in as many cells.

    The vehicles fly at 20 times the pace and wait for nobody, so on a busy machine some fly on
    where a new plan would have turned, or wait on the ground until their way is clear and teach
    less before they die; hence the bound at a third of the way from the survey to a flat map at the
    true mean.
    """
    with Mission.opened(flown.folder) as mission:
        belief = known_belief(mission)
        cells = readings_so_far(site, mission.journal.readings()).visited(site.grid.shape)
        method = mission.method
    live = rmse_db(site, truth_db, belief.posterior().mean_db - EIRP_DBM)
    level_db = truth_db[site.scenario.outdoor].mean()
    flat = rmse_db(site, truth_db, np.full(truth_db.shape, level_db))
    n = int(cells.sum())
    starts = np.array([pad.cell for pad in site.pads])
    survey = Survey(
        site.scenario,
        method.build_predictor(),
        method.build_planner(),
        PerfectInstrument(truth_db),
    )
    steps = n // len(starts)
    found = survey.fly(Swarm.deployed(site.scenario, starts, steps), np.random.default_rng(0))
    simulated = rmse_db(site, truth_db, found.posterior.mean_db)
    assert live <= simulated + (flat - simulated) / 3


def test_the_page_and_the_status_tell_of_it(flown) -> None:
    with Mission.opened(flown.folder) as mission:
        taken = mission.journal.events("replanned")
        count = mission.journal.count
    with served(flown.folder) as address, httpx.Client(base_url=address, timeout=60) as client:
        story = client.get("/api/story").json()
        assert len(client.get("/api/readings?after=10").json()["level"]) == count - 10
        curve = {"whole": False}
        while not curve["whole"]:
            curve = client.get("/api/curve").json()
    ways = [(way["at"], way["uav"]) for way in story["ways"]]
    assert ways[3:] == [(event["id"], event["uav"]) for event in taken]
    moments = story["moments"]
    assert {"planned", "ingested", "lost", "replanned", "flown"} <= {m["kind"] for m in moments}
    counts = [moment["count"] for moment in moments]
    assert counts == sorted(counts)
    assert counts[-1] == count
    assert [k for k, _ in curve["points"]][:: len(curve["points"]) - 1] == [0, count]
    assert curve["points"][-1][1] < curve["points"][0][1]
    told = run_status(MissionStatusRequest(folder=flown.folder), SILENT)
    assert "stop: " in told
    assert (flown.folder / "map" / "report.html").is_file()
