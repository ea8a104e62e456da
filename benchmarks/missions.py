"""Missions: what a sortie's flight time buys, and how long a new plan takes."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.cities import Reading
from skygain.city import City
from skygain.datasets.cases import Case, largest_part, survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.flight.swarm import FlightRules, Swarm
from skygain.ground.errors import require
from skygain.measurements import Measurements
from skygain.missions.clearance import Airspace, obstacles
from skygain.missions.folder import Mission
from skygain.missions.journal import Journal
from skygain.missions.live import FLYING, LiveFlight
from skygain.missions.planning import plan_sortie, staggered
from skygain.missions.rehearsal import rehearse
from skygain.missions.requests import MissionNewRequest
from skygain.missions.site import Site, open_site
from skygain.missions.sortie import Flight, flight_along
from skygain.missions.vehicle_link import Heard
from skygain.planners import create_planner
from skygain.survey.methods import planner, predictor

CRS, CORNER_M = "EPSG:32632", (500_000.0, 5_538_000.0)
CLEARANCE_M, SEPARATION_M, SPEED_MPS, ALTITUDE_M = 4.0, 12.0, 5.0, 10.0
WAYS = {
    "planned before": "closed tours, found before take-off",
    "planned live": "closed tours, found anew every 15 s with what was read",
    "lawnmower": "coordinated lawnmower, the closest lanes the battery allows",
}


@lru_cache(maxsize=2)
def placed(case: Case) -> City:
    """The case's city somewhere on Earth."""
    city = case.crop.city
    grid = city.grid
    buildings = tuple(b.shifted(*CORNER_M) for b in city.buildings)
    origin = (grid.origin_m[0] + CORNER_M[0], grid.origin_m[1] + CORNER_M[1])
    return replace(city, grid=replace(grid, crs=CRS, origin_m=origin), buildings=buildings)


def site_of(case: Case, uavs: int, battery_min: float) -> Site:
    """A mission from the clear cell nearest to the middle of the case's map."""
    city = placed(case)
    shapely = require("shapely", "geo")
    solid = obstacles(city, ALTITUDE_M, CLEARANCE_M, None)
    space = Airspace.clear_of(city.grid, shapely.box(*city.grid.bounds_m), solid, CLEARANCE_M)
    cells = np.argwhere(largest_part(space.flyable))
    middle = (np.array(city.grid.shape) - 1) / 2
    cell = cells[np.abs(cells - middle).sum(axis=1).argmin()]
    latitude, longitude = city.grid.latlon(cell)
    request = MissionNewRequest(
        folder=Path("unused"),
        city="T2",
        uavs=uavs,
        home=f"{latitude:.9f},{longitude:.9f}",
        altitude_m=ALTITUDE_M,
        speed_mps=SPEED_MPS,
        battery_min=battery_min,
        clearance_m=CLEARANCE_M,
        separation_m=SEPARATION_M,
    )
    return open_site(request, Reading(city))


def lawnmower_flights(site: Site) -> list[Flight]:
    """Lanes as close as all batteries allow, flown by the same rules as tours: stairs around
    buildings straightened, corners flown through, readings on the way home taken too."""
    start = np.array([pad.cell for pad in site.pads])
    most = int(site.request.usable_s * SPEED_MPS / site.grid.spacing_m)
    for share in np.arange(1.0, 0.3, -0.05):
        swarm = Swarm.deployed(site.scenario, start, int(share * most), FlightRules())
        paths = create_planner("lawnmower").plan(
            swarm, None, int(share * most), np.random.default_rng(0)
        ).paths  # fmt: skip
        flights = [flight_along(site, k, path, site.ways_home[k]) for k, path in enumerate(paths)]
        if max(f.air_s for f in flights) <= site.request.usable_s:
            break
    return flights


def flown(case: Case, way: str, name: str, battery_min: float, uavs: int) -> list[list[float]]:
    """(RMSE in dB over all outdoor cells, mean seconds in the air, seconds from the first take-off
    to the last landing) of one sortie; for tours as planned before and as planned live."""
    site = site_of(case, uavs, battery_min)
    truth_db = case.truth_db.astype(float)

    def read(cells: np.ndarray) -> Measurements:
        return Measurements.at(cells, truth_db[cells[:, 0], cells[:, 1]])

    prior = predictor(name).begin(site.scenario)
    if way == "lawnmower":
        one_each = [[flight] for flight in lawnmower_flights(site)]
        sorties = [staggered(site, range(uavs), one_each)[0]]
    else:
        chooser = planner("sequential-greedy")
        before = plan_sortie(site, prior, chooser, np.random.default_rng(case.seed))
        live = rehearse(site, prior, before, read, chooser)
        sorties = [list(before.flights), list(live.flights)]
    found = []
    for flights in sorties:
        cells = np.unique(np.concatenate([f.read_cells for f in flights]), axis=0)
        mean = prior.updated(read(cells)).posterior().mean_db
        outdoor = site.scenario.outdoor & np.isfinite(truth_db)
        rmse = float(np.sqrt(((mean - truth_db)[outdoor] ** 2).mean()))
        last = max(f.timeline.landed_s for f in flights)
        found.append([rmse, float(np.mean([f.air_s for f in flights])), float(last)])
    return found


@study(
    "mission_flight_time",
    data="DATA",
    cities=Option(12, "surveys of T2, a city each first"),
    uavs=Option(3, "UAVs"),
    batteries=Option((2.5, 4.0, 6.0), "minutes of battery"),
    predictor=Option("operator", "predictor of all ways; it is told nothing"),
)
def mission_flight_time(run: Run) -> list[Table]:
    """What the flight time of a sortie buys: tours planned before take-off, planned live, and
    lawnmower legs with the same area, clearance, battery and rules of flight, on cities of T2 as
    footprints."""
    o = run.options
    cases = survey_cases(ChannelDataset.open(run.data), "T2", max_surveys=o.cities)
    curves: dict[str, list[list[float]]] = {way: [] for way in WAYS}
    rows = []
    for battery in o.batteries:
        found = [
            [
                run.once(
                    (way, case.link, battery, o.uavs, o.predictor),
                    lambda c=case, w=way, b=battery: flown(c, w, o.predictor, b, o.uavs),
                )
                for way in ("tours", "lawnmower")
            ]
            for case in cases
        ]
        mean = np.mean([[*tours, *lawnmower] for tours, lawnmower in found], axis=0)
        row = [f"{battery:g} min"]
        for way, (rmse, air_s, last_s) in zip(WAYS, mean, strict=True):
            curves[way].append([float(air_s), float(rmse)])
            row.append(f"{rmse:.2f} ({air_s / 60:.1f}, {last_s / 60:.1f} min)")
        rows.append(row)
    title = (
        f"RMSE in dB over outdoor cells after one sortie of {o.uavs} UAVs, in brackets the mean "
        f"time in the air and the time from the first take-off to the last landing; {o.predictor}, "
        f"exact readings, {len(cases)} surveys of T2, {SPEED_MPS:g} m/s, {CLEARANCE_M:g} m of "
        "clearance, 20 % reserve."
    )
    return [
        Table(title, ["battery", *WAYS], rows),
        Table(
            "Time in the air against the lawnmower's for the RMSE that it reaches with each "
            "battery, from the curves above.",
            ["the lawnmower's battery", *(way for way in WAYS if way != "lawnmower")],
            [
                [
                    f"{battery:g} min",
                    *(share(curves[w], curves["lawnmower"][k]) for w in WAYS if w != "lawnmower"),
                ]
                for k, battery in enumerate(o.batteries)
            ],
        ),
    ]


def share(curve: list[list[float]], goal: list[float]) -> str:
    """Time at which ``curve`` reaches the error of ``goal``, in units of the time of the latter."""
    goal_s, error = goal
    seconds, rmse = np.array(curve).T
    reached = np.flatnonzero(rmse <= error)
    if not len(reached):
        return "not reached"
    k = int(reached[0])
    if k == 0:
        return f"below {seconds[0] / goal_s:.2f}"
    part = (rmse[k - 1] - error) / (rmse[k - 1] - rmse[k])
    return f"{(seconds[k - 1] + part * (seconds[k] - seconds[k - 1])) / goal_s:.2f}"


@dataclass
class Silent:
    """A vehicle that answers at once and says where it is when asked."""

    heard: Heard = field(default_factory=Heard)

    def silent_s(self) -> float:
        return 0.0


@study(
    "mission_replan",
    data="DATA",
    uavs=Option((3, 10), "UAVs"),
    passed=Option(30, "cells that every UAV has passed"),
)
def mission_replan(run: Run) -> list[Table]:
    """CPU seconds until all vehicles of a live flight have new plans, on a map of 96 × 96 cells,
    checks included, upload not."""
    case = survey_cases(ChannelDataset.open(run.data), "T2", max_surveys=1)[0]
    rows = []
    for n in run.options.uavs:
        seconds = run.once((n, run.options.passed), lambda n=n: replanned(case, n, run.options))
        rows.append([f"{n}", f"{sum(seconds):.2f}", f"{max(seconds):.2f}"])
    title = "One thread, one city of T2; every vehicle in turn, a tour as long as its battery."
    return [Table(title, ["UAVs", "all, CPU s", "slowest vehicle, CPU s"], rows)]


def replanned(case: Case, n: int, options: Any) -> list[float]:
    """CPU seconds of each vehicle's new plan, after everything was compiled."""
    site = site_of(case, n, 18.0)
    truth_db = case.truth_db.astype(float)
    method = site.request
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "journal.sqlite"
        with Journal(path, create=True) as journal:
            mission = Mission(Path(folder), method, journal)
            mission.__dict__["site"] = site
            prior = predictor("kriging-blind").begin(site.scenario)
            chooser = planner("sequential-greedy")
            rng = np.random.default_rng(0)
            sortie = plan_sortie(site, prior, chooser, rng)
            live = LiveFlight(mission, sortie, [Silent() for _ in sortie.flights])  # type: ignore[list-item]
            cells = np.concatenate([f.cells[: options.passed] for f in sortie.flights])
            belief = prior.updated(Measurements.at(cells, truth_db[cells[:, 0], cells[:, 1]]))
            for rider in live.riders:
                rider.state, rider.done = FLYING, options.passed
                way = site.grid.xy_m(rider.flight.cells[: options.passed + 1])
                xy = way[-1]
                latitude, longitude = site.latlon(xy)
                rider.link.heard.latitude = float(latitude)
                rider.link.heard.longitude = float(longitude)
                rider.link.heard.place_s = time.monotonic()
                moment = rider.flight.moments_s(way)[-1]
                rider.began_s = rider.up_s = live.now() - float(moment)
            live.planned(live.riders[0], belief)
            seconds = []
            for rider in live.riders:
                began = time.process_time()
                live.planned(rider, belief)
                seconds.append(time.process_time() - began)
    return seconds
