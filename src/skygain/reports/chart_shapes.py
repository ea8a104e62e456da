"""Lines, areas and places of a map of a campaign, for navigation and geographic programs."""

from __future__ import annotations

__all__ = ["contours", "coverage", "write_json", "write_places"]

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.reports.chart_words import unit_of
from skygain.reports.names import xml_text
from skygain.survey.mapping import RadioMap

Array = NDArray[np.float64]
_CONTOUR_STEP_DB = 10.0


def _lines(grid: Grid, xy: Array) -> list[list[float]]:
    """Points in metres as GeoJSON writes them: longitude and latitude where there are any."""
    if grid.crs is None:
        return [[round(float(x), 2), round(float(y), 2)] for x, y in xy]
    cells = (xy - np.asarray(grid.origin_m))[:, ::-1] / grid.spacing_m
    return [[round(float(lon), 7), round(float(lat), 7)] for lat, lon in grid.latlon(cells)]


def _generator(chart: RadioMap) -> Any:
    import contourpy

    grid = chart.grid
    if min(grid.shape) < 2:
        return None
    return contourpy.contour_generator(
        grid.x_m,
        grid.y_m,
        np.ma.masked_invalid(chart.mean_db),
        fill_type=contourpy.FillType.OuterOffset,
    )


def contours(charts: Sequence[RadioMap]) -> dict[str, Any]:
    """Lines of equal level, every 10 dB."""
    features = []
    for chart in charts:
        generator = _generator(chart)
        if generator is None:
            continue
        low, high = np.nanmin(chart.mean_db), np.nanmax(chart.mean_db)
        first = np.ceil(low / _CONTOUR_STEP_DB) * _CONTOUR_STEP_DB
        for level in np.arange(first, high, _CONTOUR_STEP_DB):
            for line in generator.lines(level):
                shape = {"type": "LineString", "coordinates": _lines(chart.grid, line)}
                features.append(_feature(shape, chart, float(level)))
    return {"type": "FeatureCollection", "features": features}


def coverage(charts: Sequence[RadioMap], threshold: float) -> dict[str, Any]:
    """Polygons where the estimate is at or above ``threshold``."""
    features = []
    for chart in charts:
        generator = _generator(chart)
        if generator is None:
            continue
        high = float(np.nanmax(chart.mean_db)) + 1.0
        if high <= threshold:
            continue
        for points, offsets in zip(*generator.filled(threshold, high), strict=True):
            rings = [points[a:b] for a, b in pairwise(offsets)]
            coordinates = [_lines(chart.grid, ring) for ring in rings]
            shape = {"type": "Polygon", "coordinates": coordinates}
            features.append(_feature(shape, chart, threshold))
    return {"type": "FeatureCollection", "features": features}


def _feature(shape: dict[str, Any], chart: RadioMap, level: float) -> dict[str, Any]:
    properties: dict[str, Any] = {"level": level, "unit": unit_of(chart)}
    if chart.label:
        properties["series"] = chart.label
    return {"type": "Feature", "properties": properties, "geometry": shape}


def write_json(content: Mapping[str, Any], path: Path) -> None:
    path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")


def write_places(
    grid: Grid,
    places: Mapping[str, NDArray[np.int64]],
    legs: Mapping[str, Sequence[Array]],
    folder: Path,
) -> None:
    """Where to measure next, places or legs of streets: GeoJSON, and on a map with a place on Earth
    KML and GPX (waypoints, or a route for each leg)."""
    marks: list[tuple[str, str, list[list[float]]]] = []
    for label, cells in places.items():
        points = _lines(grid, grid.xy_m(cells)) if len(cells) else []
        marks += [(label, str(i), [point]) for i, point in enumerate(points, start=1)]
    for label, lines in legs.items():
        marks += [(label, str(i), _lines(grid, line)) for i, line in enumerate(lines, start=1)]
    features = [
        {
            "type": "Feature",
            "properties": {"order": int(order)} | ({"series": label} if label else {}),
            "geometry": {"type": "Point", "coordinates": points[0]}
            if len(points) == 1
            else {"type": "LineString", "coordinates": points},
        }
        for label, order, points in marks
    ]
    write_json({"type": "FeatureCollection", "features": features}, folder / "next.geojson")
    if grid.crs is None:
        return
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    names = [xml_text(f"{label} {order}".strip()) for label, order, _ in marks]
    kml = "".join(
        f"<Placemark><name>{name}</name>{_kml(points)}</Placemark>\n"
        for name, (_, _, points) in zip(names, marks, strict=True)
    )
    (folder / "next.kml").write_text(
        f'{head}<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n{kml}</Document></kml>\n',
        encoding="utf-8",
    )
    gpx = "".join(_gpx(name, points) for name, (_, _, points) in zip(names, marks, strict=True))
    (folder / "next.gpx").write_text(
        f'{head}<gpx version="1.1" creator="Skygain" xmlns="http://www.topografix.com/GPX/1/1">\n'
        f"{gpx}</gpx>\n",
        encoding="utf-8",
    )


def _kml(points: list[list[float]]) -> str:
    kind = "Point" if len(points) == 1 else "LineString"
    return f"<{kind}><coordinates>{' '.join(f'{x},{y}' for x, y in points)}</coordinates></{kind}>"


def _gpx(name: str, points: list[list[float]]) -> str:
    if len(points) == 1:
        ((lon, lat),) = points
        return f'<wpt lat="{lat}" lon="{lon}"><name>{name}</name></wpt>\n'
    inner = "".join(f'<rtept lat="{lat}" lon="{lon}"/>' for lon, lat in points)
    return f"<rte><name>{name}</name>{inner}</rte>\n"
