"""Pictures of a survey for papers, slides and run folders.

All maps are drawn in metres with x to the east and y to the north. Gains are drawn in viridis,
uncertainty in magma and errors in red and blue, which people with any colour vision can tell apart;
buildings are grey, the darker the higher. Matplotlib is loaded on the first use and driven through
its objects, so a caller's own figures and settings are left alone.
"""

from __future__ import annotations

__all__ = [
    "UAV_COLOURS",
    "paths_picture",
    "survey_figure",
    "survey_maps",
    "uav_colours",
]

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.reports.axes import (
    INK,
    building_shades,
    colour_bar,
    extent_m,
    frame_axes,
    save_png,
    scale_and_north,
    titled_figure,
)
from skygain.reports.outcome import Outcome
from skygain.reports.scales import error_reach, gain_limits, std_high

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UAV_COLOURS = (
    "#E69F00",
    "#56B4E9",
    "#CC79A7",
    "#D55E00",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#999999",
)
"""one colour per UAV, after Okabe and Ito (2008), for swarms that need no more"""

_ROOF = "#3A4550"
_NUMBERED = 12
"""swarms up to this size have their numbers at start and end"""


def survey_maps(outcome: Outcome, path: Path) -> None:
    """Write `survey_figure` as PNG."""
    save_png(survey_figure(outcome), path)


def survey_figure(outcome: Outcome) -> Figure:
    """Truth, estimate, error and uncertainty at the end of the survey, in one figure.

    Truth and estimate share one colour scale. Without a truth the readings take its place and the
    error is left out.
    """
    truth, estimate = outcome.outdoor_truth_db, outcome.mean_db
    shown = [outcome.measured_db if truth is None else truth, estimate]
    low, high = gain_limits(outcome)
    figure = titled_figure((16.2, 5.3) if truth is None else (11.0, 10.2), outcome.title)
    axes = figure.subplots(*((1, 3) if truth is None else (2, 2))).ravel()
    names = (
        "Readings"
        if truth is None
        else "Truth"
        if outcome.truth_is_complete
        else "Truth, where known",
        "Estimate",
    )
    for panel, values, name in zip(axes, shown, names, strict=False):
        image = _map(panel, outcome, values, name, cmap="viridis", vmin=low, vmax=high)
        colour_bar(figure, image, panel, outcome.level_label, extend="both")
        _transmitter(panel, outcome)
    _thin_paths(axes[1], outcome)
    scale_and_north(axes[0], outcome.grid)
    if truth is not None:
        error = estimate - truth
        reach = error_reach(outcome)
        rmse = float(np.sqrt(np.nanmean(error**2)))
        name = f"Error (estimate − truth), RMSE {rmse:.1f} dB"
        image = _map(axes[2], outcome, error, name, cmap="RdBu_r", vmin=-reach, vmax=reach)
        colour_bar(figure, image, axes[2], "error in dB", extend="both")
    image = _map(
        axes[-1],
        outcome,
        outcome.std_db,
        "Uncertainty (standard deviation)",
        cmap="magma",
        vmin=0,
        vmax=std_high(outcome),
    )
    colour_bar(figure, image, axes[-1], "standard deviation in dB", extend="max")
    for panel in axes:
        panel.label_outer()
    return figure


def paths_picture(outcome: Outcome, path: Path) -> None:
    """Where the UAVs flew, over the building heights; one colour per UAV, a circle at its start, a
    square at its end."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid, scenario = outcome.grid, outcome.scenario
    history = outcome.result.swarm.history
    figure = titled_figure((7.4, 6.6), outcome.title)
    axes = figure.subplots()
    height = np.where(scenario.city.height_m > 0, scenario.city.height_m, np.nan)
    frame_axes(axes, outcome.grid)
    uavs = "1 UAV" if len(history) == 1 else f"{len(history)} UAVs"
    axes.set_title(f"{uavs}, {history.shape[1] - 1} steps", loc="left", color=INK)
    greys = LinearSegmentedColormap.from_list("roofs", ["#DDE1E6", "#59636E"])
    image = axes.imshow(
        height, origin="lower", extent=extent_m(grid), cmap=greys, vmin=0, vmax=_tallest(height)
    )
    if np.isfinite(height).any():
        colour_bar(figure, image, axes, "building height in m")
    if scenario.no_fly is not None and scenario.no_fly.any():
        _no_fly(axes, outcome, scenario.no_fly)
    low = outcome.low_roofs
    if low.any():
        _hatch(axes, outcome, low, "...", "white")

    # UAVs that share a street are drawn beside each other, within a cell; a swarm is drawn thinner.
    many = len(history)
    aside = (np.arange(many) - (many - 1) / 2) * grid.spacing_m * min(0.16, 0.7 / many)
    thin = float(np.clip(6 / many, 0.4, 1.0))
    ends: dict[str, Any] = {"ha": "center", "va": "center_baseline"}
    ends |= {"fontsize": 6.5, "zorder": 7}
    size = 9.0 if many <= _NUMBERED else 9 * max(thin, 0.5)
    joins: dict[str, Any] = {"solid_joinstyle": "round", "solid_capstyle": "round"}
    colours = uav_colours(many)
    handles: list[Any] = []
    for uav, cells in enumerate(history):
        x, y = (grid.xy_m(cells) + aside[uav]).T
        axes.plot(x, y, color=INK, lw=2.6 * thin, alpha=0.55, zorder=3, **joins)
        axes.plot(x, y, color=colours[uav], lw=1.5 * thin, zorder=4, **joins)
        for where, marker in ((0, "o"), (-1, "s")):
            look: dict[str, Any] = {"color": colours[uav], "mec": INK, "clip_on": False}
            look["mew"] = 1.1 * thin
            axes.plot(x[where], y[where], marker, ms=size, zorder=6, **look)
            if 1 < many <= _NUMBERED:
                ink = _ink_on(colours[uav])
                axes.annotate(
                    str(uav), (x[where], y[where]), color=ink, annotation_clip=False, **ends
                )
        handles.append(Line2D([], [], color=colours[uav], lw=2.5, label=f"UAV {uav}"))
    _transmitter(axes, outcome)
    scale_and_north(axes, grid)
    handles = handles if many <= len(UAV_COLOURS) else []
    handles += [
        Line2D([], [], ls="", marker=marker, color="white", mec=INK, ms=7, label=label)
        for marker, label in (
            ("o", "home" if (outcome.config or {}).get("home") else "start"),
            ("s", "end"),
        )
    ]
    if outcome.transmitter_m is not None and _on_map(outcome):
        handles.append(
            Line2D([], [], ls="", marker="*", color="#FFD23F", mec=INK, ms=12, label="transmitter")
        )
    if scenario.no_fly is not None and scenario.no_fly.any():
        handles.append(Patch(fc=(0.70, 0.15, 0.12, 0.10), ec="#B3261E", lw=0.8, label="no-fly"))
    figure.legend(
        handles=handles, loc="outside lower center", ncols=min(len(handles), 7), frameon=False
    )
    save_png(figure, path)


def _ink_on(colour: str) -> str:
    """The colour of writing on ``colour``."""
    from matplotlib.colors import to_rgb

    return INK if float(np.dot(to_rgb(colour), (0.3, 0.59, 0.11))) > 0.5 else "white"


def uav_colours(uavs: int) -> list[str]:
    """A colour per UAV; larger swarms take evenly spaced hues, so that neighbours in number
    differ."""
    from matplotlib.colors import hsv_to_rgb, to_hex

    if uavs <= len(UAV_COLOURS):
        return list(UAV_COLOURS[:uavs])
    hue = (np.arange(uavs) * 0.618034) % 1.0
    value = np.where(np.arange(uavs) % 2, 0.92, 0.72)
    return [to_hex(tuple(hsv_to_rgb((h, 0.75, v)))) for h, v in zip(hue, value, strict=True)]


def _map(
    axes: Axes, outcome: Outcome, values: NDArray[np.float64], title: str, **colours: Any
) -> Any:
    """One map with the buildings over it; returns the image for its colour bar."""
    frame_axes(axes, outcome.grid)
    axes.set_title(title, loc="left", color=INK)
    image = axes.imshow(
        values, origin="lower", extent=extent_m(outcome.grid), interpolation="nearest", **colours
    )
    axes.imshow(
        building_shades(outcome.scenario.city.height_m, ~outcome.scenario.outdoor),
        origin="lower",
        extent=extent_m(outcome.grid),
        interpolation="nearest",
    )
    low = outcome.low_roofs
    if low.any():  # what the map is drawn over
        for colour, wide, alpha in (("white", 1.3, 0.4), (_ROOF, 0.6, 0.9)):
            _outline(axes, outcome, low, colors=colour, linewidths=wide, alpha=alpha)
    return image


def _hatch(axes: Axes, outcome: Outcome, mask: NDArray[np.bool_], hatch: str, colour: str) -> None:
    """Hatch the cells of ``mask``."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    grid, half = outcome.grid, outcome.grid.spacing_m / 2
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half), (-half, -half)])
    squares = grid.xy_m(np.argwhere(mask))[:, None] + corners
    codes = np.tile([Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY], len(squares))
    axes.add_patch(
        PathPatch(
            Outline(squares.reshape(-1, 2), codes),
            fc="none",
            ec=colour,
            lw=0,
            hatch=hatch,
            zorder=2,
        )
    )


def _no_fly(axes: Axes, outcome: Outcome, mask: NDArray[np.bool_]) -> None:
    """Tint the no-fly cells and draw a line where flying ends; a hatch would drown a map that is
    mostly no-fly."""
    tint = np.zeros((*mask.shape, 4))
    tint[mask] = (0.70, 0.15, 0.12, 0.10)
    axes.imshow(tint, origin="lower", extent=extent_m(outcome.grid), interpolation="nearest")
    _outline(axes, outcome, mask, colors="#B3261E", linewidths=0.8, alpha=0.8)


def _outline(axes: Axes, outcome: Outcome, mask: NDArray[np.bool_], **look: Any) -> None:
    """A line round the cells of ``mask``."""
    from matplotlib.collections import LineCollection

    grid, half = outcome.grid, outcome.grid.spacing_m / 2
    upper = grid.xy_m(np.argwhere(mask[1:] != mask[:-1]))[:, None] + [(-half, half), (half, half)]
    right = grid.xy_m(np.argwhere(mask[:, 1:] != mask[:, :-1]))[:, None] + [
        (half, -half),
        (half, half),
    ]
    axes.add_collection(LineCollection([*upper, *right], zorder=2, **look))


def _thin_paths(axes: Axes, outcome: Outcome) -> None:
    """The flights, thin enough to leave the map readable."""
    for cells in outcome.result.swarm.history:
        x, y = outcome.grid.xy_m(cells).T
        axes.plot(x, y, color="black", lw=1.5, alpha=0.5, zorder=3)
        axes.plot(x, y, color="white", lw=0.7, alpha=0.9, zorder=4)
        axes.plot(
            x[-1], y[-1], "s", ms=4, color="white", mec="black", mew=0.8, zorder=5, clip_on=False
        )


def _transmitter(axes: Axes, outcome: Outcome) -> None:
    if outcome.transmitter_m is not None and _on_map(outcome):
        x, y, _ = outcome.transmitter_m
        axes.plot(x, y, "*", ms=15, color="#FFD23F", mec="black", mew=1.0, zorder=7, clip_on=False)


def _on_map(outcome: Outcome) -> bool:
    """Whether the transmitter lies on the map."""
    west, south, east, north = outcome.grid.bounds_m
    x, y = outcome.transmitter_m[:2] if outcome.transmitter_m else (np.nan, np.nan)
    return bool(west <= x <= east and south <= y <= north)


def _tallest(height: NDArray[np.floating]) -> float:
    """Upper end of the scale of heights, 1 m at least."""
    finite = height[np.isfinite(height)]
    return max(float(finite.max()), 1.0) if finite.size else 1.0
