"""Few readings, and real ones: signal levels recorded on a campus.

The campus protocol is that of the data set's authors (Geo2SigMap, IEEE DySPAN 2024): 4 m cells in a
512 m box, a few random cells are known, and the error is taken over all other recorded cells. A
second, harder test leaves a whole 100 m square out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import Table
from benchmarks.study import Option, Run, signed, study
from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.evaluation.metrics import score
from skygain.evaluation.rollout import flown
from skygain.evaluation.statistics import bootstrap_mean
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import require
from skygain.instruments import (
    GriddedRecording,
    ReplayInstrument,
    on_grid,
    read_recording,
    replay_scenario,
    replay_truth,
)
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.predictors import Belief, Predictor, create_predictor
from skygain.predictors.kriging.parameters import trained_parameters
from skygain.scenario import Scenario
from skygain.survey.methods import MethodSpec

NORTH_WEST = (36.001483, -78.942737)
BASE_STATION = (35.999186, -78.939786)
BASE_STATION_HEIGHT_M = 20.0
"""not published; a rooftop mast, and at the distances of this box a few metres more or less change
little"""
PHONE_HEIGHT_M = 1.5
SIDE_M, SPACING_M, SQUARE_M = 512.0, 4.0, 100.0
FREQUENCY_HZ = {"A": 3.69e9, "B": 3.64e9, "C": 3.58e9}
DEVICES = ("Samsung", "Pixel")


def widened(intercept_db: float, slope_db: float) -> Predictor:
    """Kriging with known transmitter and a survey's own path-loss line.

    Levels in dBm are gains plus an unknown constant, so the trained intercept means nothing here
    and its prior is opened; with ``slope_db`` the prior of the slope is opened as well. Both are
    standard deviations added to the trained ones.
    """
    trained = trained_parameters("log-distance", PHONE_HEIGHT_M)
    covariance = np.array(trained.trend_covariance) + np.diag([intercept_db**2, slope_db**2])
    opened = replace(trained, trend_covariance=tuple(map(tuple, covariance.tolist())))
    return create_predictor("kriging", parameters=opened)


class ToldStreetLevel(Predictor):
    """Kriging that is told, wrongly, what its training assumed: a transmitter at 1.5 m and
    receivers that fly at 10 m."""

    transmitter = "required"

    def begin(self, scenario: Scenario) -> Belief:
        assert scenario.transmitter_m is not None
        position = (*scenario.transmitter_m[:2], 1.5)
        told = replace(
            scenario, transmitter_m=position, uav_altitude_m=10.0, prediction_altitude_m=10.0
        )
        return create_predictor("kriging").begin(told)


VARIANTS: dict[str, Callable[[], Predictor]] = {
    "kriging+street": ToldStreetLevel,
    "kriging+intercept": lambda: widened(100.0, 0.0),
    "kriging+line": lambda: widened(100.0, 30.0),
}


def method(name: str) -> Predictor:
    """A registered predictor or one of `VARIANTS`."""
    return VARIANTS[name]() if name in VARIANTS else create_predictor(name)


@dataclass(frozen=True)
class Series:
    """One cell as one phone recorded it."""

    name: str
    """cell and phone"""
    gridded: GriddedRecording
    """on the box's grid"""
    scenario: Scenario
    """what a predictor may know"""


def open_series(path: Path) -> list[Series]:
    """The six series in the authors' box, in UTM zone 17N."""
    pyproj = require("pyproj", "geo")
    west, north = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32617", always_xy=True).transform(
        *NORTH_WEST[::-1]
    )
    side, half = round(SIDE_M / SPACING_M), SPACING_M / 2
    origin = (west + half, north - SIDE_M + half)
    grid = Grid((side, side), SPACING_M, origin, crs="EPSG:32617")
    x, y = grid.xy_m_at_latlon(BASE_STATION)
    station = (float(x), float(y), BASE_STATION_HEIGHT_M)
    found = []
    for pci, frequency_hz in FREQUENCY_HZ.items():
        for device in DEVICES:
            recording = read_recording(path, where={"PCI": pci, "device": device})
            gridded = on_grid(recording, grid)
            scenario = replay_scenario(
                gridded,
                uav_altitude_m=PHONE_HEIGHT_M,
                transmitter_m=station,
                frequency_hz=frequency_hz,
            )
            found.append(Series(f"{pci}/{device}", gridded, scenario))
    return found


def drawn(gridded: GriddedRecording, test: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(order in which cells are given, cells that are never given).

    ``random`` holds none back; ``square`` those of a 100 m square around a random recorded cell,
    at least 20 of them.
    """
    rng = np.random.default_rng([seed, ("random", "square").index(test), len(gridded)])
    if test == "random":
        return rng.permutation(len(gridded)), np.empty(0, dtype=np.int64)
    while True:
        centre = gridded.cell[rng.integers(len(gridded))]
        inside = np.abs(gridded.cell - centre).max(axis=1) * gridded.grid.spacing_m <= SQUARE_M / 2
        if 20 <= inside.sum() <= len(gridded) / 2:
            return rng.permutation(np.flatnonzero(~inside)), np.flatnonzero(inside)


def trial(series: Series, test: str, seed: int, name: str, samples: int) -> list[float]:
    """RMSE and cover of the 90 % interval of one method, given some cells, asked for others.

    The interval has the uncertainty of the recorded values in it. In small series fewer cells than
    asked for are given.
    """
    gridded = series.gridded
    order, held_back = drawn(gridded, test, seed)
    given = order[:samples]
    asked = held_back if test == "square" else order[samples:]
    cells = tuple(gridded.cell[asked].T)
    readings = gridded.measurements().taken(given)
    posterior = method(name).begin(series.scenario).updated(readings).posterior()
    error = posterior.mean_db[cells] - replay_truth(gridded)[cells]
    std = np.sqrt(posterior.variance_db2[cells] + gridded.noise_std_db[asked] ** 2)
    inside = np.abs(error) <= 1.6448536 * std
    return [float(np.sqrt(np.mean(error**2))), float(inside.mean())]


@study(
    "duke_cbrs",
    data="DUKE_CSV",
    methods=Option(
        ("knn", "idw", "sklearn-gp", "kriging-blind", "kriging", *VARIANTS), "the methods"
    ),
    samples=Option((10, 30, 100, 200), "cells given"),
    seeds=Option(8, "draws of the cells, 2 or more"),
)
def duke_cbrs(run: Run) -> list[Table]:
    """Real measurements: RSRP of three cells on a campus, mapped from 10 to 200 of its grid cells.

    Random cells lie along the same streets as the cells they predict. The second test leaves a
    whole 100 m square out.
    """
    o = run.options
    every = open_series(run.data)
    groups = np.repeat(np.arange(len(every)), o.seeds)

    def found(test: str, name: str, samples: int, which: list[Series] = every) -> np.ndarray:
        """``[survey, (RMSE, cover)]``"""
        return np.array(
            [
                run.once(
                    (s.name, test, seed, name, samples),
                    lambda s=s, k=seed: trial(s, test, k, name, samples),
                )
                for s in which
                for seed in range(o.seeds)
            ]
        )

    most = o.samples[-1]
    titles = {
        "random": "random cells, error over all other recorded cells",
        "square": "a 100 m square left out, error inside it",
    }
    tables = []
    for test, title in titles.items():
        rows = []
        for name in o.methods:
            row = [name]
            for samples in o.samples:
                rmse = found(test, name, samples)[:, 0]
                gap = bootstrap_mean(rmse - found(test, "idw", samples)[:, 0], groups)
                bracket = "" if name == "idw" else f" [{gap.low:+.2f}, {gap.high:+.2f}]"
                row.append(f"{rmse.mean():.2f}{bracket}")
            rows.append([*row, f"{found(test, name, most)[:, 1].mean():.0%}"])
        text = (
            f"RMSE in dB, {title}; mean over {len(every)} series and {o.seeds} seeds. Brackets: "
            "difference to IDW on the same cells, 95 % bootstrap interval over series."
        )
        head = ["method", *(f"{n} cells" for n in o.samples)]
        tables.append(Table(text, [*head, f"90 % interval covers, {most} cells"], rows))
    rows = []
    for series in every:
        at = [found("random", name, most, [series])[:, 0] for name in o.methods]
        cells = [f"{rmse.mean():.2f} ± {rmse.std(ddof=1):.2f}" for rmse in at]
        rows.append([series.name, f"{len(series.gridded)}", *cells])
    text = (
        f"RMSE in dB on each series: mean ± standard deviation over {o.seeds} seeds, {most} random "
        "cells."
    )
    tables.append(Table(text, ["series", "recorded cells", *o.methods], rows))
    return [*tables, series_facts(every), averages_compared(run, every[0])]


def series_facts(every: list[Series]) -> Table:
    """What distance to the base station explains of each series, and how noisy its cells are."""
    rows = []
    for series in every:
        gridded, station = series.gridded, series.scenario.transmitter_m
        heights = np.full(len(gridded), PHONE_HEIGHT_M)
        offset = np.column_stack([gridded.grid.xy_m(gridded.cell), heights]) - station
        distance = np.linalg.norm(offset, axis=1)
        columns = np.column_stack([np.ones(len(gridded)), -np.log10(distance)])
        line = np.linalg.lstsq(columns, gridded.level_db, rcond=None)[0]
        left = np.std(gridded.level_db - columns @ line)
        noise = np.sqrt(np.mean(gridded.noise_std_db**2))
        numbers = [f"{v:.1f}" for v in (line[1], gridded.level_db.std(), left, noise)]
        rows.append([series.name, f"{line[0]:.0f}", *numbers])
    text = (
        "Each series as recorded: RSRP = a − b·log₁₀(distance in m) by least squares over its "
        "cells, and the root mean square of the standard deviation given to its cells' values, "
        "which is a part of every error above."
    )
    head = ["series", "a, dBm", "b, dB per decade", "standard deviation, dB"]
    return Table(text, [*head, "left by the line, dB", "noise of the cells, dB"], rows)


def averages_compared(run: Run, series: Series) -> Table:
    """The error at the largest sample when the readings of a cell are averaged in other ways."""
    o, gridded = run.options, series.gridded
    pci, device = series.name.split("/")
    recording = read_recording(run.data, where={"PCI": pci, "device": device})
    assert recording.latlon is not None
    cells = gridded.grid.cells_at(gridded.grid.xy_m_at_latlon(recording.latlon))
    on_map = gridded.grid.contains(cells)
    flat = gridded.grid.flat(cells[on_map])
    _, group, count = np.unique(flat, return_inverse=True, return_counts=True)
    level = recording.level_db[on_map]
    ways = {
        "mean in dB of distinct readings": gridded.level_db,
        "mean in dB of all readings, copies included": np.bincount(group, level) / count,
        "mean of powers": 10 * np.log10(np.bincount(group, 10 ** (level / 10)) / count),
    }
    rows = []
    for way, levels in ways.items():
        other = replace(series, gridded=replace(gridded, level_db=levels))
        rmse = [
            run.once(
                (way, seed, o.samples[-1]),
                lambda s=other, k=seed: trial(s, "random", k, "kriging-blind", o.samples[-1])[0],
            )
            for seed in range(o.seeds)
        ]
        rows.append([way, f"{np.mean(rmse):.2f} ± {np.std(rmse, ddof=1):.2f}"])
    text = f"Readings of a cell averaged in three ways: kriging-blind on {series.name}."
    return Table(text, ["average", "RMSE dB"], rows)


@study(
    "replay_reach",
    data="DUKE_CSV",
    reaches=Option((4.0, 8.0, 20.0, 40.0, np.inf), "metres; inf is the whole map"),
    planners=Option(("random-waypoint", "greedy-variance"), "planners"),
    seeds=Option(6, "surveys of each series"),
    steps=Option(200, "steps of a survey"),
)
def replay_reach(run: Run) -> list[Table]:
    """How far from the recorded cells UAVs should fly when a campaign is flown over again.

    The default of `replay_scenario` rests on this. Near the recording every step finds a reading,
    but the way along the streets is long; far from it UAVs move freely and find little.
    Constant-trend Kriging, 3 UAVs, cluster start.
    """
    o = run.options
    every = open_series(run.data)

    def survey(series: Series, reach: float, planner: str, seed: int) -> list[float]:
        """(recorded cells measured, RMSE over the others)."""
        gridded = series.gridded
        scenario = replay_scenario(
            gridded,
            uav_altitude_m=PHONE_HEIGHT_M,
            reach_m=reach if np.isfinite(reach) else None,
        )
        rng = np.random.default_rng(seed)
        cells = start_cells("cluster", scenario, 3, rng)
        measured: list[int] = []

        def observe(step: int, swarm: Swarm, belief: Belief) -> None:
            measured.append(int(belief.measurements.visited(gridded.grid.shape).sum()))

        found = flown(
            scenario,
            MethodSpec("kriging-blind", planner),
            ReplayInstrument(gridded),
            replay_truth(gridded),
            cells,
            steps=o.steps,
            record_steps=[o.steps],
            rng=rng,
            observe=observe,
        )
        return [measured[-1], found["scores"]["rmse_db"][-1]]

    def results(reach: float, planner: str) -> np.ndarray:
        return np.array(
            [
                run.once(
                    (series.name, reach, planner, seed, o.steps),
                    lambda s=series, k=seed: survey(s, reach, planner, k),
                )
                for series in every
                for seed in range(o.seeds)
            ]
        ).T

    rows = []
    for reach in o.reaches:
        whole = not np.isfinite(reach)
        flyable = [
            replay_scenario(
                s.gridded, uav_altitude_m=PHONE_HEIGHT_M, reach_m=None if whole else reach
            ).flyable.sum()
            for s in every
        ]
        row = ["whole map" if whole else f"{reach:g} m", f"{np.mean(flyable):.0f}"]
        for planner in o.planners:
            cells, rmse = results(reach, planner)
            gap = rmse - results(o.reaches[0], planner)[1]
            error = gap.std(ddof=1) / np.sqrt(len(gap))
            row += [f"{cells.mean():.0f}", f"{rmse.mean():.2f}", f"{gap.mean():+.2f} ± {error:.2f}"]
        rows.append(row)
    head = ["reach", "flyable cells"]
    for planner in o.planners:
        head += [f"{planner}: cells measured", f"{planner}: RMSE, dB"]
        head.append(f"{planner}: difference to {o.reaches[0]:g} m")
    title = (
        f"Means over {len(every)} series and {o.seeds} seeds, 3 UAVs, {o.steps} steps, cluster "
        "start; ± is the standard error of the paired difference."
    )
    return [Table(title, head, rows)]


UAVS, STEPS = 3, (3, 6, 9)


def along(case: Case) -> np.ndarray:
    """``[k, (row, col)]`` cells in the order in which random waypoints come to them."""
    swarm = Swarm.deployed(case.scenario(), case.start_cells, STEPS[-1])
    planner = create_planner("random-waypoint")
    paths = planner.plan(swarm, None, STEPS[-1], case.rng()).paths  # type: ignore[arg-type]
    return paths.transpose(1, 0, 2).reshape(-1, 2)


def scattered(case: Case) -> np.ndarray:
    """``[k, (row, col)]`` random outdoor cells."""
    cells = np.argwhere(case.scenario().outdoor)
    return case.rng().permutation(cells)[: UAVS * (STEPS[-1] + 1)]


def errors(case: Case, cells: np.ndarray, name: str) -> list[float]:
    """RMSE after each number of readings, taken in step by step."""
    predictor, truth = create_predictor(name), case.truth_db
    scenario = case.scenario(transmitter_known=predictor.transmitter == "required")
    belief, found = predictor.begin(scenario), []
    for step, some in enumerate(np.split(cells, STEPS[-1] + 1)):
        belief = belief.updated(Measurements.at(some, truth[tuple(some.T)]))
        if step in STEPS:
            visited = belief.measurements.visited(truth.shape)
            found.append(score(belief.posterior(), truth, scenario.outdoor, visited)["rmse_db"])
    return found


@study(
    "few_samples",
    data="DATA",
    split=Option("T2", "split of the data set"),
    surveys=Option(50, "surveys"),
    methods=Option(
        ("kriging", "kriging-inferred", "kriging-blind", "kriging-quadratic", "local-kriging"),
        "compared with idw",
    ),
)
def few_samples(run: Run) -> list[Table]:
    """Kriging against inverse distance weighting when there are only 12 to 30 readings.

    A covariance fitted to a handful of readings can be far off, and then Kriging is worse than a
    method that fits nothing. Readings are scattered, or lie along random waypoints of three UAVs
    that start together or anywhere, 3, 6 and 9 steps.
    """
    o = run.options
    dataset = ChannelDataset.open(run.data)
    cluster, spread = (
        survey_cases(dataset, o.split, n_uavs=UAVS, start=start, max_surveys=o.surveys)
        for start in ("cluster", "spread")
    )
    cities = [case.city_index for case in cluster]
    rows: list[list[Any]] = []
    for place, cases, chosen in (
        ("scattered", cluster, scattered),
        ("random waypoints, cluster start", cluster, along),
        ("random waypoints, spread start", spread, along),
    ):
        rmse = {
            name: np.array(
                [
                    run.once(
                        (place, name, o.split, case.link),
                        lambda c=case, n=name, f=chosen: errors(c, f(c), n),
                    )
                    for case in cases
                ]
            )
            for name in ("idw", *o.methods)
        }
        rows.append([place, "idw", *(f"{v:.2f}" for v in rmse["idw"].mean(axis=0))])
        for name in o.methods:
            gaps = [bootstrap_mean(gap, cities) for gap in (rmse[name] - rmse["idw"]).T]
            means = rmse[name].mean(axis=0)
            cells = [
                f"{mean:.2f} {signed(gap).split(' ', 1)[1]}"
                for mean, gap in zip(means, gaps, strict=True)
            ]
            rows.append([place, name, *cells])
    title = (
        f"{len(cluster)} surveys in {len(set(cities))} cities of {o.split}. RMSE in dB over "
        "unvisited outdoor cells; brackets: paired difference from IDW, 95 % bootstrap interval "
        "over cities."
    )
    counts = [f"{UAVS * (step + 1)}" for step in STEPS]
    return [Table(title, ["readings", "method", *counts], rows)]
