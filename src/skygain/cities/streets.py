"""Streets as lines on a map: where somebody can walk or drive."""

from __future__ import annotations

__all__ = ["LEG_M", "read_streets", "street_legs"]

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.reading import existing_file
from skygain.frames import parse_crs
from skygain.grid import Grid
from skygain.ground.errors import InputError, require

LEG_M = 60.0
"""about how long a leg of a street is"""
_LEAST = 0.3
"""shorter pieces of a street than this share of a leg are left out"""


def read_streets(path: str | Path, grid: Grid) -> list[Any]:
    """The lines of a file that lie on a map, joined end to end where two meet, as Shapely lines in
    the map's metres.

    Args:
        path: a file of lines (.geojson, .gpkg, .shp, .kml, …), or .osm or .pbf, of which the
            highways are taken.
        grid: the map.

    Raises:
        InputError: the file cannot be read, has no lines, or none touches the map.
    """
    path = existing_file(path)
    raw, pyogrio = require("pyogrio.raw", "geo"), require("pyogrio", "geo")
    shapely = require("shapely", "geo")
    is_osm = path.suffix.lower() in (".osm", ".pbf")
    try:
        layers = [(str(name), str(kind)) for name, kind in pyogrio.list_layers(path)]
        name = next((n for n, kind in layers if "Line" in kind), layers[0][0] if layers else None)
        where = {"where": "highway IS NOT NULL"} if is_osm else {}
        meta, _, wkb, _ = raw.read(path, layer="lines" if is_osm else name, columns=[], **where)
        lines = shapely.from_wkb(wkb, on_invalid="ignore")
    except InputError:
        raise
    except Exception as error:  # GDAL answers foreign bytes with a dozen kinds of error
        raise InputError(
            f"{path.name}: not readable as streets ({' '.join(str(error).split())[:120]}); give "
            "`streets` as lines, such as .geojson, .gpkg or .osm"
        ) from error
    lines = shapely.get_parts(shapely.force_2d(lines))
    lines = lines[shapely.get_type_id(lines) == shapely.GeometryType.LINESTRING]
    if not len(lines):
        raise InputError(f"{path.name} holds no lines; give `streets` as lines, such as .geojson")
    lines = _moved(lines, parse_crs(meta["crs"]), grid, path)
    lines = shapely.intersection(lines, shapely.box(*grid.bounds_m))
    joined = shapely.line_merge(shapely.union_all(lines))
    found = [p for p in shapely.get_parts(joined) if p.geom_type == "LineString" and p.length > 0]
    if not found:
        raise InputError(f"{path.name}: no street lies on the map; give another `streets`")
    return found


def _moved(lines: NDArray[np.object_], own: Any | None, grid: Grid, path: Path) -> NDArray:
    """The lines in the map's metres."""
    target = parse_crs(grid.crs)
    if own is None or target is None:
        if grid.crs is None and path.suffix.lower() not in (".osm", ".pbf", ".kml"):
            return lines
        raise InputError(
            f"{path.name}: only one of the map and the streets has a place on Earth; give "
            "`streets` in the map's own frame"
        )
    pyproj = require("pyproj", "geo")
    move = pyproj.Transformer.from_crs(own, target, always_xy=True)
    moved: NDArray[np.object_] = require("shapely", "geo").transform(
        lines, lambda xy: np.column_stack(move.transform(xy[:, 0], xy[:, 1], errcheck=False))
    )
    return moved


def street_legs(streets: list[Any], length_m: float = LEG_M) -> list[NDArray[np.float64]]:
    """``[leg][point, (x, y)]`` the streets cut into legs of about one length."""
    cut = require("shapely.ops", "geo").substring
    legs = []
    for street in streets:
        parts = max(1, round(street.length / length_m))
        ends = np.linspace(0.0, street.length, parts + 1)
        if street.length < _LEAST * length_m:
            continue
        for start, end in pairwise(ends):
            legs.append(np.array(cut(street, start, end).coords, dtype=np.float64)[:, :2])
    return legs
