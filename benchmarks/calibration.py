"""How wide should a predictor's intervals be? Cover and goodness of fit of a predictor for several factors of its variance.

    python benchmarks/calibration.py DATA.zarr.zip --predictor operator --surveys 25

flies T2 surveys (three UAVs, cluster start, 10 m) by random waypoints and by sequential greedy, and evaluates every factor on the
same maps at 50, 100 and 200 steps over unvisited outdoor cells. Choose on T2 only; the table goes to benchmarks/results/calibration.md.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from skygain.datasets import ChannelDataset, survey_cases
from skygain.evaluation.methods import MethodSpec
from skygain.evaluation.metrics import VARIANCE_FLOOR_DB2
from skygain.evaluation.rollout import Recorder
from skygain.instruments.simulated import PerfectInstrument
from skygain.predictors.operator import OperatorPredictor
from skygain.survey import Survey
from skygain.swarm import Swarm

STEPS = (50, 100, 200)
PLANNERS = ("random-waypoint", "sequential-greedy")
FACTORS = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0, 1.1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--predictor", default="operator")
    parser.add_argument("--surveys", default=25, type=int)
    options = parser.parse_args()
    cases = survey_cases(ChannelDataset.open(options.data), "T2", n_uavs=3, max_surveys=options.surveys)
    ratios: dict[tuple[str, int], list[np.ndarray]] = {}
    for number, case in enumerate(cases, 1):
        for name in PLANNERS:
            method = MethodSpec(options.predictor, name)
            predictor = method.build_predictor()
            if isinstance(predictor, OperatorPredictor):
                predictor = replace(predictor, settings=replace(predictor.settings, variance_factor=1.0))
            scenario = method.visible(case.scenario(), predictor)
            recorder = Recorder(frozenset(STEPS), case.truth_db, case.ray_traced, keep_maps=True)
            swarm = Swarm.deployed(scenario, case.start_cells, STEPS[-1])
            survey = Survey(scenario, predictor, method.build_planner(), PerfectInstrument(case.truth_db))
            survey.fly(swarm, case.rng(0), recorder)
            for frame in recorder.frames:
                if frame.step not in STEPS:
                    continue
                unseen = scenario.outdoor & np.isfinite(case.truth_db)
                unseen[frame.paths[..., 0], frame.paths[..., 1]] = False
                square = (frame.mean_db[unseen] - case.truth_db[unseen].astype(float)) ** 2
                ratio = square / np.maximum(frame.std_db[unseen].astype(float) ** 2, VARIANCE_FLOOR_DB2)
                ratios.setdefault((name, frame.step), []).append(ratio)
        print(f"{number}/{len(cases)}", flush=True)
    lines = [
        f"Predictor {options.predictor}, {len(cases)} surveys of T2, three UAVs, cluster start, 10 m; unvisited outdoor cells, mean over "
        "surveys. Goodness of fit / cover of the 50 % / of the 90 % interval, by factor of the variance.",
        "",
        "| planner, T | " + " | ".join(f"{f:g}" for f in FACTORS) + " |",
        "|---|" + "---|" * len(FACTORS),
    ]
    half, most = ndtri(0.75) ** 2, ndtri(0.95) ** 2
    for (name, step), found in ratios.items():
        cells = []
        for factor in FACTORS:
            fit = np.log(np.mean([r.mean() / factor for r in found]))
            inner, outer = (100 * np.mean([(r / factor <= limit).mean() for r in found]) for limit in (half, most))
            cells.append(f"{fit:+.2f} / {inner:.0f} / {outer:.1f}")
        lines.append(f"| {name}, {step} | " + " | ".join(cells) + " |")
    (Path(__file__).parent / "results" / "calibration.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
