"""Kriging against inverse distance weighting when there are only 12 to 30 readings.

    python benchmarks/few_samples.py DATA.zarr.zip [--split T2] [--surveys 50]

A covariance fitted to a handful of readings can be far off, and then Kriging is worse than a method
that fits nothing. Three sets of
readings are taken in every survey case: scattered over the outdoor cells, along random waypoints of
three UAVs that start together, and of three that start anywhere; each at 12, 21 and 30 readings (3,
6 and 9 steps). Prints the mean RMSE over unvisited outdoor cells and the paired difference from IDW
with its 95 % bootstrap interval over cities, and writes benchmarks/results/few_samples.md. The same
question on measured data is in benchmarks/duke_cbrs.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from skygain.datasets import ChannelDataset, survey_cases
from skygain.datasets.cases import Case
from skygain.evaluation.metrics import score
from skygain.evaluation.statistics import bootstrap_mean
from skygain.flight.swarm import Swarm
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.predictors import create_predictor

RIVAL = "idw"
METHODS = ("kriging", "kriging-inferred", "kriging-blind", "kriging-quadratic", "local-kriging")
UAVS, STEPS = 3, (3, 6, 9)


def along(case: Case) -> np.ndarray:
    """``[k, (row, col)]`` cells in the order in which random waypoints come to them."""
    swarm = Swarm.deployed(case.scenario(), case.start_cells, STEPS[-1])
    paths = create_planner("random-waypoint").plan(swarm, None, STEPS[-1], case.rng()).paths  # type: ignore[arg-type]
    return paths.transpose(1, 0, 2).reshape(-1, 2)


def scattered(case: Case) -> np.ndarray:
    """``[k, (row, col)]`` random outdoor cells."""
    cells = np.argwhere(case.scenario().outdoor)
    return case.rng().permutation(cells)[: UAVS * (STEPS[-1] + 1)]


def errors(case: Case, cells: np.ndarray, method: str) -> list[float]:
    """RMSE after each number of readings, taken in step by step."""
    predictor, truth = create_predictor(method), case.truth_db
    scenario = case.scenario(transmitter_known=predictor.transmitter == "required")
    belief, found = predictor.begin(scenario), []
    for step, some in enumerate(np.split(cells, STEPS[-1] + 1)):
        belief = belief.updated(Measurements.at(some, truth[tuple(some.T)]))
        if step in STEPS:
            visited = belief.measurements.visited(truth.shape)
            found.append(score(belief.posterior(), truth, scenario.outdoor, visited)["rmse_db"])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data")
    parser.add_argument("--split", default="T2")
    parser.add_argument("--surveys", type=int, default=50)
    options = parser.parse_args()
    dataset = ChannelDataset.open(options.data)
    cluster, spread = (
        survey_cases(dataset, options.split, n_uavs=UAVS, start=start, max_surveys=options.surveys)
        for start in ("cluster", "spread")
    )
    cities = [case.city_index for case in cluster]
    counts = [UAVS * (step + 1) for step in STEPS]
    lines = [
        f"{len(cluster)} surveys in {len(set(cities))} cities of {options.split}. RMSE in dB over "
        "unvisited outdoor cells; brackets: "
        "paired difference from IDW, 95 % bootstrap interval over cities.",
        "",
        "| readings | method | " + " | ".join(f"{n}" for n in counts) + " |",
        "|---|---|" + "---|" * len(counts),
    ]
    for name, cases, chosen in (
        ("scattered", cluster, scattered),
        ("random waypoints, cluster start", cluster, along),
        ("random waypoints, spread start", spread, along),
    ):
        flown = [chosen(case) for case in cases]
        rival = np.array(
            [errors(case, cells, RIVAL) for case, cells in zip(cases, flown, strict=True)]
        )
        lines.append(
            f"| {name} | {RIVAL} | " + " | ".join(f"{v:.2f}" for v in rival.mean(axis=0)) + " |"
        )
        for method in METHODS:
            rmse = np.array(
                [errors(case, cells, method) for case, cells in zip(cases, flown, strict=True)]
            )
            columns = []
            for k in range(len(counts)):
                gap = bootstrap_mean(rmse[:, k] - rival[:, k], cities)
                columns.append(f"{rmse[:, k].mean():.2f} [{gap.low:+.2f}, {gap.high:+.2f}]")
            lines.append(f"| {name} | {method} | " + " | ".join(columns) + " |")
            print(lines[-1], flush=True)
    text = "# Kriging with few readings\n\n" + "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parent / "results" / "few_samples.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
