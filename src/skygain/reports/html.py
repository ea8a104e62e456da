"""The survey as one HTML file that can be mailed, archived and stepped through without a network.

The page, its style and its script stand in ``report_page/``; this module fills in the words and
packs the maps. A map costs one
byte per cell: 0 says "nothing here", 1 to 255 span the range of values. Frames are stored as
differences to the frame before, modulo 256, and deflated together, since between two frames a
belief changes only where the UAVs have been.
"""

from __future__ import annotations

__all__ = ["write_report"]

import base64
import html
import json
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.evaluation.rollout import Frame
from skygain.ground.errors import MissingExtraError
from skygain.ground.files import atomic_write
from skygain.reports.outcome import Outcome, score_label

_MOST_MAP_BYTES = 48_000_000
"""unpacked size of all maps above which frames are left out of the animation, evenly and never the
first or the last"""

_GROUPS = (
    ("Error and uncertainty", "dB", ("rmse_db", "rmse_all_db", "mean_std_db", "crps_db"), ()),
    ("Error by propagation", "dB", ("rmse_ray_traced_db", "rmse_rest_db"), ()),
    ("Interval coverage", "%", ("coverage50", "coverage90"), (0.5, 0.9)),
    ("Goodness of fit", "", ("gof",), (0.0,)),
    ("Negative log likelihood", "nats", ("nll",), ()),
)
"""charts of the report: title, unit, scores, values that would be ideal"""


def write_report(outcome: Outcome, path: Path) -> None:
    """Write ``report.html``: settings, scores and an animation of the survey, complete in one file.

    The animation can be played, stepped and searched with mouse, touch and keyboard and shows the
    estimate, its uncertainty and, where a truth is known, the error and the truth.
    ``report.html#step=50&view=std`` opens at a step and a map. Without frames the final belief is
    all it shows.
    """
    frames = _frames(outcome)
    views = _views(outcome, frames)
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
        "data": _for_script(_data(outcome, frames, views)),
        "style": (page / "page.css").read_text(encoding="utf-8").rstrip(),
        "script": (page / "page.js").read_text(encoding="utf-8").rstrip(),
    }
    template = (page / "page.html").read_text(encoding="utf-8")
    # one pass, so that a marker inside a title stays the text it is
    text = re.sub(r"\{\{(\w+)\}\}", lambda match: words[match.group(1)], template)
    with atomic_write(path) as tmp:
        tmp.write_text(text, encoding="utf-8", errors="replace")


def _frames(outcome: Outcome) -> list[Frame]:
    """The frames to animate: those with maps, thinned to what a browser can hold; the final belief
    when there is none."""
    shape = outcome.grid.shape
    frames = [frame for frame in outcome.frames if frame.mean_db.shape == shape]
    if not frames:
        swarm, posterior = outcome.result.swarm, outcome.posterior
        mean, std = posterior.mean_db.astype(np.float32), posterior.std_db.astype(np.float32)
        return [Frame(swarm.steps_flown, mean, std, swarm.history, {})]
    room = max(2, _MOST_MAP_BYTES // (2 * outcome.grid.size))
    if len(frames) > room:
        frames = [
            frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, room).round().astype(int))
        ]
    return frames


def _views(outcome: Outcome, frames: Sequence[Frame]) -> dict[str, dict[str, Any]]:
    """The maps that can be shown, each with its colour scale; scales hold for all frames, so that
    colours can be compared."""
    outdoor = outcome.scenario.outdoor
    truth = outcome.outdoor_truth_db
    means = np.stack([frame.mean_db[outdoor] for frame in frames])
    stds = np.stack([frame.std_db[outdoor] for frame in frames])
    shown = means if truth is None else truth[np.isfinite(truth)]
    low, high = _round_range(*np.percentile(shown, (1, 99.5)))
    gain = {"low": low, "high": high, "colours": "viridis", "label": outcome.level_label}
    views = {
        "mean": {"short": "Estimate", **gain, "label": f"estimated {outcome.level_label}"},
        "std": {
            "short": "Uncertainty",
            "low": 0.0,
            "high": _round_range(0.0, float(np.percentile(stds, 99.5)))[1],
            "colours": "magma",
            "label": "predicted standard deviation in dB",
        },
    }
    if truth is not None:
        error = means - truth[outdoor]
        reach = _round_range(0.0, float(np.nanpercentile(np.abs(error), 97)))[1]
        views["error"] = {
            "short": "Error",
            "low": -reach,
            "high": reach,
            "colours": "RdBu_r",
            "label": "error (estimate − truth) in dB",
        }
        views["truth"] = {
            "short": "Truth",
            **gain,
            "label": (
                f"true {outcome.level_label}{'' if outcome.truth_is_complete else ', where known'}"
            ),
        }
    return views


def _data(
    outcome: Outcome, frames: Sequence[Frame], views: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Everything the script needs, as plain values; the arrays are packed in ``blob``, in the order
    of ``sections``."""
    import matplotlib

    grid, scenario, readings = outcome.grid, outcome.scenario, outcome.result.measurements
    outdoor, history = scenario.outdoor, outcome.result.swarm.history
    truth = outcome.outdoor_truth_db
    gains = [frame.mean_db[outdoor] for frame in frames] + (
        [] if truth is None else [truth[np.isfinite(truth)]]
    )
    gain_range = min(float(g.min()) for g in gains), max(float(g.max()) for g in gains)
    std_high = max(float(frame.std_db[outdoor].max()) for frame in frames)
    highest = max(float(scenario.city.height_m.max()), 1.0)

    mean = np.stack(
        [_codes(np.where(outdoor, frame.mean_db, np.nan), *gain_range) for frame in frames]
    )
    std = np.stack(
        [_codes(np.where(outdoor, frame.std_db, np.nan), 0.0, std_high) for frame in frames]
    )
    arrays: dict[str, tuple[str, NDArray[Any]]] = {
        "reading_gain": ("f4", readings.gain_db),
        "reading_cell": ("i4", grid.flat(readings.cell)),
        "reading_step": ("i4", _reading_steps(outcome)),
        "reading_uav": ("i4", readings.uav),
        "paths": ("i2", history),
        "mean": ("u1", np.diff(mean, axis=0, prepend=np.zeros_like(mean[:1]))),
        "std": ("u1", np.diff(std, axis=0, prepend=np.zeros_like(std[:1]))),
        "height": ("u1", np.round(scenario.city.height_m / highest * 255)),
        "indoor": ("u1", ~outdoor),
    }
    if truth is not None:
        arrays["truth"] = ("u1", _codes(truth, *gain_range))
    if scenario.no_fly is not None and scenario.no_fly.any():
        arrays["no_fly"] = ("u1", scenario.no_fly)
    for name in {str(view["colours"]): None for view in views.values()}:
        colours = matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3]
        arrays[name] = ("u1", np.round(colours * 255))
    packed = zlib.compress(
        b"".join(values.astype(f"<{kind}").tobytes() for kind, values in arrays.values()), 9
    )
    return {
        "rows": grid.shape[0],
        "cols": grid.shape[1],
        "spacing_m": grid.spacing_m,
        "bounds_m": grid.bounds_m,
        "georeferenced": grid.crs is not None,
        "corners": _corners(outcome),
        "uavs": len(history),
        "transmitter_m": None
        if outcome.transmitter_m is None
        else [float(v) for v in outcome.transmitter_m],
        "highest_m": highest,
        "gain_range": gain_range,
        "std_high": std_high,
        "steps": [int(frame.step) for frame in frames],
        "score_steps": outcome.steps,
        "first_view": "mean",
        "views": views,
        "groups": _groups(outcome),
        "sections": [(name, kind, int(values.size)) for name, (kind, values) in arrays.items()],
        "blob": base64.b64encode(packed).decode("ascii"),
    }


def _codes(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    """One byte per value: 1 + 254 (v − low) / (high − low), rounded; 0 where the value is NaN."""
    part = (values - low) / max(high - low, 1e-9)
    return np.where(
        np.isfinite(values), 1 + np.round(254 * np.clip(np.nan_to_num(part), 0, 1)), 0
    ).astype(np.uint8)


def _reading_steps(outcome: Outcome) -> NDArray[np.int64]:
    """``[n]`` step at which each reading was taken, from the journal; the last step for a survey
    without one."""
    result = outcome.result
    steps = np.repeat(
        [record.step for record in result.journal], [record.readings for record in result.journal]
    )
    if len(steps) != len(result.measurements):
        return np.full(len(result.measurements), result.swarm.steps_flown)
    return steps.astype(np.int64)


def _corners(outcome: Outcome) -> list[list[float]] | None:
    """Latitude and longitude of the map's SW, SE, NW and NE corners; ``None`` without a CRS or
    without the geo extra."""
    if outcome.grid.crs is None:
        return None
    rows, cols = outcome.grid.shape
    try:
        return outcome.grid.latlon(
            [(r - 0.5, c - 0.5) for r in (0, rows) for c in (0, cols)]
        ).tolist()
    except MissingExtraError:
        return None


def _groups(outcome: Outcome) -> list[dict[str, Any]]:
    """The charts there is something to show in; a score nobody has grouped gets one of its own."""
    scores = outcome.scores
    grouped = {name for _, _, names, _ in _GROUPS for name in names} | {"error_ratio"}
    others = tuple((score_label(name), "", (name,), ()) for name in scores if name not in grouped)
    groups = []
    for title, unit, names, goals in (*_GROUPS, *others):
        lines = [
            {
                "label": score_label(name),
                "values": [v if np.isfinite(v) else None for v in scores[name]],
            }
            for name in names
            if name in scores and np.isfinite(scores[name]).any()
        ]
        if lines:
            if names[0].startswith("rmse") and not any(
                name.startswith("rmse") for name in names if name in scores
            ):
                title = "Uncertainty"  # without a truth there is no error
            groups.append(
                {
                    "title": title,
                    "unit": unit,
                    "lines": lines,
                    "goals": goals,
                    "from_zero": unit == "dB",
                }
            )
    return groups


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
    """The key numbers."""
    scores = {name: values[-1] for name, values in outcome.scores.items()}
    first = {name: values[0] for name, values in outcome.scores.items()}
    readings, outdoor = outcome.result.measurements, outcome.scenario.outdoor

    def tile(name: str, value: str, unit: str, note: str) -> str:
        return (
            f'    <div><dt>{_escaped(name)}</dt><dd class="value">{value}<small> '
            f"{_escaped(unit)}</small></dd>"
            f'<dd class="note">{_escaped(note)}</dd></div>'
        )

    if np.isfinite(scores.get("rmse_db", np.nan)):
        yield tile(
            "RMSE, unvisited cells",
            f"{scores['rmse_db']:.1f}",
            "dB",
            f"{first['rmse_db']:.1f} dB at the start",
        )
    if np.isfinite(scores.get("mean_std_db", np.nan)):
        yield tile(
            "Mean predicted deviation",
            f"{scores['mean_std_db']:.1f}",
            "dB",
            f"{first['mean_std_db']:.1f} dB at the start",
        )
    if np.isfinite(scores.get("coverage90", np.nan)):
        yield tile(
            "Inside the 90 % interval",
            f"{100 * scores['coverage90']:.0f}",
            "%",
            "of unvisited cells; 90 % is ideal",
        )
    if np.isfinite(scores.get("gof", np.nan)):
        yield tile(
            "Goodness of fit", _signed(scores["gof"]), "", "0 is ideal, above is overconfident"
        )
    measured = readings.visited(outcome.grid.shape) & outdoor
    share = measured.sum() / outdoor.sum()
    yield tile(
        "Readings",
        f"{len(readings):,}".replace(",", " "),
        "",
        f"in {100 * share:.1f} % of the outdoor cells",
    )
    delay = outcome.result.timings["decision_ms_median"]
    if np.isfinite(delay):
        value, unit = (f"{delay:.3g}", "ms") if delay < 1000 else (f"{delay / 1000:.1f}", "s")
        yield tile("Planning", value, unit, "per decision, median")


def _key(outcome: Outcome) -> Iterator[str]:
    yield (
        '        <li><i class="swatch uav" style="background:#E69F00"></i>UAV, its latest moves '
        "drawn thick</li>"
    )
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


def _round_range(low: float, high: float) -> tuple[float, float]:
    """The range widened to whole numbers, at least 1 wide."""
    low, high = float(np.floor(low)), float(np.ceil(high))
    return low, max(high, low + 1.0)


def _escaped(text: str) -> str:
    """``text`` as HTML shows it, on one line, without control characters."""
    return html.escape(" ".join("".join(c if c.isprintable() else " " for c in str(text)).split()))


def _for_script(value: Any) -> str:
    """JSON that cannot end the script element it stands in, whatever its strings hold."""
    text = json.dumps(
        value, allow_nan=False, separators=(",", ":")
    )  # ASCII only, so no line separators either
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
