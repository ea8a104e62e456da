"""How far to trust a predictor: RMSE, likelihood, cover and goodness of fit for several factors of its variance and powers of the judge.

    python benchmarks/calibration.py DATA.zarr.zip --predictor operator --planners random-waypoint --powers 1,1.25,1.5

flies surveys (three UAVs, cluster start) by random waypoints and by sequential greedy, and evaluates every power and factor on the
same beliefs at 50, 100 and 200 steps over unvisited outdoor cells. Choose on T2 (the operator's judge learned from T3), by the mean
negative log likelihood, which punishes too narrow and too wide alike; the table goes to benchmarks/results/calibration.md.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from skygain.datasets import ChannelDataset, survey_cases
from skygain.datasets.cases import Case
from skygain.evaluation.methods import MethodSpec
from skygain.evaluation.metrics import VARIANCE_FLOOR_DB2
from skygain.instruments.simulated import PerfectInstrument
from skygain.posterior import Posterior
from skygain.predictors import Belief
from skygain.predictors.operator import OperatorBelief
from skygain.survey import Survey
from skygain.swarm import Swarm
from skygain.workers import process_pool

STEPS = (50, 100, 200)
FACTORS = (0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5)


def posteriors(belief: Belief, powers: list[float]) -> Iterator[tuple[float, Posterior]]:
    """The posterior with each power of the judge and an uncalibrated variance; other predictors have one."""
    if not isinstance(belief, OperatorBelief) or belief.search is None or belief.maps.network.judge is None:
        yield 1.0, belief.posterior()
        return
    for power in powers:
        yield power, replace(belief, settings=replace(belief.settings, sharpen=power, variance_factor=1.0)).judged().posterior()


Row = tuple[tuple[str, float, str, int, float], tuple[float, float, np.ndarray]]
"""(split, altitude, planner, T, power), and RMSE, mean logarithm of 2π times the variance, squared errors over variances there"""


@lru_cache(maxsize=1)
def cases_of(data: Path, split: str, altitude_m: float, surveys: int) -> list[Case]:
    """The surveys of one comparison; a process opens the data once."""
    return survey_cases(ChannelDataset.open(data), split, n_uavs=3, altitude_m=altitude_m, max_surveys=surveys)


def flown(options: argparse.Namespace, split: str, altitude_m: float, number: int) -> list[Row]:
    """Survey ``number`` with every planner and power."""
    case, found = cases_of(options.data, split, altitude_m, options.surveys)[number], []
    for name in options.planners:
        method = MethodSpec(options.predictor, name)
        predictor = method.build_predictor()
        scenario = method.visible(case.scenario(), predictor)
        outdoor = scenario.outdoor & np.isfinite(case.truth_db)

        def observe(step: int, swarm: Swarm, belief: Belief) -> None:
            if step not in STEPS:
                return
            unseen = outdoor & ~swarm.visited  # noqa: B023 - called within the iteration
            for power, posterior in posteriors(belief, options.powers):
                square = (posterior.mean_db[unseen] - case.truth_db[unseen].astype(float)) ** 2
                variance = np.maximum(posterior.variance_db2[unseen], VARIANCE_FLOOR_DB2)
                ratio, width = (square / variance).astype(np.float32), float(np.log(2 * np.pi * variance).mean())
                found.append(((split, altitude_m, name, step, power), (float(np.sqrt(square.mean())), width, ratio)))  # noqa: B023

        survey = Survey(scenario, predictor, method.build_planner(), PerfectInstrument(case.truth_db))
        survey.fly(Swarm.deployed(scenario, case.start_cells, STEPS[-1]), case.rng(0), observe)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--predictor", default="operator")
    parser.add_argument("--splits", default="T2", type=lambda text: text.split(","))
    parser.add_argument("--planners", default="random-waypoint,sequential-greedy", type=lambda text: text.split(","))
    parser.add_argument("--powers", default="1,1.25,1.5", type=lambda text: [float(p) for p in text.split(",")])
    parser.add_argument("--surveys", default=40, type=int, help="of each split at each altitude")
    parser.add_argument("--altitudes", default="10,20,30", type=lambda text: [float(a) for a in text.split(",")])
    parser.add_argument("--workers", default=os.cpu_count() or 1, type=int)
    parser.add_argument("--out", default=Path(__file__).parent / "results" / "calibration.md", type=Path)
    options = parser.parse_args()
    groups = [(split, altitude) for split in options.splits for altitude in options.altitudes]
    jobs = [(*group, k) for group in groups for k in range(len(cases_of(options.data, *group, options.surveys)))]
    found: dict[tuple[str, float, str, int, float], list[tuple[float, float, np.ndarray]]] = {}
    with process_pool(options.workers) as pool:
        tasks = [pool.submit(flown, options, *job) for job in jobs]
        for number, task in enumerate(tasks, 1):
            for key, row in task.result():
                found.setdefault(key, []).append(row)
            print(f"{number}/{len(jobs)}", flush=True)
    lines = [
        f"Predictor {options.predictor}, {len(jobs)} surveys of {', '.join(options.splits)}, three UAVs, cluster start; unvisited outdoor "
        "cells, mean over surveys. Goodness of fit / cover of the 50 % / of the 90 % interval / negative log likelihood, by factor of the "
        "variance.",
        "",
        "| split, altitude, planner, T | power | RMSE dB | " + " | ".join(f"{f:g}" for f in FACTORS) + " |",
        "|---|---|---|" + "---|" * len(FACTORS),
    ]
    half, most = ndtri(0.75) ** 2, ndtri(0.95) ** 2
    likelihoods: dict[tuple[float, float], list[float]] = {}
    for (split, altitude, name, step, power), rows in sorted(found.items(), key=lambda item: item[0]):
        cells = []
        for factor in FACTORS:
            fit = np.log(np.mean([r.mean() / factor for *_, r in rows]))
            inner, outer = (100 * np.mean([(r / factor <= limit).mean() for *_, r in rows]) for limit in (half, most))
            nll = np.mean([0.5 * (width + np.log(factor) + r.mean() / factor) for _, width, r in rows])
            likelihoods.setdefault((power, factor), []).append(float(nll))
            cells.append(f"{fit:+.2f} / {inner:.0f} / {outer:.1f} / {nll:.3f}")
        rmse = np.mean([error for error, *_ in rows])
        lines.append(f"| {split}, {altitude:g} m, {name}, {step} | {power:g} | {rmse:.2f} | " + " | ".join(cells) + " |")
    best = min(likelihoods, key=lambda pair: np.mean(likelihoods[pair]))
    lines += ["", f"The negative log likelihood is lowest on average with power {best[0]:g} and factor {best[1]:g}."]
    options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
