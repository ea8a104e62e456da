"""The picture of the maps of a campaign, and the page around it."""

from __future__ import annotations

__all__ = ["chart_page", "chart_picture"]

import base64
import html
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.reports.axes import (
    INK,
    building_shades,
    colour_bar,
    extent_m,
    frame_axes,
    scale_and_north,
)
from skygain.reports.chart_words import level_limits, quantity_of, unit_of
from skygain.survey.mapping import RadioMap


def chart_picture(
    charts: Sequence[RadioMap],
    places: Mapping[str, NDArray[np.int64]],
    legs: Mapping[str, Sequence[NDArray[np.float64]]],
    title: str,
) -> bytes:
    """Readings, map and uncertainty of each series, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = list(charts[:6])
    figure = Figure(figsize=(15.5, 4.9 * len(shown)), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    bold = {"fontsize": 14, "fontweight": "bold", "color": INK, "parse_math": False}
    figure.suptitle(title, x=0.01, ha="left", **bold)
    grid = shown[0].grid
    rows = figure.subplots(len(shown), 3, squeeze=False, sharex=True, sharey=True)
    for axes, chart in zip(rows, shown, strict=True):
        known = chart.gridded.level_db
        low, high = level_limits(chart)
        levels = {"vmin": low, "vmax": high, "cmap": "viridis"}
        city, x, y = chart.scenario.city, *grid.xy_m(chart.gridded.cell).T
        common = {"origin": "lower", "extent": extent_m(grid)}
        built = city.obstructed(chart.scenario.prediction_altitude_m)
        for panel in axes:
            panel.imshow(building_shades(city.height_m, built), zorder=0.5, **common)
        dots = axes[0].scatter(x, y, c=known, s=4, linewidths=0, rasterized=True, **levels)
        mean = axes[1].imshow(chart.mean_db, **common, **levels)
        std = axes[2].imshow(chart.std_db, **common, cmap="magma", vmin=0)
        cells = places.get(chart.label, np.empty((0, 2), dtype=int))
        if len(cells):
            nx, ny = grid.xy_m(cells).T
            axes[2].plot(nx, ny, "o", mfc="none", mec="#56B4E9", ms=6, label="measure next")
        for leg in legs.get(chart.label, ()):
            axes[2].plot(*leg.T, color="#56B4E9", lw=2.5, solid_capstyle="round")
        if len(legs.get(chart.label, ())):
            axes[2].plot([], [], color="#56B4E9", lw=2.5, label="measure next")
        if axes[2].get_legend_handles_labels()[0]:
            axes[2].legend(loc="upper right", fontsize=8)
        prefix = f"{chart.label}: " if chart.label else ""
        level = f"{quantity_of(chart)} in {unit_of(chart)}"
        for panel, image, name, label in zip(
            axes,
            (dots, mean, std),
            (f"{prefix}readings", f"{prefix}map", f"{prefix}uncertainty"),
            (level, level, "standard deviation in dB"),
            strict=True,
        ):
            panel.set_title(name, loc="left", color=INK, parse_math=False)
            beyond = "neither" if image is std else "both"
            colour_bar(figure, image, panel, label, extend=beyond)
            frame_axes(panel, grid)
            panel.label_outer()
        scale_and_north(axes[0], grid)
    memory = io.BytesIO()
    figure.savefig(memory, format="png")
    return memory.getvalue()


def chart_page(
    charts: Sequence[RadioMap], results: Mapping[str, Any], picture: bytes, title: str
) -> str:
    """One page with the picture, the errors and what was assumed."""
    image = base64.b64encode(picture).decode("ascii")
    parts = list(_sections(charts, results))
    style = (
        "body{font:16px/1.5 system-ui,sans-serif;max-width:1200px;margin:2rem auto;padding:0 1rem;"
        "color:#1f2933}img{max-width:100%}table{border-collapse:collapse}td,th{padding:.2rem .8rem;"
        "text-align:left;border-bottom:1px solid #d8dde3}td+td{text-align:right;white-space:nowrap}"
        # on a phone the maps are as wide as they need be, and are moved by hand
        "@media screen and (max-width:700px){body{margin:.6rem auto}.maps{overflow-x:auto}"
        ".maps img{max-width:none;width:1150px}td,th{padding:.2rem .35rem;font-size:.85rem}}"
        "@page{size:A4 landscape;margin:12mm}@media print{body{margin:0;max-width:none}"
        "img,table{break-inside:avoid}}"
    )
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width, initial-scale=1"><title>{html.escape(title)}'
        f"</title><style>{style}</style></head><body>\n"
        '<div class="maps"><img alt="Readings, map and uncertainty" '
        f'src="data:image/png;base64,{image}"></div>\n'
        + "\n".join(parts)
        + f"\n<p>Skygain {html.escape(skygain.__version__)}</p></body></html>\n"
    )


def _sections(charts: Sequence[RadioMap], results: Mapping[str, Any]) -> Iterator[str]:
    for chart, told in zip(charts, results["series"], strict=True):
        if chart.label:
            yield f"<h2>{html.escape(chart.label)}</h2>"
        yield (
            f"<p>{told['readings']} readings in {told['measured_cells']} cells, predictor "
            f"{html.escape(chart.predictor)}."
            + (
                ""
                if told["covered"] is None
                else f" {told['covered']:.1%} of the map at or above {results['threshold']:g} "
                f"{unit_of(chart)}."
            )
            + "</p>"
        )
        rows = [
            f"<tr><td>{html.escape(name)}, {how}</td><td>{score.rmse_db:.2f} dB</td><td>"
            f"{score.low_db:.2f} … {score.high_db:.2f}</td><td>{score.coverage90:.0%}</td></tr>"
            for how, found in chart.scores.items()
            for name, score in found.items()
        ]
        if rows:
            yield (
                "<table><tr><th>left out</th><th>RMSE</th><th>90 % interval</th>"
                "<th>within the 90 % band</th></tr>" + "".join(rows) + "</table>"
            )
        if chart.notes:
            items = "".join(f"<li>{html.escape(note)}</li>" for note in chart.notes)
            yield f"<ul>{items}</ul>"
