"""The survey as one HTML file that can be mailed, archived and stepped through without a network.

The page, its style and its script stand in ``page/``; this module fills in the words, and
`skygain.reports.page_data` packs the maps.
"""

from __future__ import annotations

__all__ = ["write_report"]

import html
import json
import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import skygain
from skygain.ground.files import atomic_write
from skygain.reports.outcome import Outcome, score_label
from skygain.reports.page_data import map_views, page_data, shown_frames


def write_report(outcome: Outcome, path: Path) -> None:
    """Write ``report.html``: settings, scores and an animation of the survey, complete in one file.

    The animation can be played, stepped and searched with mouse, touch and keyboard and shows the
    estimate, its uncertainty and, where a truth is known, the error and the truth.
    ``report.html#step=50&view=std`` opens at a step and a map. Without frames the final belief is
    all it shows.
    """
    frames = shown_frames(outcome)
    views = map_views(outcome)
    page = files("skygain.reports") / "page"
    words = {
        "title": _escaped(outcome.title),
        "lede": _lede(outcome),
        "tiles": "\n".join(_tiles(outcome)),
        "views": "\n".join(
            '        <label><input type="radio" name="view" '
            f'value="{name}"{" checked" if name == "mean" else ""}>'
            f"<span>{view['short']}</span></label>"
            for name, view in views.items()
        ),
        "view_count": str(len(views)),
        "key": "\n".join(_key(outcome)),
        "last_step": str(frames[-1].step),
        "last_frame": str(len(frames) - 1),
        "scores": _score_table(outcome),
        "notes": _notes(outcome),
        "settings": _settings_table(outcome.config or {}),
        "version": _escaped(skygain.__version__),
        "data": _for_script(page_data(outcome, frames, views)),
        "style": (page / "page.css").read_text(encoding="utf-8").rstrip(),
        "script": (page / "page.js").read_text(encoding="utf-8").rstrip(),
    }
    template = (page / "page.html").read_text(encoding="utf-8")
    # one pass, so that a marker inside a title stays the text it is
    text = re.sub(r"\{\{(\w+)\}\}", lambda match: words[match.group(1)], template)
    with atomic_write(path) as tmp:
        tmp.write_text(text, encoding="utf-8", errors="replace")


def _lede(outcome: Outcome) -> str:
    """Two sentences on what was flown."""
    scenario, swarm = outcome.scenario, outcome.result.swarm
    rows, cols = outcome.grid.shape
    uavs = "1 UAV" if swarm.n_uavs == 1 else f"{swarm.n_uavs} UAVs"
    spacing = outcome.grid.spacing_m
    text = (
        f"{uavs} measured {scenario.city.name} at {scenario.altitude_text}: "
        f"{cols * spacing:g} × {rows * spacing:g} m "
        f"in cells of {spacing:g} m, {scenario.frequency_hz / 1e9:g} GHz"
    )
    if not scenario.one_altitude:
        text += f"; the map is at {scenario.map_altitude_text}"
    if outcome.grid.crs is not None:
        text += f", {outcome.grid.crs}"
    if outcome.transmitter_m is None:
        text += ". Where the transmitter stands is not known"
    else:
        x, y, z = outcome.transmitter_m
        told = "known to" if scenario.transmitter_m is not None else "hidden from"
        text += (
            f". The transmitter at x {x:.0f} m, y {y:.0f} m, {z:g} m high was {told} the predictor"
        )
    ending = outcome.result.ending
    text = _escaped(f"{text}; the survey ended after {swarm.steps_flown} steps: {ending}.")
    return re.sub(r"\b([xy]|\d+) (?=-?\d|m\b|GHz|UAVs?\b|steps)", r"\1&nbsp;", text)


def _tiles(outcome: Outcome) -> Iterator[str]:
    """The key numbers; the script keeps those that are live at the step shown."""
    scores = {name: values[-1] for name, values in outcome.scores.items()}
    first = {name: values[0] for name, values in outcome.scores.items()}
    readings, outdoor = outcome.result.measurements, outcome.scenario.outdoor

    def tile(name: str, value: str, unit: str, note: str, live: str = "") -> str:
        mark = f' data-live="{live}"' if live else ""
        return (
            f'    <div{mark}><dt>{_escaped(name)}</dt><dd class="value"><span>{value}</span><small>'
            f" {_escaped(unit)}</small></dd>"
            f'<dd class="note">{_escaped(note)}</dd></div>'
        )

    def known(name: str) -> bool:
        return bool(np.isfinite(scores.get(name, np.nan)))

    for name, label in (("rmse_db", "RMSE, unvisited"), ("expected_rmse_db", "RMSE, as predicted")):
        if known(name):
            note = f"{first[name]:.1f} dB at the start"
            yield tile(label, f"{scores[name]:.1f}", "dB", note, name)
    if known("coverage90"):
        value = f"{100 * scores['coverage90']:.0f}"
        note = "of unvisited cells; 90 % is ideal"
        yield tile("Inside the 90 % interval", value, "%", note, "coverage90")
    if known("gof"):
        note = "0 is ideal, above is overconfident"
        yield tile("Goodness of fit", _signed(scores["gof"]), "", note, "gof")
    yield (
        '    <div data-live="covered"><dt>At or above <label><span class="hidden">Threshold'
        f'</span><input type="number" id="threshold" step="any" value="{outcome.threshold:g}">'
        f"</label> {outcome.unit}</dt>"
        f'<dd class="value"><span>{100 * outcome.covered:.0f}</span><small> %</small></dd>'
        '<dd class="note">of the outdoor cells, as estimated</dd></div>'
    )
    way_m, speed = float(outcome.flown_m[-1]), outcome.speed_mps
    note = f"{way_m / speed / 60:.1f} min at {speed:g} m/s"
    yield tile("Flown by each UAV", f"{way_m:.0f}", "m", note, "flown")
    measured = readings.visited(outcome.grid.shape) & outdoor
    count = f"{len(readings):,}".replace(",", " ")
    note = f"in {100 * measured.sum() / outdoor.sum():.1f} % of the outdoor cells"
    yield tile("Readings", count, "", note, "readings")
    delay = outcome.result.timings["decision_ms_median"]
    if np.isfinite(delay):
        value, unit = (f"{delay:.3g}", "ms") if delay < 1000 else (f"{delay / 1000:.1f}", "s")
        yield tile("Planning", value, unit, "per decision, median")


def _key(outcome: Outcome) -> Iterator[str]:
    yield (
        '        <li><i class="swatch uav" style="background:#E69F00"></i>UAV, its latest moves '
        "drawn thick</li>"
    )
    if outcome.low_roofs.any():
        yield '        <li><i class="swatch low"></i>roof below the flight</li>'
    if outcome.transmitter_m is not None:
        west, south, east, north = outcome.grid.bounds_m
        x, y, _ = outcome.transmitter_m
        beyond = "" if west <= x <= east and south <= y <= north else " (beyond the map)"
        yield f'        <li><i class="swatch star">★</i>transmitter{beyond}</li>'
    if outcome.scenario.no_fly is not None and outcome.scenario.no_fly.any():
        yield '        <li><i class="swatch no-fly"></i>edge of a no-fly zone</li>'


def _score_table(outcome: Outcome) -> str:
    """The charts' numbers for those who read rather than look."""
    names = [name for name, values in outcome.scores.items() if np.isfinite(values).any()]
    if not names:
        return "      <p>No scores were recorded.</p>"
    head = "".join(
        "<th "
        f'scope="col">{_escaped(score_label(name))}{" (dB)" if name.endswith("_db") else ""}</th>'
        for name in names
    )
    rows = []
    for k, step in enumerate(outcome.steps):
        cells = "".join(f"<td>{_cell(outcome.scores[name][k], name)}</td>" for name in names)
        rows.append(f'      <tr><th scope="row">{step}</th>{cells}</tr>')
    return (
        f'      <table>\n      <thead><tr><th scope="col">step</th>{head}</tr></thead>\n      '
        "<tbody>\n" + ("\n".join(rows) + "\n      </tbody>\n      </table>")
    )


def _cell(value: float, name: str) -> str:
    if not np.isfinite(value):
        return "–"
    return (
        f"{100 * value:.1f} %" if name.startswith("coverage") else f"{value:.2f}".replace("-", "−")
    )


def _notes(outcome: Outcome) -> str:
    """What was read, mended and assumed, as a card; nothing where there is nothing to tell."""
    lines = [*([str(outcome.source["place"])] if outcome.source else []), *outcome.notes]
    if not lines:
        return ""
    items = "\n".join(f"      <li>{_escaped(line)}</li>" for line in lines)
    return (
        '  <details class="card" open>\n    <summary>What was read and assumed</summary>\n'
        f"    <ul>\n{items}\n    </ul>\n  </details>"
    )


def _settings_table(config: Mapping[str, Any]) -> str:
    rows = [
        f'      <tr><th scope="row">{_escaped(name)}</th>'
        f"<td>{_escaped('–' if value is None else str(value))}</td></tr>"
        for name, value in _flattened(config)
    ]
    if not rows:
        return "      <p>None were recorded.</p>"
    return (
        '      <table class="settings">\n      <tbody>\n'
        + "\n".join(rows)
        + "\n      </tbody>\n      </table>"
    )


def _flattened(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every setting with its dotted name."""
    for name, value in config.items():
        if isinstance(value, Mapping):
            yield from _flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _escaped(text: str) -> str:
    """``text`` as HTML shows it, on one line, without control characters."""
    return html.escape(" ".join("".join(c if c.isprintable() else " " for c in str(text)).split()))


def _for_script(value: Any) -> str:
    """JSON that cannot end the script element it stands in, whatever its strings hold."""
    text = json.dumps(
        value, allow_nan=False, separators=(",", ":")
    )  # ASCII only, so no line separators either
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
