"""`skygain reproduce`: the paper's figures, flown, drawn and held against its claims."""

from __future__ import annotations

__all__ = ["run_reproduce"]

import shlex
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from skygain.app.progress import SILENT, Progress
from skygain.app.signals import told_of_signals
from skygain.evaluation.paper.request import ReproduceRequest
from skygain.ground.files import atomic_write, writable_folder
from skygain.ground.strict_json import json_text

if TYPE_CHECKING:
    from skygain.evaluation.paper.claims import Claim
    from skygain.evaluation.paper.flying import Reproduction

_DRAWN = {"cluster3": "three", "spread3": "spread", "cluster5": "five"}
"""the setting that is drawn of figures that compare methods"""


def run_reproduce(request: ReproduceRequest, progress: Progress = SILENT) -> str:
    """Fly, draw and judge; returns the claims as Markdown and where the pages are.

    Raises:
        InputError: see `skygain.evaluation.paper.flying.fly`; ``out`` cannot be written.
    """
    ended = "ended; every finished survey is kept, the same command goes on"
    with told_of_signals(lambda: ended, ended):
        return _reproduced(request, progress)


def _reproduced(request: ReproduceRequest, progress: Progress) -> str:
    from skygain.evaluation.paper.claims import claims_of
    from skygain.evaluation.paper.flying import fly
    from skygain.reports.paper_site import write_site
    from skygain.reports.rollout_pictures import RolloutPictures

    out = writable_folder(request.out)
    progress.phase("reading the data")
    found = fly(
        request,
        lambda setting: RolloutPictures(out / "surveys" / setting, request.steps),
        progress.phase,
        progress,
        progress.note,
    )
    progress.phase("resampling cities and drawing")
    claims = {name: claims_of(name, flown) for name, flown in found.figures.items()}
    pictures = {name: out / "figures" / f"{name}.png" for name in found.figures}
    for name, path in pictures.items():
        _draw(found, name, path)
    with atomic_write(out / "results.json") as path:
        path.write_text(json_text(_results(found, claims)), encoding="utf-8")
    index = write_site(found, claims, pictures, _command(request))
    return "\n".join([*_lines(claims), "", f"{_counted(claims)}. Pages: {index}"])


def _draw(found: Reproduction, name: str, path: Path) -> None:
    from skygain.evaluation.paper.settings import FIGURES
    from skygain.reports.paper_charts import (
        draw_altitudes,
        draw_delay,
        draw_gain_bins,
        draw_methods,
    )

    flown, title = found.figures[name], FIGURES[name].title
    if not flown.roles:
        path.unlink(missing_ok=True)
    elif name in _DRAWN:
        draw_methods(flown, _DRAWN[name], path, title)
    else:
        draw = {"altitudes": draw_altitudes, "gain-bins": draw_gain_bins, "delay": draw_delay}
        draw[name](flown, path, title)


def _lines(claims: dict[str, list[Claim]]) -> list[str]:
    """The claims as a Markdown table."""
    lines = ["| figure | the paper | here | found | |", "|---|---|---|---|---|"]
    for name, of_figure in claims.items():
        for c in of_figure:
            lines.append(f"| {name} | {c.text} | {c.measured} | {c.found} | {c.verdict} |")
    return lines


def _counted(claims: dict[str, list[Claim]]) -> str:
    from skygain.evaluation.paper.claims import VERDICTS

    count = Counter(claim.verdict for of_figure in claims.values() for claim in of_figure)
    return "Claims: " + ", ".join(f"{count[verdict]} {verdict}" for verdict in VERDICTS)


def _results(found: Reproduction, claims: dict[str, list[Claim]]) -> dict[str, object]:
    from skygain.evaluation.tables import comparison_json

    return {
        "config": {**found.request.stored(), "data": Path(found.request.data).name},
        "data_digest": found.data_digest,
        "files": found.files,
        "left_out": found.left_out,
        "claims": {name: [asdict(c) for c in of_figure] for name, of_figure in claims.items()},
        "settings": {name: comparison_json(c) for name, c in found.comparisons.items()},
    }


def _command(request: ReproduceRequest) -> str:
    """What makes the same pages."""
    words = ["skygain", "reproduce"]
    for one in request.asked():
        value = getattr(request, one.name)
        if value == one.default or one.name in ("workers", "cluster"):
            continue
        if one.name in ("data", "out"):
            value = Path(value).name
        text = ",".join(value) if isinstance(value, tuple) else str(value)
        words += [f"--{one.flag}"] if one.kind is bool else [f"--{one.flag}", text]
    return shlex.join(words)
