"""How long Kriging takes: one update beside other libraries, and large surveys."""

from __future__ import annotations

import multiprocessing
import resource
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.cities.manhattan import ManhattanConfig, manhattan_city
from skygain.city import City
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.posterior import Posterior
from skygain.predictors import create_predictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.gudmundson import shadowing_db
from skygain.scenario import Scenario

MEAN_DB, SILL_DB2, RANGE_M = -110.0, 380.0, 57.0
PARAMETERS = KrigingParameters.known_trend(MEAN_DB, sill_db2=SILL_DB2, range_m=RANGE_M)
OURS = "kriging-blind"
RIVALS = ("pykrige", "gstools", "sklearn-gp", "gpytorch")


def updates(side: int, measured: int, new: int) -> tuple[dict[str, Callable[[], Posterior]], Any]:
    """What each method is asked for, and the cells that nobody measured."""
    rng = np.random.default_rng(0)
    grid = Grid((side, side), 4.0)
    scenario = Scenario(City(grid, np.zeros(grid.shape, dtype=np.float32)))
    cells = rng.permutation(grid.cells)[: measured + new]
    distance = np.linalg.norm(grid.xy_m(cells)[:, None] - grid.xy_m(cells)[None], axis=-1)
    root = np.linalg.cholesky(SILL_DB2 * np.exp(-distance / RANGE_M) + 1e-9 * np.eye(len(cells)))
    gain_db = MEAN_DB + root @ rng.standard_normal(len(cells))
    free = np.ones(grid.shape, dtype=bool)
    free[tuple(cells.T)] = False
    known = Measurements.at(cells[:-new], gain_db[:-new])
    more = Measurements.at(cells[-new:], gain_db[-new:])
    found = {}
    for name in (OURS, *RIVALS):
        options = {"refit": False} if name == OURS else {}
        predictor = create_predictor(name, parameters=PARAMETERS, **options)
        belief = predictor.begin(scenario).updated(known)
        belief.posterior()
        found[name] = lambda belief=belief: belief.updated(more).posterior()
    return found, free


@study(
    "kriging_update",
    measured=Option(600, "values known before"),
    new=Option(3, "values that arrive"),
    side=Option(96, "cells along the edge of the map"),
    rounds=Option(15, "rounds, all methods in turn"),
)
def kriging_update(run: Run) -> list[Table]:
    """How long a Kriging belief takes to learn three more values, beside four other libraries.

    Covariance and mean are fixed and the same for all, nothing is fitted; every method gives mean
    and variance at every cell. All take turns within a round, so that whatever else the machine
    does falls on all of them. PyKrige has ordinary Kriging only, whose mean is estimated.
    """
    o = run.options
    warnings.simplefilter("ignore")

    def measure() -> dict[str, list[float]]:
        methods, free = updates(o.side, o.measured, o.new)
        answers = {name: update() for name, update in methods.items()}  # also compiles
        times: dict[str, list[float]] = {name: [] for name in methods}
        for _ in range(o.rounds):
            for name, update in methods.items():
                start = time.perf_counter()
                update()
                times[name].append(1e3 * (time.perf_counter() - start))
        ours, mine = np.array(times[OURS]), answers[OURS]
        found = {}
        for name, posterior in answers.items():
            mean = np.abs(posterior.mean_db - mine.mean_db)[free].max()
            variance = np.abs(posterior.variance_db2 - mine.variance_db2)[free].max()
            ms = np.array(times[name])
            ratio = np.median(ms / ours)
            found[name] = [np.median(ms), ms.min(), ratio, mean, variance]
        return found

    found = run.once((o.measured, o.new, o.side, o.rounds), measure)
    rows = [
        [name, f"{median:.2f}", f"{best:.2f}", f"{ratio:.1f}", f"{mean:.1e}", f"{variance:.1e}"]
        for name, (median, best, ratio, mean, variance) in found.items()
    ]
    title = (
        f"{o.new} new values on {o.measured} measured, {o.side} × {o.side} cells; {o.rounds} "
        "rounds, all methods in turn, one thread. Times ours: median of the rounds' ratios."
    )
    head = ["method", "median ms", "best ms", "times ours", "largest difference: mean, dB"]
    return [Table(title, [*head, "variance, dB²"], rows)]


NEW = 50
EXACT_LIMIT = 2e7
"""ordinary Kriging runs beside local Kriging where measurements × cells stay below this"""


def peak_mib() -> float:
    """Largest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def timed(
    predictor: str, grid: Grid, cells: np.ndarray, gain_db: np.ndarray
) -> tuple[list[float], Posterior]:
    """Seconds for all measurements at once and for the last `NEW`, MiB added, and the posterior."""
    scenario = Scenario(City(grid, np.zeros(grid.shape, dtype=np.float32)))
    belief = create_predictor(predictor, parameters=PARAMETERS, refit=False).begin(scenario)
    before, began = peak_mib(), time.perf_counter()
    belief = belief.updated(Measurements.at(cells[:-NEW], gain_db[:-NEW]))
    belief.posterior()
    whole = time.perf_counter() - began
    began = time.perf_counter()
    posterior = belief.updated(Measurements.at(cells[-NEW:], gain_db[-NEW:])).posterior()
    return [whole, time.perf_counter() - began, peak_mib() - before], posterior


def one_size(side: int, count: int) -> list[str]:
    """The row of one size; runs in a process of its own, whose peak memory is its own too."""
    small = Grid((20, 20), 4.0)
    timed("local-kriging", small, small.cells[: 2 * NEW], np.full(2 * NEW, MEAN_DB))  # compiles
    rng = np.random.default_rng(0)
    grid = Grid((side, side), 4.0)
    cells = grid.cells[rng.permutation(grid.size)[: count + NEW]]
    gain_db = MEAN_DB + shadowing_db(grid, rng)[tuple(cells.T)]
    (whole, step, added), posterior = timed("local-kriging", grid, cells, gain_db)
    row = [f"{grid.size:,}", f"{count:,}", f"{whole:.2f}", f"{step:.3f}"]
    row += [f"{peak_mib():.0f}", f"{added:.0f}"]
    if count * grid.size > EXACT_LIMIT:
        return [*row, "–", "–", "–", "–"]
    (whole, step, _), exact = timed("kriging-blind", grid, cells, gain_db)
    unseen = exact.std_db > 0.1
    gap = np.abs(posterior.mean_db - exact.mean_db)[unseen] / exact.std_db[unseen]
    rms = np.sqrt(np.mean(gap**2))
    return [*row, f"{whole:.2f}", f"{step:.3f}", f"{rms:.3f}", f"{gap.max():.2f}"]


@study(
    "local_kriging_scaling",
    sides=Option((100, 316, 1000), "cells along the edge of the map"),
    counts=Option((100, 1000, 10_000, 100_000), "measurements"),
)
def local_kriging_scaling(run: Run) -> list[Table]:
    """Time and memory of local Kriging from 10² to 10⁵ measurements and 10⁴ to 10⁶ cells.

    Measurements scattered at random arrive at once and the map is predicted; then 50 more arrive,
    and mean and variance are wanted at every cell again. Kriging with all readings runs beside it
    on the smaller sizes.
    """
    context = multiprocessing.get_context("spawn")

    def alone(side: int, count: int) -> list[str]:
        with context.Pool(1) as pool:
            return pool.apply(one_size, (side, count))

    rows = [
        run.once((side, count), lambda s=side, n=count: alone(s, n))
        for side in run.options.sides
        for count in run.options.counts
        if count + NEW <= side * side
    ]
    title = (
        f"32 neighbours, covariance given; a step brings {NEW} new measurements. Memory is what "
        "the process had at its peak, and how much of it the two updates added. Differences of the "
        "means in standard deviations."
    )
    head = ["cells", "measurements", "whole map, s", "one step, s", "peak memory, MiB"]
    head += ["added, MiB", "Kriging: whole map, s", "one step, s", "difference, rms", "largest"]
    return [Table(title, head, rows)]


BLOCK_M = 97.2
"""side of a block of the cities with a street, so that large ones have as many"""


@study(
    "local_cover",
    sides=Option((300, 700), "cells along the edge of the map"),
    cities=Option((8, 9), "seeds of the cities"),
)
def local_cover(run: Run) -> list[Table]:
    """How often local Kriging's 90 % interval holds the truth on maps much larger than the survey.

    Over-rooftop gain of a transmitter in the middle of a generated city; three UAVs start close to
    each other, once anywhere and once around the transmitter, and fly 300 steps of random
    waypoints.
    """
    rows = []
    for side in run.options.sides:
        for seed in run.options.cities:
            found = run.once((side, seed), lambda s=side, c=seed: covers(s, c))
            rows += [[f"{side:,} × {side:,}", f"{seed}", *row] for row in found]
    title = "Three UAVs, 300 steps; RMSE and standard deviation in dB over unvisited outdoor cells."
    head = ["cells", "city", "start", "told", "RMSE", "root mean variance", "90 % cover"]
    return [Table(title, head, rows)]


def covers(side: int, seed: int) -> list[list[str]]:
    """Rows of one city: where the swarm starts, whether the transmitter is told, and how the map
    agrees."""
    extent = side * 4.0
    city = manhattan_city(seed, ManhattanConfig(extent_m=extent, blocks=round(extent / BLOCK_M)))
    free = np.argwhere(city.height_m == 0)
    middle = free[np.argmin(((free - side / 2) ** 2).sum(axis=1))]
    x, y = city.grid.xy_m(middle[None])[0].tolist()
    source = (x, y, 1.5)
    told = Scenario(city, transmitter_m=source)
    gain = over_rooftop_gain_db(city, [source], [told.uav_altitude_m], frequency_hz=5e9)
    truth_db = np.asarray(gain, dtype=float).reshape(city.grid.shape)
    rows = []
    for start in ("anywhere", "at the transmitter"):
        rng = np.random.default_rng(seed)
        cells = start_cells("cluster", told, 3, rng)
        if start != "anywhere":
            cells = free[np.argsort(((free - middle) ** 2).sum(axis=1))[:3]]
        swarm = Swarm.deployed(told, cells, 300)
        paths = create_planner("random-waypoint").plan(swarm, None, 300, rng).paths.reshape(-1, 2)
        for scenario in (told, told.without_transmitter()):
            belief = create_predictor("local-kriging").begin(scenario)
            for part in np.array_split(paths, 4):
                belief = belief.updated(Measurements.at(part, truth_db[tuple(part.T)]))
            left = told.outdoor.copy()
            left[tuple(paths.T)] = False
            posterior = belief.posterior()
            error, std = (posterior.mean_db - truth_db)[left], posterior.std_db[left]
            rows.append(
                [
                    start,
                    "no" if scenario.transmitter_m is None else "yes",
                    f"{np.sqrt(np.mean(error**2)):.1f}",
                    f"{np.sqrt(np.mean(std**2)):.1f}",
                    f"{np.mean(np.abs(error) <= 1.645 * std):.1%}",
                ]
            )
    return rows
