"""The paper's figures, drawn from rollouts with their 95 % bands."""

from __future__ import annotations

__all__ = ["draw_altitudes", "draw_delay", "draw_gain_bins", "draw_methods"]

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skygain.evaluation.comparison import Comparison
from skygain.evaluation.paper.claims import Flown
from skygain.evaluation.paper.gain import gain_curves
from skygain.evaluation.statistics import bootstrap_mean
from skygain.evaluation.tables import curve_intervals
from skygain.reports.axes import INK, SOFT, quiet, save_png, titled_figure
from skygain.reports.curves import rmse_curves

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#8A6D00", "#56B4E9", "#222222")
_MARKERS = "osD^vPX"


def draw_methods(flown: Flown, setting: str, path: Path, title: str) -> None:
    """Error against steps of every method of one setting."""
    curves = curve_intervals(flown.comparisons[setting])
    kept = {label: curves[label] for label in _labels(flown, setting)}
    rmse_curves(kept, path, title=title)


def draw_altitudes(flown: Flown, path: Path, title: str) -> None:
    """Error against steps, a panel for each altitude."""
    shown = [s for s in ("three", "altitude-20", "altitude-30") if s in flown.comparisons]
    figure = titled_figure((4.2 * len(shown) + 0.6, 4.6), title)
    panels = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
    looks: dict[str, Any] = {}
    for panel, setting in zip(panels, shown, strict=True):
        curves = curve_intervals(flown.comparisons[setting])
        for role, label in flown.roles[setting].items():
            look = looks.setdefault(role, _look(len(looks)))
            steps, mean, low, high = curves[label]
            panel.fill_between(steps, low, high, color=look["color"], alpha=0.14, lw=0)
            panel.plot(steps, mean, label=_predictor_name(role, label), **look)
        altitude = flown.settings[setting].altitude_m
        _axes(panel, f"{altitude:g} m", "steps per UAV", "")
    panels[0].set_ylabel("RMSE in dB", color=SOFT)
    panels[0].set_ylim(bottom=0)
    handles = {
        label: handle
        for panel in panels
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False
    )
    save_png(figure, path)


def draw_gain_bins(flown: Flown, path: Path, title: str) -> None:
    """Error and goodness of fit in bins of true gain."""
    comparison = flown.comparisons["three"]
    figure = titled_figure((11.0, 4.4), title)
    left, right = figure.subplots(1, 2)
    for number, label in enumerate(_labels(flown, "three")):
        curves = gain_curves(comparison.by_gain[label], comparison.cities)
        look = _look(number)
        for axes, draws in ((left, curves.rmse_db), (right, curves.gof)):
            if curves.cities > 1:
                low, high = np.nanquantile(draws[1:], [0.025, 0.975], axis=0)
                axes.fill_between(curves.gain_db, low, high, color=look["color"], alpha=0.14, lw=0)
            axes.plot(curves.gain_db, draws[0], label=label.partition(" / ")[0], **look)
    right.axhline(0, color=SOFT, lw=0.8)
    _axes(left, "Error", "true gain in dB", "RMSE in dB")
    _axes(right, "Above 0: too sure; below: too careful", "true gain in dB", "goodness of fit")
    left.set_ylim(bottom=0)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False
    )
    save_png(figure, path)


def draw_delay(flown: Flown, path: Path, title: str) -> None:
    """Delay per decision and per planned step, on a logarithmic axis."""
    figure = titled_figure((11.0, 4.4), title)
    panels = figure.subplots(1, 2, sharey=True)
    shown = [s for s in ("two", "three") if s in flown.comparisons]
    roles = list(dict.fromkeys(role for s in shown for role in flown.roles[s]))
    for panel, part in zip(panels, ("decision", "planned_step"), strict=True):
        for k, setting in enumerate(shown):
            comparison = flown.comparisons[setting]
            at = _delays(comparison, flown.roles[setting], f"{part}_ms_median")
            where = [roles.index(role) + 0.18 * (2 * k - 1) for role in at]
            mean = np.array([v[0] for v in at.values()])
            reach = np.abs(np.array([v[1:] for v in at.values()]).T - mean)
            panel.errorbar(
                mean,
                where,
                xerr=np.nan_to_num(reach),
                fmt=_MARKERS[k],
                color=_COLOURS[k],
                capsize=3,
                label=f"{flown.settings[setting].uavs} UAVs",
            )
        panel.set_xscale("log")
        _axes(panel, f"per {part.replace('_', ' ')}", "milliseconds", "")
    panels[0].set_yticks(range(len(roles)), roles)
    panels[0].invert_yaxis()
    panels[0].legend(frameon=False)
    save_png(figure, path)


def _delays(
    comparison: Comparison, roles: Mapping[str, str], name: str
) -> dict[str, tuple[float, float, float]]:
    """Role → mean delay with its interval."""
    found = {}
    for role, label in roles.items():
        interval = bootstrap_mean(comparison.delays[label][name], comparison.cities)
        found[role] = (interval.mean, interval.low, interval.high)
    return found


def _labels(flown: Flown, setting: str) -> list[str]:
    return list(dict.fromkeys(flown.roles[setting].values()))


def _predictor_name(role: str, label: str) -> str:
    """The same for all altitudes, so that the legend has one entry."""
    return {"network": "the paper's network, one for each altitude"}.get(
        role, label.partition(" / ")[0]
    )


def _look(number: int) -> dict[str, Any]:
    colour = _COLOURS[number % len(_COLOURS)]
    marker = _MARKERS[number % len(_MARKERS)]
    return {"color": colour, "marker": marker, "lw": 1.8, "ms": 4.5, "mec": "white", "mew": 0.5}


def _axes(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", color=INK)
    axes.set_xlabel(x, color=SOFT)
    axes.set_ylabel(y, color=SOFT)
    axes.grid(True, color="#E3E7EB", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    quiet(axes)
