"""Axes of maps: metres, a scale bar, an arrow to the north, and quiet colours."""

from __future__ import annotations

__all__ = [
    "INK",
    "SOFT",
    "building_shades",
    "colour_bar",
    "extent_m",
    "frame_axes",
    "quiet",
    "round_length",
    "save_png",
    "scale_and_north",
    "shortened",
    "titled_figure",
]

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.ground.files import atomic_write
from skygain.ground.shown import agg_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, SOFT = "#1F2933", "#66727F"
"""colours of titles, and of everything else that is written"""
_GROUND = "#F4F5F7"
_DPI = 160


def titled_figure(size: tuple[float, float], title: str = "") -> Figure:
    """A figure of ``size`` inches with a headline of two lines at most."""
    figure = agg_figure(size)
    if title:
        text = textwrap.fill(
            shortened(title, 300), width=int(9 * size[0]), max_lines=2, placeholder=" …"
        )
        figure.suptitle(
            text, x=0.01, ha="left", fontsize=14, fontweight="bold", color=INK, parse_math=False
        )
    return figure


def save_png(figure: Figure, path: Path) -> None:
    """Write the figure, whole or not at all."""
    with atomic_write(path) as tmp:
        figure.savefig(tmp, format="png", dpi=_DPI)


def shortened(text: str, longest: int) -> str:
    """``text`` on one line, cut where it would run out of the picture."""
    text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return text if len(text) <= longest else text[: longest - 1] + "…"


def frame_axes(axes: Axes, grid: Grid) -> None:
    """Metre axes; with a CRS the ticks count from the south-west corner, since eastings run to
    millions."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    west, south, east, north = grid.bounds_m
    axes.set(xlim=(west, east), ylim=(south, north), aspect="equal", facecolor=_GROUND)
    georeferenced = grid.crs is not None
    for axis, start, side, text in (
        (axes.xaxis, west, east - west, "x east"),
        (axes.yaxis, south, north - south, "y north"),
    ):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        if georeferenced:
            ticks = MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0, side)
            axis.set_ticks([start + t for t in ticks if 0 <= t <= side])
            axis.set_major_formatter(
                FuncFormatter(lambda value, _, start=start: f"{value - start:g}")
            )
        axis.set_label_text(
            f"{text} in m" + (f" (from {start:.0f})" if georeferenced else ""), color=SOFT
        )
    quiet(axes)


def scale_and_north(axes: Axes, grid: Grid) -> None:
    """A bar of a round length and an arrow to the north, in the south-west corner."""
    from matplotlib.patheffects import withStroke

    west, south, east, north = grid.bounds_m
    wide, high = east - west, north - south
    length = round_length(wide / 4)
    x, y = west + 0.03 * wide, south + 0.03 * high
    seen = [withStroke(linewidth=3.0, foreground="white")]
    look: dict[str, Any] = {"color": INK, "zorder": 8, "path_effects": seen}
    axes.plot([x, x + length], [y, y], lw=2.2, solid_capstyle="butt", **look)
    text: dict[str, Any] = {"fontsize": 8, "ha": "center", "va": "bottom", **look}
    axes.text(x + length / 2, y + 0.012 * high, f"{length:g} m", **text)
    tip = x + length + 0.05 * wide
    axes.plot([tip, tip], [y, y + 0.055 * high], lw=1.4, **look)
    axes.plot(tip, y + 0.055 * high, "^", ms=5, **look)
    axes.text(tip, y + 0.07 * high, "N", **text)


def round_length(metres: float) -> float:
    """The longest of 1, 2 or 5 times a power of ten that is not longer.

    >>> [round_length(m) for m in (72, 0.3, 199)]
    [50.0, 0.2, 100.0]
    """
    power = 10.0 ** np.floor(np.log10(metres))
    return float(max(m * power for m in (1, 2, 5) if m * power <= metres * (1 + 1e-9)))


def quiet(axes: Axes) -> None:
    """Frame and ticks that do not shout."""
    axes.tick_params(color="#B8C0C8", labelcolor=SOFT, labelsize=9)
    for spine in axes.spines.values():
        spine.set_color("#B8C0C8")


def colour_bar(figure: Figure, image: Any, axes: Axes, text: str, extend: str = "neither") -> None:
    """A bar beside ``axes``; ``extend`` names the ends that values lie beyond."""
    bar = figure.colorbar(image, ax=axes, shrink=0.86, aspect=28, pad=0.02, extend=extend)
    bar.set_label(text, color=SOFT)
    bar.outline.set_edgecolor("#B8C0C8")
    bar.ax.tick_params(color="#B8C0C8", labelcolor=SOFT, labelsize=9)


def building_shades(
    height_m: NDArray[np.floating], indoor: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """``[row, col, rgba]`` grey over the cells that are indoors, darker where the building is
    higher; clear elsewhere."""
    shade = np.zeros((*height_m.shape, 4))
    if indoor.any():
        low, high = float(height_m[indoor].min()), float(height_m[indoor].max())
        rank = (height_m - low) / max(high - low, 1e-9)
        shade[..., :3] = (0.80 - 0.40 * np.clip(rank, 0, 1))[..., None]
        shade[..., 3] = indoor
    return shade


def extent_m(grid: Grid) -> tuple[float, float, float, float]:
    """West, east, south, north: the order Matplotlib wants."""
    west, south, east, north = grid.bounds_m
    return west, east, south, north
