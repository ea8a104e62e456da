"""Pictures of a mission: the place with its plan, and how sure the map gets over the sorties."""

from __future__ import annotations

__all__ = ["site_picture", "sortie_figure"]

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skygain.ground.errors import require
from skygain.ground.files import atomic_write
from skygain.ground.shown import agg_figure
from skygain.missions.outlook import Outlook
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie
from skygain.reports.axes import INK, SOFT, extent_m, frame_axes, quiet, scale_and_north
from skygain.reports.pictures import uav_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 150
_NO_FLY = "#B3261E"


def site_picture(site: Site, path: Path, ahead: Outlook | None = None) -> None:
    """The place: area, buildings, what can be flown, homes; with the first sortie, and the
    certainty over the sorties, where they were simulated."""
    with_curve = ahead is not None and len(ahead.error_db) > 1
    figure = agg_figure((12.6, 6.6) if with_curve else (7.4, 6.8))
    figure.suptitle(
        f"Mission over {site.reading.city.name}",
        x=0.01,
        ha="left",
        fontsize=14,
        fontweight="bold",
        color=INK,
        parse_math=False,
    )
    if with_curve:
        axes, curve = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        assert ahead is not None
        _certainty(curve, site, ahead)
    else:
        axes = figure.subplots()
    first = ahead.sorties[0] if ahead is not None and ahead.sorties else None
    _place(axes, site)
    flights = first.flights if first else ()
    _flights(axes, flights)
    _pads(axes, site)
    title = f"{site.flyable_share:.0%} of the area can be flown at {site.altitude_text}"
    axes.set_title(title, loc="left", color=INK)
    _legend(figure, site, flights)
    _save(figure, path)


def sortie_figure(site: Site, sortie: Sortie) -> Figure:
    """One sortie over the place."""
    figure = agg_figure((8.4, 8.2))
    axes = figure.subplots()
    _place(axes, site)
    _flights(axes, sortie.flights)
    _pads(axes, site)
    axes.set_title(f"Sortie {sortie.number}", loc="left", color=INK)
    _legend(figure, site, sortie.flights)
    return figure


def _save(figure: Figure, path: Path) -> None:
    with atomic_write(path) as tmp:
        figure.savefig(tmp, format="png", dpi=_DPI)


def _place(axes: Axes, site: Site) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    frame_axes(axes, site.grid)
    height = np.where(site.city.height_m > 0, site.city.height_m, np.nan)
    greys = LinearSegmentedColormap.from_list("roofs", ["#DDE1E6", "#59636E"])
    tallest = max(1.0, float(np.nanmax(height, initial=1.0)))
    axes.imshow(
        height, origin="lower", extent=extent_m(site.grid), cmap=greys, vmin=0, vmax=tallest
    )
    _filled(axes, site.space.free, fc="#7FB77E", ec="none", alpha=0.18, zorder=1.5)
    _filled(axes, site.area, fc="none", ec=INK, lw=1.4, ls="--", zorder=2.5)
    for zone in site.zones:
        _filled(axes, zone, fc=_NO_FLY, ec=_NO_FLY, alpha=0.25, lw=1.0, zorder=2.4)
    scale_and_north(axes, site.grid)


def _filled(axes: Axes, shape: Any, **look: Any) -> None:
    """A polygon with its holes, or several."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    shapely = require("shapely", "geo")
    for part in shapely.get_parts(shape):
        if part.geom_type != "Polygon":
            continue
        rings = [np.asarray(r.coords) for r in (part.exterior, *part.interiors)]
        codes = [
            np.r_[Outline.MOVETO, np.full(len(r) - 2, Outline.LINETO), Outline.CLOSEPOLY]
            for r in rings
        ]
        axes.add_patch(PathPatch(Outline(np.vstack(rings), np.concatenate(codes)), **look))


def _flights(axes: Axes, flights: Sequence[Flight]) -> None:
    colours = uav_colours(max((f.uav for f in flights), default=0) + 1)
    for flight in flights:
        x, y, _ = flight.route_m.T
        n, colour = flight.measuring, colours[flight.uav]
        axes.plot(x[n - 1 :], y[n - 1 :], ":", color=INK, lw=2.2, zorder=3)
        axes.plot(x[n - 1 :], y[n - 1 :], ":", color=colour, lw=1.6, zorder=4)
        axes.plot(x[:n], y[:n], color=INK, lw=2.6, alpha=0.6, zorder=3)
        axes.plot(x[:n], y[:n], color=colour, lw=1.5, zorder=4)
        if n > 2:
            k = n // 2
            axes.annotate(
                "",
                (x[k], y[k]),
                ((x[k - 1] + x[k]) / 2, (y[k - 1] + y[k]) / 2),
                arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0},
                zorder=5,
            )


def _pads(axes: Axes, site: Site) -> None:
    colours = uav_colours(len(site.pads))
    for uav, pad in enumerate(site.pads):
        x, y = pad.xy_m
        axes.plot(x, y, "o", ms=10, color=colours[uav], mec=INK, mew=1.1, zorder=6)
        axes.annotate(
            str(uav), (x, y), ha="center", va="center_baseline", fontsize=7, color=INK, zorder=7
        )


def _legend(figure: Figure, site: Site, flights: Sequence[Flight]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(fc="#7FB77E", alpha=0.35, label="can be flown"),
        Line2D([], [], ls="--", color=INK, lw=1.4, label="area"),
        Line2D([], [], ls="", marker="o", color="white", mec=INK, ms=8, label="take-off"),
    ]
    if site.zones:
        handles.append(Patch(fc=_NO_FLY, alpha=0.3, label="no-fly"))
    if flights:
        handles += [
            Line2D([], [], color=SOFT, lw=2, label="measuring"),
            Line2D([], [], ls=":", color=SOFT, lw=2, label="way home"),
        ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)


def _certainty(axes: Axes, site: Site, ahead: Outlook) -> None:
    axes.plot(range(len(ahead.error_db)), ahead.error_db, "o-", color="#0072B2", lw=2)
    for k, value in enumerate(ahead.error_db):
        axes.annotate(
            f"{value:.1f}", (k, value), textcoords="offset points", xytext=(7, 5), color=SOFT
        )
    stop = site.request.stop_std_db
    if stop is not None:
        axes.axhline(stop, color=_NO_FLY, lw=1, ls="--")
        axes.annotate("good enough", (0, stop), xytext=(2, 3), textcoords="offset points",
                      color=_NO_FLY, fontsize=8)  # fmt: skip
    axes.set_ylim(bottom=0)
    axes.set_xticks(range(len(ahead.error_db)))
    axes.set_xlabel("sorties flown", color=SOFT)
    axes.set_ylabel("expected error in dB", color=SOFT)
    axes.set_title("How good the map gets", loc="left", color=INK)
    axes.grid(True, color="#E3E7EB", lw=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    quiet(axes)
