"""What the report's script is given: maps, paths, readings and charts as plain values.

A map costs one byte per cell: 0 says "nothing here", 1 to 255 span the range of values. Frames are
stored as differences to the frame before, modulo 256, and deflated together, since between two
frames a belief changes only where the UAVs have been.
"""

from __future__ import annotations

__all__ = ["map_views", "page_data", "shown_frames"]

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.rollout import Frame
from skygain.ground.errors import MissingExtraError
from skygain.reports.outcome import Outcome, score_label
from skygain.reports.pictures import uav_colours
from skygain.reports.scales import error_reach, gain_limits, std_high

_MOST_MAP_BYTES = 48_000_000
"""unpacked size of all maps above which frames are left out of the animation, evenly and never the
first or the last"""

_GROUPS = (
    ("Error and uncertainty", "dB", ("rmse_db", "rmse_all_db", "expected_rmse_db", "crps_db"), ()),
    ("Error by propagation", "dB", ("rmse_ray_traced_db", "rmse_rest_db"), ()),
    ("Interval coverage", "%", ("coverage50", "coverage90"), (0.5, 0.9)),
    ("Goodness of fit", "", ("gof",), (0.0,)),
    ("Negative log likelihood", "nats", ("nll",), ()),
)
"""charts of the report: title, unit, scores, values that would be ideal"""


_LIVE = ("rmse_db", "expected_rmse_db", "coverage90", "gof")
"""scores whose figures follow the step shown"""


def shown_frames(outcome: Outcome) -> list[Frame]:
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


def map_views(outcome: Outcome) -> dict[str, dict[str, Any]]:
    """The maps that can be shown, each with its colour scale; scales hold for all frames and are
    those of the pictures, so that colours can be compared."""
    truth = outcome.outdoor_truth_db
    low, high = gain_limits(outcome)
    gain = {"low": low, "high": high, "colours": "viridis", "label": outcome.level_label}
    views = {
        "mean": {"short": "Estimate", **gain, "label": f"estimated {outcome.level_label}"},
        "std": {
            "short": "Uncertainty",
            "low": 0.0,
            "high": std_high(outcome),
            "colours": "magma",
            "label": "predicted standard deviation in dB",
        },
    }
    if truth is not None:
        reach = error_reach(outcome)
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


def page_data(
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
    std_range = 0.0, max(float(frame.std_db[outdoor].max()) for frame in frames)
    highest = max(float(scenario.city.height_m.max()), 1.0)

    mean = np.stack(
        [_codes(np.where(outdoor, frame.mean_db, np.nan), *gain_range) for frame in frames]
    )
    std = np.stack(
        [_codes(np.where(outdoor, frame.std_db, np.nan), *std_range) for frame in frames]
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
        "uav_colours": uav_colours(len(history)),
        "transmitter_m": None
        if outcome.transmitter_m is None
        else [float(v) for v in outcome.transmitter_m],
        "highest_m": highest,
        "gain_range": gain_range,
        "std_high": std_range[1],
        "steps": [int(frame.step) for frame in frames],
        "score_steps": outcome.steps,
        "first_view": "mean",
        "views": views,
        "groups": _groups(outcome),
        "live": {
            name: [v if np.isfinite(v) else None for v in outcome.scores[name]]
            for name in _LIVE
            if name in outcome.scores
        },
        "flown_m": [float(v) for v in outcome.flown_m],
        "speed_mps": outcome.speed_mps,
        "unit": outcome.unit,
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
