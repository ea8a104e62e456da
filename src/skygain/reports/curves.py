"""Curves over the steps of surveys: of one, and of methods that are compared."""

from __future__ import annotations

__all__ = ["rmse_curves", "rmse_picture"]

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError
from skygain.reports.axes import INK, SOFT, quiet, save_png, shortened, titled_figure
from skygain.reports.outcome import Outcome, score_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#8A6D00", "#56B4E9", "#222222")
_MARKERS = "osD^v"
_TOGETHER = 5
"""so many bands can be told apart in one panel; of more methods each gets a panel of its own"""
_ACROSS = 4
"""panels beside each other"""
_OTHERS = "#C9D0D6"

Columns = tuple[NDArray[np.float64], ...]


def rmse_picture(outcome: Outcome, path: Path) -> None:
    """Error and predicted uncertainty against the steps flown; without a truth, the predicted
    uncertainty alone."""
    figure = titled_figure((7.0, 4.2), outcome.title)
    axes = figure.subplots()
    names = [
        n
        for n in ("rmse_db", "rmse_all_db", "expected_rmse_db")
        if np.isfinite(outcome.scores.get(n, [])).any()
    ]
    for number, name in enumerate(names):
        colour = {"expected_rmse_db": SOFT}.get(name, _COLOURS[number])
        style = {"expected_rmse_db": "--"}.get(name, "-")
        values = outcome.scores[name]
        label = (
            f"{score_label(name)}  {values[-1]:.1f}"
            if np.isfinite(values[-1])
            else score_label(name)
        )
        axes.plot(outcome.steps, values, style, color=colour, lw=2, label=label)
    errors = any(name.startswith("rmse") for name in names)
    _curve_axes(
        axes, "dB", "Error against steps" if errors else "Predicted uncertainty against steps"
    )
    if names:
        axes.legend(frameon=False)
    else:
        axes.text(
            0.5, 0.5, "no scores were recorded", transform=axes.transAxes, ha="center", color=SOFT
        )
    save_png(figure, path)


def rmse_curves(
    curves: Mapping[str, tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]],
    path: Path,
    *,
    title: str = "Error against steps",
    unit: str = "RMSE in dB",
) -> None:
    """Curves of methods, each with its interval as a band.

    A few share one panel, with a legend in the order of their right ends. Of more, each has a panel
    of its own, in which the others are grey; the best at the end comes first.

    Args:
        curves: name of the method → (steps, mean, low, high), each of one length; NaN breaks a
            curve.
        path: the PNG to write.
        title: headline of the figure.
        unit: what stands at the vertical axis.

    Raises:
        InputError: there is no curve, or the columns of one differ in length.
    """
    if not curves:
        raise InputError("there is no curve to draw; give at least one method")
    arrays: dict[str, Columns] = {}
    for name, columns in curves.items():
        steps, *rest = (np.asarray(column, dtype=float) for column in columns)
        if any(column.shape != (len(steps),) for column in (steps, *rest)):
            raise InputError(
                f"the curve of {name!r} needs steps, mean, low and high of one length; give four "
                "equal columns"
            )
        arrays[name] = (steps, *rest)
    draw = _together if len(arrays) <= _TOGETHER else _apart
    draw(arrays, path, title, unit)


def _end(columns: Columns) -> float:
    """The last value of a curve, infinite where there is none."""
    finite = columns[1][np.isfinite(columns[1])]
    return float(finite[-1]) if finite.size else np.inf


def _together(curves: Mapping[str, Columns], path: Path, title: str, unit: str) -> None:
    """All in one panel."""
    figure = titled_figure((9.6, 4.8))
    axes = figure.subplots()
    lines: list[tuple[float, Any, str]] = []
    for number, (name, columns) in enumerate(curves.items()):
        steps, mean, low, high = columns
        colour = _COLOURS[number % len(_COLOURS)]
        axes.fill_between(steps, low, high, color=colour, alpha=0.14, lw=0)
        # markers start at different points, so that curves which run together still show theirs
        every = max(1, len(steps) // 8)
        look: dict[str, Any] = {"color": colour, "lw": 1.8, "marker": _MARKERS[number]}
        look |= {"ms": 5.5, "mec": "white", "mew": 0.6, "markevery": (number % every, every)}
        (line,) = axes.plot(steps, mean, **look)
        lines.append((_end(columns), line, name))
    lines.sort(key=lambda entry: -entry[0] if np.isfinite(entry[0]) else np.inf)
    _curve_axes(axes, unit, title)
    figure.legend(
        [line for _, line, _ in lines],
        [_labelled(name, last, 34) for last, _, name in lines],
        loc="outside right upper",
        frameon=False,
        handlelength=3.2,
        labelspacing=0.7,
    )
    save_png(figure, path)


def _apart(curves: Mapping[str, Columns], path: Path, title: str, unit: str) -> None:
    """A panel for each."""
    order = sorted(curves, key=lambda name: _end(curves[name]))
    down = -(-len(order) // _ACROSS)
    figure = titled_figure((12.4, 0.5 + 2.5 * down), title)
    panels = figure.subplots(down, _ACROSS, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, name in zip(panels, order, strict=False):
        for other in order:
            panel.plot(*curves[other][:2], color=_OTHERS, lw=0.9, zorder=1)
        steps, mean, low, high = curves[name]
        panel.fill_between(steps, low, high, color=_COLOURS[0], alpha=0.22, lw=0, zorder=2)
        panel.plot(steps, mean, color=_COLOURS[0], lw=2.0, zorder=3)
        _curve_axes(panel, "", "")
        label = _labelled(name, _end(curves[name]), 34)
        panel.set_title(label, loc="left", color=INK, fontsize=9, parse_math=False)
    for panel in panels[len(order) :]:
        panel.set_axis_off()
    for number, panel in enumerate(panels[: len(order)]):
        last = number + _ACROSS >= len(order)
        panel.set_xlabel("steps per UAV" if last else "", color=SOFT)
        panel.tick_params(labelbottom=last)
    figure.supylabel(unit, color=SOFT, fontsize=10)
    save_png(figure, path)


def _labelled(name: str, last: float, width: int) -> str:
    """A method's whole name, on as many lines as it takes, and where its curve ends."""
    text = shortened(name, 200) + (f"  {last:.2f}" if np.isfinite(last) else "")
    lines = textwrap.wrap(text.replace(":", " :"), width, break_on_hyphens=False)
    return "\n".join(line.replace(" :", ":") for line in lines)


def _curve_axes(axes: Axes, unit: str, title: str) -> None:
    axes.set_title(title, loc="left", color=INK)
    axes.set_xlabel("steps per UAV", color=SOFT)
    axes.set_ylabel(unit, color=SOFT)
    axes.grid(True, color="#E3E7EB", lw=0.8)
    axes.set_axisbelow(True)
    axes.margins(x=0.02)
    axes.spines[["top", "right"]].set_visible(False)
    quiet(axes)
