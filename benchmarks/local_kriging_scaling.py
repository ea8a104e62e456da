"""Time and memory of local Kriging from 10² to 10⁵ measurements and 10⁴ to 10⁶ cells.

    python benchmarks/local_kriging_scaling.py

Every size runs in a process of its own, so that its peak memory is its own too. The task:
measurements scattered at random over a square map arrive at once and the map is predicted (the
covariance is given, nothing is fitted); then 50 more arrive, one step of a large swarm, and mean
and variance are wanted at every cell again. Ordinary Kriging is timed on the smaller sizes beside
it, with the largest difference between the two means in units of its standard deviation.

Prints the table and writes it to benchmarks/results/local_kriging_scaling.md and .json.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np

from skygain.city import City
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.propagation.gudmundson import shadowing_db
from skygain.scenario import Scenario

MEAN_DB = -110.0
PARAMETERS = KrigingParameters.known_trend(MEAN_DB, sill_db2=380.0, range_m=57.0)
SIDES = (100, 316, 1000)
COUNTS = (100, 1000, 10_000, 100_000)
NEW = 50
EXACT_LIMIT = 2e7
"""ordinary Kriging runs beside it where measurements × cells stay below this"""


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _timed(
    predictor: str, grid: Grid, cells: np.ndarray, gain_db: np.ndarray, **options: Any
) -> tuple[dict[str, float], Any]:
    """Seconds for all measurements at once and for the last `NEW`, memory added, and the
    posterior."""
    belief = create_predictor(predictor, parameters=PARAMETERS, refit=False, **options).begin(
        Scenario(City(grid, np.zeros(grid.shape, dtype=np.float32)))
    )
    before, began = _peak_mib(), time.perf_counter()
    belief = belief.updated(Measurements.at(cells[:-NEW], gain_db[:-NEW]))
    belief.posterior()
    whole = time.perf_counter() - began
    began = time.perf_counter()
    posterior = belief.updated(Measurements.at(cells[-NEW:], gain_db[-NEW:])).posterior()
    return {
        "whole_s": whole,
        "step_s": time.perf_counter() - began,
        "added_mib": _peak_mib() - before,
    }, posterior


def measure(side: int, count: int) -> dict[str, Any]:
    """One size."""
    small = Grid((20, 20), 4.0)
    _timed("local-kriging", small, small.cells[: 2 * NEW], np.full(2 * NEW, MEAN_DB))  # compile
    rng = np.random.default_rng(0)
    grid = Grid((side, side), 4.0)
    cells = grid.cells[rng.permutation(grid.size)[: count + NEW]]
    gain_db = MEAN_DB + shadowing_db(grid, rng)[tuple(cells.T)]
    found, posterior = _timed("local-kriging", grid, cells, gain_db)
    row: dict[str, Any] = {"side": side, "measurements": count, **found, "peak_mib": _peak_mib()}
    if count * grid.size <= EXACT_LIMIT:
        exact, whole = _timed("kriging-blind", grid, cells, gain_db)
        unseen = whole.std_db > 0.1
        gap = np.abs(posterior.mean_db - whole.mean_db)[unseen] / whole.std_db[unseen]
        row |= {
            "exact_whole_s": exact["whole_s"],
            "exact_step_s": exact["step_s"],
            "largest_gap_std": float(gap.max()),
        }
        row["rms_gap_std"] = float(np.sqrt(np.mean(gap**2)))
    return row


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table."""
    lines = [
        f"# Local Kriging: time and memory\n\n{platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}; "
        f"32 neighbours, covariance given; a step brings {NEW} new measurements. Memory is what "
        "the process had at its peak, and how "
        "much of it the two updates added.\n",
        "| cells | measurements | whole map, s | one step, s | peak memory, MiB | added, MiB | "
        "Kriging: whole map, s | one step, s "
        "| difference of the means in standard deviations: rms | largest |",
        "|" + "---|" * 10,
    ]
    for r in rows:
        exact = (
            [
                f"{r['exact_whole_s']:.2f}",
                f"{r['exact_step_s']:.3f}",
                f"{r['rms_gap_std']:.3f}",
                f"{r['largest_gap_std']:.2f}",
            ]
            if "exact_whole_s" in r
            else ["–"] * 4
        )
        numbers = [
            f"{r['whole_s']:.2f}",
            f"{r['step_s']:.3f}",
            f"{r['peak_mib']:.0f}",
            f"{r['added_mib']:.0f}",
        ]
        lines.append(
            "| "
            + " | ".join([f"{r['side'] ** 2:,}", f"{r['measurements']:,}", *numbers, *exact])
            + " |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    rows = []
    context = multiprocessing.get_context("spawn")
    for side in SIDES:
        for count in COUNTS:
            if count + NEW > side * side:
                continue
            with context.Pool(1) as pool:
                rows.append(pool.apply(measure, (side, count)))
            print(rows[-1], flush=True)
            (options.out / "local_kriging_scaling.md").write_text(markdown(rows), encoding="utf-8")
            (options.out / "local_kriging_scaling.json").write_text(
                json.dumps(rows, indent=1) + "\n", encoding="utf-8"
            )
    print(markdown(rows))


if __name__ == "__main__":
    main()
