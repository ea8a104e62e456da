"""What `skygain evaluate` leaves behind: the rollouts, the tables and the figure."""

from __future__ import annotations

__all__ = ["run_comparison"]

from pathlib import Path

from skygain.evaluation.comparison import ComparisonConfig, Progress, compare
from skygain.evaluation.tables import comparison_json, comparison_markdown, curve_intervals
from skygain.ground.files import atomic_write
from skygain.ground.strict_json import json_text


def run_comparison(
    config: ComparisonConfig,
    out: Path,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> str:
    """Compare, write ``results.json``, ``table.md`` and ``rmse_vs_steps.png`` to ``out``, and
    return the table as Markdown.

    Raises:
        InputError: see `skygain.evaluation.comparison.compare`; ``out`` cannot be written.
    """
    from skygain.reports.pictures import rmse_curves

    comparison = compare(config, out, workers=workers, progress=progress)
    table = comparison_markdown(comparison)
    results = comparison_json(comparison) | {"table": table}
    with atomic_write(out / "results.json") as path:
        path.write_text(json_text(results))
    with atomic_write(out / "table.md") as path:
        path.write_text(table)
    rmse_curves(curve_intervals(comparison), out / "rmse_vs_steps.png")
    return table
