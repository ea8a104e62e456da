"""Areas drawn as polygons: where a map is wanted, and where nobody may fly.

Any file of polygons does (KML, GeoJSON, GeoPackage, Shapefile, …). A zone may say between which
heights it holds: a floor and a ceiling above ground, in attributes or as the third coordinate of a
KML polygon that is relative to the ground.
"""

from __future__ import annotations

__all__ = ["Areas", "read_areas"]

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.layers import Z
from skygain.cities.reading import existing_file
from skygain.cities.tags import plain_name
from skygain.cities.vector import is_vector, open_layer
from skygain.frames import parse_crs
from skygain.grid import Grid
from skygain.ground.errors import InputError, require

_CEILINGS = ("ceiling", "ceilingm", "upper", "upperlimit", "uppervalue", "maxaltitude", "altmax")
_FLOORS = ("floor", "floorm", "lower", "lowerlimit", "lowervalue", "minaltitude", "altmin")
_FEET = ("ceilingft", "upperft", "upperlimitft"), ("floorft", "lowerft", "lowerlimitft")

_NAMES = frozenset((*_CEILINGS, *_FLOORS, *_FEET[0], *_FEET[1], "altitudemode", "extrude"))

_HEIGHT = re.compile(r"\s*(\d+(?:[.,]\d+)?)\s*(m|ft|feet)?\b.*")


@dataclass(frozen=True, eq=False)
class Areas:
    """Polygons on one map."""

    grid: Grid
    """the map"""
    polygons: tuple[Any, ...]
    """Shapely polygons in the map's metres"""
    floor_m: tuple[float, ...]
    """of each, the height above ground at which it begins; 0 where none is said"""
    ceiling_m: tuple[float, ...]
    """of each, the height above ground at which it ends; infinite where none is said"""
    notes: tuple[str, ...] = ()
    """what was left out or assumed"""

    def mask(self, altitude_m: float | None = None) -> NDArray[np.bool_]:
        """``[row, col]`` cells whose centre lies in a polygon, at ``altitude_m`` above ground if
        that is given: a zone holds from its floor up to its ceiling."""
        chosen = [
            polygon
            for polygon, floor, ceiling in zip(
                self.polygons, self.floor_m, self.ceiling_m, strict=True
            )
            if altitude_m is None or floor <= altitude_m <= ceiling
        ]
        if not chosen:
            return np.zeros(self.grid.shape, dtype=bool)
        features = require("rasterio.features", "geo")
        rasterio = require("rasterio", "geo")
        west, _, _, north = self.grid.bounds_m
        spacing = self.grid.spacing_m
        inside: NDArray[np.bool_] = features.rasterize(
            ((polygon, 1) for polygon in chosen),
            out_shape=self.grid.shape,
            transform=rasterio.Affine(spacing, 0.0, west, 0.0, -spacing, north),
            dtype="uint8",
        )[::-1].astype(bool)
        return inside


def read_areas(
    path: str | Path,
    grid: Grid,
    *,
    name: str = "area",
    crs: str | None = None,
    layer: str | None = None,
) -> Areas:
    """Read polygons onto a map.

    Args:
        path: a file of polygons.
        grid: the map.
        name: the parameter the file was given as, for the messages.
        crs: coordinate reference system of the file, against what it says.
        layer: which layer, where it has several with polygons.

    Raises:
        InputError: the file cannot be read, has no polygons, or none touches the map.
    """
    path = existing_file(path)
    if not is_vector(path):
        raise InputError(
            f"{path.name}: an area is read from polygons; give `{name}` as .geojson, .kml, .gpkg "
            "or .shp"
        )
    try:
        return _on(path, grid, name, crs, layer)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    except require("shapely", "geo").errors.GEOSException as error:
        raise InputError(f"{path.name}: the polygons cannot be mended ({error})") from error


def _on(path: Path, grid: Grid, name: str, crs: str | None, layer: str | None) -> Areas:
    shapely = require("shapely", "geo")
    if grid.crs is None and crs is None:
        crs = "local"  # a map without a place on Earth can only be met in its own metres
    source = open_layer(path, layer, crs)
    if (source.crs is None) != (grid.crs is None):
        raise InputError(
            "only one of the map and the polygons has a place on Earth; give the city's `crs`, or "
            f"`{name}` in the map's own metres"
        )
    shapes, attributes = source.features(names=_NAMES)
    target = parse_crs(grid.crs)
    if source.crs is not None and source.crs != target:
        pyproj = require("pyproj", "geo")
        move = pyproj.Transformer.from_crs(source.crs, target, always_xy=True)
        shapes = shapely.transform(
            shapes, lambda xy: np.column_stack(move.transform(xy[:, 0], xy[:, 1], errcheck=False))
        )
    polygons, floors, ceilings, left_out = [], [], [], 0
    for shape, known in zip(shapes, attributes, strict=True):
        sound = _polygons(shape)
        left_out += not sound
        floor, ceiling = _limits(known)
        polygons += sound
        floors += [floor] * len(sound)
        ceilings += [ceiling] * len(sound)
    if not polygons:
        raise InputError(
            f"expected polygons, found none among {len(shapes)} features; give another `{name}`"
        )
    _check_touch(polygons, grid, name)
    notes = [f"{left_out} features without a polygon, left out"] if left_out else []
    with_ceiling = sum(math.isfinite(c) for c in ceilings)
    if with_ceiling and name != "area":
        notes.append(f"{with_ceiling} of {len(polygons)} zones have a ceiling above ground")
    return Areas(grid, tuple(polygons), tuple(floors), tuple(ceilings), tuple(notes))


def _polygons(shape: Any) -> list[Any]:
    """The valid polygons of a geometry, none for another kind or for coordinates that are none."""
    shapely = require("shapely", "geo")
    if shape is None or not np.isfinite(shapely.bounds(shape)).all():
        return []
    parts = shapely.get_parts(shapely.get_parts(shapely.make_valid(shape)))
    return [part for part in parts if part.geom_type == "Polygon" and part.area > 0]


def _check_touch(polygons: Sequence[Any], grid: Grid, name: str) -> None:
    west, south, east, north = require("shapely", "geo").total_bounds(np.array(polygons))
    x0, y0, x1, y1 = grid.bounds_m
    if west < x1 and east > x0 and south < y1 and north > y0:
        return
    away = math.hypot(max(x0 - east, west - x1, 0), max(y0 - north, south - y1, 0))
    hint = "latitude and longitude may be exchanged" if away > 1e5 else "it is of another place"
    raise InputError(
        f"no polygon touches the map, they lie {away / 1000:,.1f} km off; {hint}: give another "
        f"`{name}`"
    )


def _limits(known: Mapping[str, Any]) -> tuple[float, float]:
    """Floor and ceiling in metres above ground."""
    plain = {plain_name(key): value for key, value in known.items() if key != Z}
    ceiling = _height(plain, _CEILINGS, _FEET[0])
    floor = _height(plain, _FLOORS, _FEET[1])
    if ceiling is None and str(plain.get("altitudemode", "")).lower() == "relativetoground":
        top = known.get(Z)
        ceiling = float(top) if top else None
    return floor or 0.0, math.inf if ceiling is None else ceiling


def _height(plain: Mapping[str, Any], names: Sequence[str], in_feet: Sequence[str]) -> float | None:
    for name in (*names, *in_feet):
        match = _HEIGHT.fullmatch(str(plain.get(name, "")).lower())
        if match:
            feet = name in in_feet or (match[2] or "").startswith("f")
            return float(match[1].replace(",", ".")) * (0.3048 if feet else 1.0)
    return None
