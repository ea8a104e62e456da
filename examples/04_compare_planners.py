"""Two planners over the same surveys, and the paired difference of their errors with its
interval."""

from __future__ import annotations

import tempfile
from pathlib import Path

from skygain.evaluation.comparison import compare
from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.statistics import bootstrap_mean


def main(out: Path) -> None:
    request = EvaluateRequest(
        predictors=("kriging",),
        planners=("random-waypoint", "lawnmower"),
        data="sample",
        steps=60,
        record_every=20,
        workers=1,
        out=out,
    )
    comparison = compare(request)
    random, lawnmower = (comparison.scores[method.label]["rmse_db"] for method in request.pairs)
    for k, step in enumerate(comparison.steps):
        print(
            f"after {step} steps: lawnmower minus random "
            f"{bootstrap_mean((lawnmower - random)[:, k], comparison.cities)} dB"
        )


if __name__ == "__main__":  # worker processes import this file again
    with tempfile.TemporaryDirectory() as folder:
        main(Path(folder))
