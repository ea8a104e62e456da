"""The row of a submission by Skygain's own metrics and rules of flight."""

from __future__ import annotations

__all__ = ["score_submissions"]

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skygain.evaluation.benchmark.alone import (
    CASES,
    Benchmark,
    BenchmarkError,
    Row,
    Submission,
    read_submission,
    table,
)
from skygain.evaluation.metrics import gof, score
from skygain.evaluation.statistics import bootstrap_mean
from skygain.ground.errors import InputError
from skygain.posterior import Posterior


def score_submissions(submissions: Sequence[Path], folder: Path | None = None) -> str:
    """The table of the submissions, as Markdown.

    Args:
        submissions: folders of ``case-000.npz``, ….
        folder: the exported benchmark; the nearest one above the first submission when left out.

    Raises:
        InputError: there is no benchmark, or a submission is incomplete or illegal.
    """
    try:
        benchmark = Benchmark(folder or _above(submissions[0]))
        rows = [_row(benchmark, read_submission(benchmark, path)) for path in submissions]
    except BenchmarkError as error:
        raise InputError(str(error)) from error
    return table(benchmark, rows)


def _above(submission: Path) -> Path:
    if not submission.is_dir():
        raise InputError(f"{submission} is no folder; give the one that Flight.write filled")
    if (submission / CASES).exists():
        raise InputError(
            f"{submission} is the benchmark itself; give the folder of a submission, such as "
            f"{submission / 'submissions' / 'nearest-neighbour'}"
        )
    for folder in submission.resolve().parents:
        if (folder / CASES).exists():
            return folder
    raise InputError(
        f"no benchmark lies above {submission}; give the exported folder as `benchmark`"
    )


def _row(benchmark: Benchmark, found: Submission) -> Row:
    names = ("rmse_db", "error_ratio", "coverage90")
    values = np.array(
        [
            [_scores(benchmark, found, k, i)[name] for name in names]
            for k in range(len(benchmark))
            for i in range(len(benchmark.record_steps))
        ]
    ).reshape(len(benchmark), -1, len(names))  # [case, recorded step, score]
    cities = benchmark.cases["city"]
    of_steps = [bootstrap_mean(values[:, i, 0], cities) for i in range(values.shape[1])]
    ratio, cover = (bootstrap_mean(values[:, -1, j], cities) for j in (1, 2))
    mean, low, high = (
        gof(v) if not np.isnan(v) else v for v in (ratio.mean, ratio.low, ratio.high)
    )
    means = [(one.mean, one.low, one.high) for one in of_steps]
    return Row(
        found.name,
        found.told_transmitter,
        (*means, (mean, low, high), (cover.mean, cover.low, cover.high)),
    )


def _scores(benchmark: Benchmark, found: Submission, k: int, i: int) -> dict[str, float]:
    free = benchmark.cases["free"][k]
    flown = found.paths[k][:, : benchmark.record_steps[i] + 1]
    visited = np.zeros_like(free)
    visited[flown[..., 0], flown[..., 1]] = True
    # what is predicted inside buildings may be anything
    mean, variance = (
        np.where(free, maps[k, i], 0.0) for maps in (found.mean_db, found.variance_db2)
    )
    truth_db = benchmark.truth["gain_db"][k]
    return score(Posterior(mean, variance), truth_db, free, visited)
