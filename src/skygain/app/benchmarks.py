"""`skygain benchmark`: export the surveys, score what was handed in."""

from __future__ import annotations

__all__ = ["run_export", "run_score"]

from skygain.app.progress import Progress
from skygain.evaluation.benchmark.request import BenchmarkExportRequest, BenchmarkScoreRequest


def run_export(request: BenchmarkExportRequest, progress: Progress) -> str:
    """Write the benchmark; returns where it is and what it holds."""
    from skygain.evaluation.benchmark.export import export_benchmark

    progress.phase("drawing surveys")
    return export_benchmark(request.comparison, request.out, overwrite=request.overwrite)


def run_score(request: BenchmarkScoreRequest, progress: Progress) -> str:
    """The table of the submissions."""
    from skygain.evaluation.benchmark.score import score_submissions

    progress.phase("scoring")
    return score_submissions(request.submissions, request.benchmark)
