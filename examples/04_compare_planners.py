"""Two planners over the same surveys, and the paired difference of their errors with its
interval."""

from __future__ import annotations

from pathlib import Path

from skygain.evaluation.comparison import ComparisonConfig, compare
from skygain.evaluation.statistics import bootstrap_mean


def main() -> None:
    config = ComparisonConfig(
        predictors=("kriging",),
        planners=("random-waypoint", "lawnmower"),
        data="sample",
        steps=60,
        record_every=20,
    )
    comparison = compare(config, Path("comparison"), workers=1)
    random, lawnmower = (comparison.scores[method.label]["rmse_db"] for method in config.methods)
    for k, step in enumerate(comparison.steps):
        print(
            f"after {step} steps: lawnmower minus random "
            f"{bootstrap_mean((lawnmower - random)[:, k], comparison.cities)} dB"
        )


if __name__ == "__main__":  # worker processes import this file again
    main()
