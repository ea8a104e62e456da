"""What `skygain evaluate` leaves behind: the rollouts, the tables and the figure."""

from __future__ import annotations

__all__ = ["run_comparison"]

from skygain.app.progress import SILENT, Progress
from skygain.app.signals import told_of_signals
from skygain.evaluation.comparison import JOURNAL, compare
from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.tables import comparison_json, comparison_markdown, curve_intervals
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.ground.strict_json import json_text


def run_comparison(request: EvaluateRequest, progress: Progress = SILENT) -> str:
    """Compare, write ``results.json``, ``table.md`` and ``rmse_vs_steps.png``, and return the table
    as Markdown.

    Raises:
        InputError: see `skygain.evaluation.comparison.compare`; ``out`` cannot be written.
    """
    go_on = "every finished survey is kept; the same command goes on"
    with told_of_signals(lambda: f"ended; {go_on}", f"ended; {go_on}"):
        try:
            return _compared(request, progress)
        except InputError as error:
            began = (request.out / JOURNAL).exists()
            if not (began and isinstance(error.__cause__, OSError)):
                raise
            raise InputError(f"{error}; {go_on}") from error


def _compared(request: EvaluateRequest, progress: Progress) -> str:
    from skygain.reports.curves import rmse_curves

    progress.phase("flying")
    comparison = compare(request, progress)
    progress.phase("resampling cities for the tables")
    table = comparison_markdown(comparison)
    results = comparison_json(comparison) | {"table": table}
    for name, text in (("results.json", json_text(results)), ("table.md", table)):
        with atomic_write(request.out / name) as path:
            path.write_text(text, encoding="utf-8")
    flown = f"{len(comparison.cities)} surveys in {len(set(comparison.cities.tolist()))} cities"
    rmse_curves(
        curve_intervals(comparison),
        request.out / "rmse_vs_steps.png",
        title=f"Error against steps, {flown} of {request.split}",
    )
    return table
