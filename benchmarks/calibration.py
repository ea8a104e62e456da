"""How far to trust a predictor: RMSE, cover and goodness of fit for several factors of its variance
and powers of the operator's judge.

    python benchmarks/calibration.py DATA.zarr.zip --predictor operator --splits T2 --surveys 100
    --powers 1,1.25,1.5

flies surveys (three UAVs, cluster start, 10 m) by random waypoints and by sequential greedy, and
evaluates every power and factor on the same beliefs at 50, 100 and 200 steps over unvisited outdoor
cells. Choose on T2 (the operator's judge learned from T3); the table goes to
benchmarks/results/calibration.md.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.special import ndtri

from skygain.datasets import ChannelDataset, survey_cases
from skygain.evaluation.metrics import VARIANCE_FLOOR_DB2
from skygain.flight.swarm import Swarm
from skygain.instruments.simulated import PerfectInstrument
from skygain.posterior import Posterior
from skygain.predictors import Belief
from skygain.predictors.networks.operator import OperatorBelief
from skygain.survey.loop import Survey
from skygain.survey.methods import MethodSpec

STEPS = (50, 100, 200)
FACTORS = (0.7, 0.8, 0.85, 0.9, 1.0, 1.1, 1.2)


def posteriors(belief: Belief, powers: list[float]) -> Iterator[tuple[float, Posterior]]:
    """The posterior with each power of the judge and an uncalibrated variance; other predictors
    have one."""
    if (
        not isinstance(belief, OperatorBelief)
        or belief.search is None
        or belief.maps.network.judge is None
    ):
        yield 1.0, belief.posterior()
        return
    for power in powers:
        yield (
            power,
            replace(belief, settings=replace(belief.settings, sharpen=power, variance_factor=1.0))
            .judged()
            .posterior(),
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--predictor", default="operator")
    parser.add_argument("--splits", default="T2", type=lambda text: text.split(","))
    parser.add_argument(
        "--planners", default="random-waypoint,sequential-greedy", type=lambda text: text.split(",")
    )
    parser.add_argument(
        "--powers", default="1,1.25,1.5", type=lambda text: [float(p) for p in text.split(",")]
    )
    parser.add_argument("--surveys", default=100, type=int, help="of each split")
    parser.add_argument("--altitude", default=10.0, type=float)
    parser.add_argument(
        "--out", default=Path(__file__).parent / "results" / "calibration.md", type=Path
    )
    options = parser.parse_args()
    data = ChannelDataset.open(options.data)
    found: dict[tuple[str, str, int, float], list[tuple[float, np.ndarray]]] = {}
    for split in options.splits:
        cases = survey_cases(
            data, split, n_uavs=3, altitude_m=options.altitude, max_surveys=options.surveys
        )
        for number, case in enumerate(cases, 1):
            for name in options.planners:
                method = MethodSpec(options.predictor, name)
                predictor = method.build_predictor()
                scenario = method.visible(case.scenario(), predictor)
                outdoor = scenario.outdoor & np.isfinite(case.truth_db)

                def observe(step: int, swarm: Swarm, belief: Belief) -> None:
                    if step not in STEPS:
                        return
                    unseen = outdoor & ~swarm.visited  # noqa: B023 - called within the iteration
                    truth_db = case.truth_db[unseen].astype(float)  # noqa: B023
                    for power, posterior in posteriors(belief, options.powers):
                        square = (posterior.mean_db[unseen] - truth_db) ** 2
                        ratio = square / np.maximum(
                            posterior.variance_db2[unseen], VARIANCE_FLOOR_DB2
                        )
                        key = (split, name, step, power)  # noqa: B023
                        found.setdefault(key, []).append(
                            (float(np.sqrt(square.mean())), ratio.astype(np.float32))
                        )

                survey = Survey(
                    scenario, predictor, method.build_planner(), PerfectInstrument(case.truth_db)
                )
                survey.fly(
                    Swarm.deployed(scenario, case.start_cells, STEPS[-1]), case.rng(0), observe
                )
            print(f"{split} {number}/{len(cases)}", flush=True)
    first = min(key[3] for key in found)
    count = {
        split: len(found[split, options.planners[0], STEPS[0], first]) for split in options.splits
    }
    lines = [
        f"Predictor {options.predictor}, "
        f"{', '.join(f'{n} surveys of {split}' for split, n in count.items())}, three UAVs, "
        "cluster start, "
        f"{options.altitude:g} m; unvisited outdoor cells, mean over surveys. Goodness of fit / "
        "cover of the 50 % / of the 90 % "
        "interval, by factor of the variance.",
        "",
        "| split, planner, T | power | RMSE dB | " + " | ".join(f"{f:g}" for f in FACTORS) + " |",
        "|---|---|---|" + "---|" * len(FACTORS),
    ]
    half, most = ndtri(0.75) ** 2, ndtri(0.95) ** 2
    for (split, name, step, power), rows in sorted(
        found.items(), key=lambda item: (item[0][0], item[0][1], item[0][2], item[0][3])
    ):
        cells = []
        for factor in FACTORS:
            fit = np.log(np.mean([r.mean() / factor for _, r in rows]))
            inner, outer = (
                100 * np.mean([(r / factor <= limit).mean() for _, r in rows])
                for limit in (half, most)
            )
            cells.append(f"{fit:+.2f} / {inner:.0f} / {outer:.1f}")
        rmse = np.mean([error for error, _ in rows])
        lines.append(
            f"| {split}, {name}, {step} | {power:g} | {rmse:.2f} | " + " | ".join(cells) + " |"
        )
    options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
