"""Real measurements: RSRP of three cells on a campus, mapped from 10 to 200 of its grid cells.

The protocol is that of the data set's authors (Geo2SigMap, IEEE DySPAN 2024): 4 m cells in a 512 m
box, a few random cells are known, and the error is taken over all other recorded cells. Random
cells lie along the same streets as the cells they predict. A second, harder test therefore leaves a
whole 100 m square out.

    python benchmarks/duke_cbrs.py PATH/TO/duke_cbrs_abc.csv

prints the tables and writes them to benchmarks/results/duke_cbrs.md and .json.
"""

from __future__ import annotations

import argparse
import json
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from skygain.evaluation.statistics import bootstrap_mean
from skygain.grid import Grid
from skygain.ground.errors import InputError, require
from skygain.instruments import (
    GriddedRecording,
    Recording,
    read_recording,
    replay_scenario,
    replay_truth,
)
from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors import Belief, Predictor, create_predictor
from skygain.predictors.kriging.parameters import trained_parameters
from skygain.scenario import Scenario

NORTH_WEST = (36.001483, -78.942737)
BASE_STATION = (35.999186, -78.939786)
BASE_STATION_HEIGHT_M = 20.0
"""not published; a rooftop mast, and at the distances of this box a few metres more or less change
little"""
PHONE_HEIGHT_M = 1.5
SIDE_M, SPACING_M = 512.0, 4.0
FREQUENCY_HZ = {"A": 3.69e9, "B": 3.64e9, "C": 3.58e9}
DEVICES = ("Samsung", "Pixel")
SAMPLES = (10, 30, 100, 200)
SQUARE_M = 100.0


def widened(intercept_db: float, slope_db: float) -> Predictor:
    """Kriging with known transmitter and a survey's own path-loss line.

    Levels in dBm are gains plus an unknown constant, so the trained intercept means nothing here
    and its prior is opened; with ``slope_db`` the prior of the slope is opened as well. Both are
    standard deviations added to the trained ones.
    """
    trained = trained_parameters("log-distance", PHONE_HEIGHT_M)
    covariance = np.array(trained.trend_covariance) + np.diag([intercept_db**2, slope_db**2])
    return create_predictor(
        "kriging",
        parameters=replace(trained, trend_covariance=tuple(map(tuple, covariance.tolist()))),
    )


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


class ScikitLearnKriging(Predictor):
    """The same model by other hands: scikit-learn's Gaussian process, exponential covariance,
    maximum likelihood without a prior."""

    def begin(self, scenario: Scenario) -> ScikitLearnBelief:
        return ScikitLearnBelief(scenario, Measurements.none())


class ScikitLearnBelief(Belief):
    """Fits when asked for its posterior."""

    def __init__(self, scenario: Scenario, measurements: Measurements) -> None:
        self.scenario, self.measurements = scenario, measurements

    def updated(self, measurements: Measurements) -> ScikitLearnBelief:
        return ScikitLearnBelief(self.scenario, self.measurements.extended(measurements))

    def posterior(self) -> Posterior:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        grid, data = self.scenario.grid, self.measurements
        kernel = ConstantKernel(1.0, (1e-2, 1e2)) * Matern(50.0, (4.0, 1e3), nu=0.5) + WhiteKernel(
            0.05, (1e-4, 1.0)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ten samples often end the search on a bound
            model = GaussianProcessRegressor(kernel, normalize_y=True).fit(
                grid.xy_m(data.cell), data.gain_db
            )
            mean, std = model.predict(grid.xy_m(grid.cells), return_std=True)
        return Posterior(mean.reshape(grid.shape), (std**2).reshape(grid.shape))


METHODS: dict[str, Callable[[], Predictor]] = {
    "knn": lambda: create_predictor("knn"),
    "idw": lambda: create_predictor("idw"),
    "scikit-learn": ScikitLearnKriging,
    "kriging-blind": lambda: create_predictor("kriging-blind"),
    "kriging": lambda: create_predictor("kriging"),
    "kriging+street": ToldStreetLevel,
    "kriging+intercept": lambda: widened(100.0, 0.0),
    "kriging+line": lambda: widened(100.0, 30.0),
}


@dataclass(frozen=True)
class Trial:
    """One method, given some cells of one series, asked for others."""

    test: str
    """``"random"``: all cells not given; ``"square"``: a 100 m square of which none was given"""
    series: str
    """cell and phone"""
    method: str
    """key of `METHODS`"""
    samples: int
    """cells given; in small series fewer than asked for"""
    asked: int
    """column of the table"""
    seed: int
    """draws the cells"""
    tested: int
    """cells asked for"""
    rmse_db: float
    """root mean squared error over them"""
    coverage90: float
    """share of their recorded values inside the predictive 90 % interval, the uncertainty of these
    values included"""


def box_grid() -> Grid:
    """The authors' box in UTM zone 17N."""
    pyproj = require("pyproj", "geo")
    west, north = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32617", always_xy=True).transform(
        *NORTH_WEST[::-1]
    )
    side = round(SIDE_M / SPACING_M)
    half = SPACING_M / 2
    return Grid((side, side), SPACING_M, (west + half, north - SIDE_M + half), crs="EPSG:32617")


def open_series(path: Path, grid: Grid) -> dict[str, tuple[GriddedRecording, Scenario]]:
    """The six series (cell and phone) on the grid, with what a predictor may know."""
    x, y = grid.xy_m_at_latlon(BASE_STATION)
    series = {}
    for pci, frequency_hz in FREQUENCY_HZ.items():
        for device in DEVICES:
            gridded = read_recording(path, where={"PCI": pci, "device": device}).on(grid)
            series[f"{pci}/{device}"] = (
                gridded,
                replay_scenario(
                    gridded,
                    uav_altitude_m=PHONE_HEIGHT_M,
                    transmitter_m=(float(x), float(y), BASE_STATION_HEIGHT_M),
                    frequency_hz=frequency_hz,
                ),
            )
    return series


def random_cells(
    gridded: GriddedRecording, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(order in which cells are given, cells that are never given): none are held back."""
    return rng.permutation(len(gridded)), np.empty(0, dtype=np.int64)


def square_left_out(
    gridded: GriddedRecording, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(order in which cells are given, cells of the square): a 100 m square around a random
    recorded cell, of 20 cells or more."""
    while True:
        centre = gridded.cell[rng.integers(len(gridded))]
        inside = np.abs(gridded.cell - centre).max(axis=1) * gridded.grid.spacing_m <= SQUARE_M / 2
        if 20 <= inside.sum() <= len(gridded) / 2:
            return rng.permutation(np.flatnonzero(~inside)), np.flatnonzero(inside)


def trials(
    name: str, gridded: GriddedRecording, scenario: Scenario, seeds: int, methods: list[str]
) -> Iterator[Trial]:
    """Every test of one series. All methods are given the same cells."""
    truth, everything = replay_truth(gridded), gridded.measurements()
    for seed in range(seeds):
        for test, draw in (("random", random_cells), ("square", square_left_out)):
            order, held_back = draw(
                gridded,
                np.random.default_rng([seed, ("random", "square").index(test), len(gridded)]),
            )
            for asked in SAMPLES:
                given = order[:asked]
                asked_for = held_back if test == "square" else order[asked:]
                cells = tuple(gridded.cell[asked_for].T)
                for method in methods:
                    belief = METHODS[method]().begin(scenario).updated(everything.taken(given))
                    posterior = belief.posterior()
                    error = posterior.mean_db[cells] - truth[cells]
                    std = np.sqrt(
                        posterior.variance_db2[cells] + gridded.noise_std_db[asked_for] ** 2
                    )
                    yield Trial(
                        test=test,
                        series=name,
                        method=method,
                        samples=len(given),
                        asked=asked,
                        seed=seed,
                        tested=len(asked_for),
                        rmse_db=float(np.sqrt(np.mean(error**2))),
                        coverage90=float(np.mean(np.abs(error) <= 1.6448536 * std)),
                    )


def averages_compared(
    recording: Recording, gridded: GriddedRecording, scenario: Scenario, seeds: int
) -> str:
    """A sentence: the error at the largest sample when the readings of a cell are averaged in other
    ways."""
    assert recording.latlon is not None
    cells = gridded.grid.cells_at(gridded.grid.xy_m_at_latlon(recording.latlon))
    on_map = gridded.grid.contains(cells)
    _, group, count = np.unique(
        gridded.grid.flat(cells[on_map]), return_inverse=True, return_counts=True
    )
    level = recording.level_db[on_map]
    ways = {
        "mean in dB of distinct readings": gridded.level_db,
        "mean in dB of all readings, copies included": np.bincount(group, level) / count,
        "mean of powers": 10 * np.log10(np.bincount(group, 10 ** (level / 10)) / count),
    }
    parts = []
    for way, levels in ways.items():
        found = trials("", replace(gridded, level_db=levels), scenario, seeds, ["kriging-blind"])
        rmse = _values(list(found), "rmse_db", test="random", asked=SAMPLES[-1])
        parts.append(f"{way} {rmse.mean():.2f} ± {rmse.std(ddof=1):.2f} dB")
    return "kriging-blind on A/Samsung with cells averaged as: " + "; ".join(parts) + "."


def series_facts(series: dict[str, tuple[GriddedRecording, Scenario]]) -> str:
    """A table: what distance to the base station explains of each series, by least squares, and how
    noisy its cells are."""
    lines = [
        "Each series as recorded: RSRP = a − b·log₁₀(distance in m) by least squares over its "
        "cells, and the root mean square of the "
        "standard deviation given to its cells' values, which is a part of every error above.",
        "",
        "| series | a, dBm | b, dB per decade | standard deviation, dB | left by the line, dB | "
        "noise of the cells, dB |",
        "|---|---|---|---|---|---|",
    ]
    for name, (gridded, scenario) in series.items():
        assert scenario.transmitter_m is not None
        offset = (
            np.column_stack(
                [gridded.grid.xy_m(gridded.cell), np.full(len(gridded), PHONE_HEIGHT_M)]
            )
            - scenario.transmitter_m
        )
        columns = np.column_stack(
            [np.ones(len(gridded)), -np.log10(np.linalg.norm(offset, axis=1))]
        )
        line = np.linalg.lstsq(columns, gridded.level_db, rcond=None)[0]
        left, noise = (
            np.std(gridded.level_db - columns @ line),
            np.sqrt(np.mean(gridded.noise_std_db**2)),
        )
        lines.append(
            f"| {name} | {line[0]:.0f} | {line[1]:.1f} | {gridded.level_db.std():.1f} | {left:.1f} "
            f"| {noise:.1f} |"
        )
    return "\n".join(lines)


def _values(found: list[Trial], value: str, **match: Any) -> np.ndarray:
    rows = [t for t in found if all(getattr(t, k) == v for k, v in match.items())]
    return np.array([getattr(t, value) for t in sorted(rows, key=lambda t: (t.series, t.seed))])


def markdown(found: list[Trial], methods: list[str], series: list[str], seeds: int) -> str:
    """The tables: means over series and seeds, differences to IDW, and every series at the largest
    sample."""
    lines = []
    groups = np.repeat(np.arange(len(series)), seeds)
    titles = {
        "random": "random cells, error over all other recorded cells",
        "square": "a 100 m square left out, error inside it",
    }
    for test, title in titles.items():
        lines += [
            "",
            f"RMSE in dB, {title}; mean over {len(series)} series and {seeds} seeds. Brackets: "
            "difference to IDW on the same cells,"
            " 95 % bootstrap interval over series.",
            "",
            "| method | "
            + " | ".join(f"{n} cells" for n in SAMPLES)
            + f" | 90 % interval covers, {SAMPLES[-1]} cells |",
            "|---|" + "---|" * (len(SAMPLES) + 1),
        ]
        for method in methods:
            row = []
            for n in SAMPLES:
                rmse = _values(found, "rmse_db", test=test, method=method, asked=n)
                text = f"{rmse.mean():.2f}"
                if method != "idw" and "idw" in methods:
                    gap = bootstrap_mean(
                        rmse - _values(found, "rmse_db", test=test, method="idw", asked=n), groups
                    )
                    text += f" [{gap.low:+.2f}, {gap.high:+.2f}]"
                row.append(text)
            covered = _values(found, "coverage90", test=test, method=method, asked=SAMPLES[-1])
            lines.append(f"| {method} | " + " | ".join(row) + f" | {covered.mean():.0%} |")
    lines += [
        "",
        f"RMSE in dB on each series: mean ± standard deviation over {seeds} seeds, {SAMPLES[-1]} "
        "random cells.",
        "",
        "| series | recorded cells | " + " | ".join(methods) + " |",
        "|---|---|" + "---|" * len(methods),
    ]
    for name in series:
        cells = next(t.tested + t.samples for t in found if t.series == name and t.test == "random")
        at = [
            _values(found, "rmse_db", test="random", method=m, asked=SAMPLES[-1], series=name)
            for m in methods
        ]
        lines.append(
            f"| {name} | {cells} | "
            + " | ".join(f"{v.mean():.2f} ± {v.std(ddof=1):.2f}" for v in at)
            + " |"
        )
    return "\n".join(lines).strip() + "\n"


def main() -> None:
    """Run all tests, print the tables, write them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="duke_cbrs_abc.csv")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument(
        "--methods", default=",".join(METHODS), help="any of the default, separated by commas"
    )
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent / "results", help="folder for the tables"
    )
    options = parser.parse_args()
    methods = options.methods.split(",")
    if options.seeds < 2:
        parser.error(f"--seeds must be 2 or more for a spread, got {options.seeds}")
    if unknown := set(methods) - set(METHODS):
        parser.error(f"unknown methods {', '.join(sorted(unknown))}; known: {', '.join(METHODS)}")
    try:
        series = open_series(options.data, box_grid())
    except InputError as error:
        parser.error(str(error))
    found: list[Trial] = []
    for name, (gridded, scenario) in series.items():
        found += trials(name, gridded, scenario, options.seeds, methods)
        at = _values(
            found, "rmse_db", test="random", series=name, asked=SAMPLES[-1], method=methods[-1]
        )
        print(
            f"{name}: {len(gridded)} cells, {gridded.outside} readings outside the box, "
            f"{methods[-1]} {at.mean():.2f} dB",
            flush=True,
        )
    table = markdown(found, methods, list(series), options.seeds)
    first = read_recording(options.data, where={"PCI": "A", "device": "Samsung"})
    table += (
        "\n"
        + series_facts(series)
        + "\n\n"
        + averages_compared(first, *series["A/Samsung"], options.seeds)
        + "\n"
    )
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "duke_cbrs.md").write_text(table, encoding="utf-8")
    names = [f.name for f in fields(Trial)]
    rows = [
        [
            round(v, 4) if isinstance(v, float) and math.isfinite(v) else v
            for v in (getattr(t, name) for name in names)
        ]
        for t in found
    ]
    header = json.dumps(
        {"box": NORTH_WEST, "spacing_m": SPACING_M, "seeds": options.seeds, "columns": names}
    )[:-1]
    text = (
        header + ', "trials": [\n' + ",\n".join(map(json.dumps, rows)) + "\n]}"
    )  # one trial a line
    (options.out / "duke_cbrs.json").write_text(text + "\n", encoding="utf-8")
    print("\n" + table)


if __name__ == "__main__":
    main()
