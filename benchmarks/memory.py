"""What a survey takes of memory, beside what its predictor said before."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.city import City
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.scenario import Scenario

OURS = (
    "kriging", "kriging-blind", "kriging-inferred", "local-kriging", "operator", "unet",
    "paper-unet", "idw", "knn", "gids", "thin-plate",
)  # fmt: skip
RIVALS = ("sklearn-gp", "pykrige", "gstools", "gpytorch")
ROUNDS = 10


def learnt(name: str, side: int, readings: int) -> float:
    """Fly through a survey's readings; returns the bytes that the predictor announces."""
    grid = Grid((side, side), 4.0)
    height = np.zeros(grid.shape)
    height[4:8, 4:8] = 20.0
    scenario = Scenario(City(grid, height), transmitter_m=(40.0, 40.0, 1.5))
    predictor = create_predictor(name)
    if predictor.transmitter != "required":
        scenario = scenario.without_transmitter()
    rng = np.random.default_rng(0)
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:readings]]
    belief = predictor.begin(scenario)
    for part in np.array_split(cells, ROUNDS):
        gain_db = -100.0 + 10.0 * rng.standard_normal(len(part))
        belief = belief.updated(Measurements.at(part, gain_db))
        belief.posterior()
    return predictor.memory_bytes(grid.size, readings)


def resident_mb(key: str) -> float:
    """``VmRSS``, what this process holds now, or ``VmHWM``, the most it has held since
    `forget_peak`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024 / 1e6
    raise RuntimeError(f"this system does not tell {key}")


def forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def grown(name: str, side: int, readings: int) -> list[float]:
    """Megabytes that the survey added at its peak in this process, and that were announced."""
    learnt(name, 24, 2 * ROUNDS)  # libraries and compiled kernels
    before = resident_mb("VmRSS")
    forget_peak()
    said = learnt(name, side, readings)
    return [resident_mb("VmHWM") - before, said / 1e6]


@study(
    "memory",
    predictors=Option(OURS + RIVALS, "predictors"),
    side=Option(200, "cells along the edge of the map"),
    counts=Option((60, 300), "readings"),
)
def memory(run: Run) -> list[Table]:
    """Memory that a survey adds to a process that has flown a tiny one before, and what the
    predictor announced.

    Readings at random cells arrive in ten parts, and the map is asked for after each. The paper's
    U-Net has maps of 96 × 96 cells.
    """
    o = run.options
    context = multiprocessing.get_context("spawn")

    def alone(name: str, side: int, count: int) -> list[float]:
        with ProcessPoolExecutor(1, context) as pool:
            return pool.submit(grown, name, side, count).result()

    rows = []
    for name in o.predictors:
        side = 96 if name == "paper-unet" else o.side
        row = [name]
        for n in o.counts:
            added, said = run.once((name, side, n), lambda m=name, s=side, k=n: alone(m, s, k))
            row += [f"{added:.0f}", f"{said:.0f}"]
        rows.append(row)
    head = ["predictor"]
    for n in o.counts:
        head += [f"{n} readings: added, MB", "announced, MB"]
    return [Table(f"{o.side} × {o.side} cells.", head, rows)]
