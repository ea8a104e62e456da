"""Squared error of Kriging over its own variance, by the gain it predicts: the table in
`skygain.planners.search.volatility`.

    python benchmarks/volatility.py DATA.zarr.zip [--surveys 40]

flies random waypoints and lawnmowers over training cities (split T1) and pools the unvisited
outdoor cells at 40, 100 and 200 steps. Prints the ratio per bin of predicted gain, with the share
of the log score a weight by it would win on other cities, and writes
benchmarks/results/volatility.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from skygain.datasets import ChannelDataset, survey_cases
from skygain.flight.swarm import Swarm
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.predictors import create_predictor

STEPS = (40, 100, 200)
BINS = 12


def samples(data: str, surveys: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows (predicted gain, squared error, variance) and the city of each row."""
    rows, cities = [], []
    predictor = create_predictor("kriging")
    for case in survey_cases(ChannelDataset.open(data), "T1", max_surveys=surveys):
        scenario, truth = case.scenario(), case.truth_db
        swarm = Swarm.deployed(scenario, case.start_cells, STEPS[-1])
        for name in ("random-waypoint", "lawnmower"):
            for steps in STEPS:
                cells = (
                    create_planner(name)
                    .plan(swarm, None, steps, case.rng())
                    .paths.transpose(1, 0, 2)
                    .reshape(-1, 2)
                )
                belief = predictor.begin(scenario).updated(
                    Measurements.at(cells, truth[tuple(cells.T)])
                )
                posterior, wanted = belief.posterior(), scenario.outdoor.copy()
                wanted[tuple(cells.T)] = False
                error = truth[wanted] - posterior.mean_db[wanted]
                some = slice(None, None, 7)
                rows.append(
                    np.stack(
                        [posterior.mean_db[wanted], error**2, posterior.variance_db2[wanted]],
                        axis=1,
                    )[some]
                )
                cities.append(np.full(len(rows[-1]), case.city_index))
    return np.concatenate(rows), np.concatenate(cities)


def fitted(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle of each bin of predicted gain (equal counts) and the ratio there."""
    edges = np.quantile(rows[:, 0], np.linspace(0, 1, BINS + 1))
    where = np.clip(np.searchsorted(edges, rows[:, 0]) - 1, 0, BINS - 1)
    middle = np.array([np.median(rows[where == k, 0]) for k in range(BINS)])
    ratio = np.array([rows[where == k, 1].sum() / rows[where == k, 2].sum() for k in range(BINS)])
    return middle, ratio


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data")
    parser.add_argument("--surveys", type=int, default=40)
    options = parser.parse_args()
    rows, cities = samples(options.data, options.surveys)
    held_out = cities % 3 == 0
    middle, ratio = fitted(rows[~held_out])
    scale = np.interp(rows[held_out, 0], middle, ratio)
    square, variance = rows[held_out, 1], rows[held_out, 2]
    flat = ratio.mean()

    def score(factor: np.ndarray | float) -> float:
        return float(np.mean(0.5 * (np.log(variance * factor) + square / (variance * factor))))

    won = score(flat) - score(scale)
    middle, ratio = fitted(rows)
    lines = [
        f"{options.surveys} training surveys, random waypoints and lawnmower, "
        f"{', '.join(map(str, STEPS))} steps.",
        "",
    ]
    lines += ["| predicted gain, dB | squared error / variance |", "|---|---|"]
    lines += [f"| {m:.1f} | {r:.2f} |" for m, r in zip(middle, ratio, strict=True)]
    text = "\n".join(lines) + (
        f"\n\nOn held-out cities the scaled variance wins {won:.3f} nats per cell over a constant "
        "factor.\n"
    )
    (Path(__file__).parent / "results" / "volatility.md").write_text(
        f"# Volatility by predicted gain\n\n{text}"
    )
    print(text)


if __name__ == "__main__":
    main()
