"""From the coordinates of a file to a grid in metres.

A grid needs a projection whose metre is a metre. A file in degrees, in feet, or in a projection
that stretches (web maps enlarge by 1/cos latitude) is therefore brought to the UTM zone of its
centre; any other projection is kept as it is. A file without georeference may be read in a local
frame of metres, and then nothing has latitudes.
"""

from __future__ import annotations

__all__ = [
    "LOCAL",
    "MAX_CELLS",
    "Bounds",
    "box_in_metres",
    "crs_label",
    "grid_over",
    "in_degrees",
    "metric_crs",
    "parse_crs",
    "transformed_bounds",
    "vertical_datum",
]

from typing import Any, TypeAlias

import numpy as np

from skygain.grid import Grid
from skygain.ground.errors import InputError, require

Bounds: TypeAlias = tuple[float, float, float, float]
"""(west, south, east, north)"""

LOCAL = "local"
"""given as ``crs``, it says that coordinates are metres in a frame of their own"""

MAX_CELLS = 25_000_000
"""largest map; 5000 x 5000 cells take 100 MB per layer"""

_SCALE_TOLERANCE = 0.01
"""a projection is kept if its metre is within this share of a true metre"""


def parse_crs(text: str | None) -> Any | None:
    """A ``pyproj.CRS`` without a vertical part; ``None`` for `LOCAL` or an engineering CRS, which
    have no place on Earth.

    Raises:
        InputError: the text names no coordinate reference system.
    """
    if text is None or text == LOCAL:
        return None
    pyproj = require("pyproj", "geo")
    try:
        crs = pyproj.CRS.from_user_input(text).to_2d()
    except pyproj.exceptions.CRSError as error:
        raise InputError(
            f"unknown coordinate reference system {str(text)[:80]!r}; give `crs`, e.g. "
            f"'EPSG:32617', or {LOCAL!r} for plain metres"
        ) from error
    if crs.is_compound:
        crs = crs.sub_crs_list[0]
    return None if crs.is_engineering else crs


def vertical_datum(wkt: str | None) -> tuple[str, str] | None:
    """Name and unit of the heights that a compound coordinate reference system declares, such as
    ``("NAVD88 height", "metre")``; ``None`` where none is declared."""
    if not wkt:
        return None
    pyproj = require("pyproj", "geo")
    try:
        crs = pyproj.CRS.from_user_input(wkt)
    except pyproj.exceptions.CRSError:
        return None
    vertical = [part for part in crs.sub_crs_list if part.is_vertical]
    if not vertical:
        return None
    return str(vertical[0].name), str(vertical[0].axis_info[0].unit_name)


def metric_crs(crs: Any | None, bounds: Bounds) -> Any | None:
    """The projection in metres for a map with these ``bounds`` in ``crs``: the CRS itself or the
    UTM zone of the centre.

    Zones are the regular ones, 6 degrees wide, without the exceptions off Norway.

    Raises:
        InputError: the bounds are not coordinates of that CRS, or the map is beyond the reach of
            UTM (84 degrees).
    """
    if crs is None:
        return None
    pyproj = require("pyproj", "geo")
    x, y = (bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2
    if crs.is_geographic:
        _check_degrees(bounds, crs)
    elif not crs.is_projected:
        raise InputError(
            f"{crs.name!r} is neither geographic nor projected; reproject the file or give `crs`, "
            "e.g. 'EPSG:32617'"
        )
    lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)
    if not (np.isfinite([lon, lat]).all() and abs(lat) <= 84):
        raise InputError(
            f"x {x:g}, y {y:g} is no place {crs.name!r} can map (or beyond 84 degrees latitude); "
            "give the right `crs`"
        )
    if crs.is_projected and all(axis.unit_name == "metre" for axis in crs.axis_info):
        scale = pyproj.Proj(crs).get_factors(lon, lat)
        if max(abs(scale.meridional_scale - 1), abs(scale.parallel_scale - 1)) <= _SCALE_TOLERANCE:
            return crs
    zone = int((lon + 180) // 6) % 60 + 1
    return pyproj.CRS.from_epsg((32600 if lat >= 0 else 32700) + zone)


def crs_label(crs: Any | None) -> str | None:
    """The text `Grid.crs` keeps: an EPSG code where there is one, else WKT."""
    if crs is None:
        return None
    code = crs.to_epsg()
    return f"EPSG:{code}" if code else str(crs.to_wkt())


def transformed_bounds(bounds: Bounds, source: Any | None, target: Any | None) -> Bounds:
    """The upright rectangle in ``target`` that holds all of ``bounds`` in ``source``.

    Raises:
        InputError: it has no finite corners.
    """
    if source is None or target is None or source == target:
        return bounds
    pyproj = require("pyproj", "geo")
    try:
        found = pyproj.Transformer.from_crs(source, target, always_xy=True).transform_bounds(
            *bounds
        )
    except pyproj.exceptions.ProjError:
        found = (np.nan,) * 4
    if not np.isfinite(found).all():
        raise InputError(
            f"the area {_shown(bounds)} of {source.name!r} cannot be mapped to {target.name!r}; "
            "give the right `crs`"
        )
    west, south, east, north = found
    return west, south, east, north


def box_in_metres(box: Bounds, crs: Any | None) -> Bounds:
    """A ``box`` asked for, in the metres of ``crs``.

    The four numbers are degrees if the map is georeferenced and they can be degrees (longitude,
    latitude, longitude, latitude); otherwise they are metres already.

    Raises:
        InputError: not four finite numbers with west < east and south < north.
    """
    values = np.asarray(box, dtype=float)
    if (
        values.shape != (4,)
        or not np.isfinite(values).all()
        or values[0] >= values[2]
        or values[1] >= values[3]
    ):
        raise InputError(
            "`box` is four numbers west,south,east,north (longitude before latitude), west less "
            "than east and south less than "
            f"north; got {box}"
        )
    west, south, east, north = (float(v) for v in values)
    if crs is not None and in_degrees(box):
        try:
            return transformed_bounds((west, south, east, north), parse_crs("EPSG:4326"), crs)
        except InputError as error:
            raise InputError(
                f"the box {_shown(box)} degrees is nowhere near the map in {crs.name!r}; choose a "
                "`box` inside it"
            ) from error
    return west, south, east, north


def in_degrees(box: Bounds) -> bool:
    """Whether the four numbers can be longitudes and latitudes."""
    return max(abs(box[0]), abs(box[2])) <= 180 and max(abs(box[1]), abs(box[3])) <= 90


def grid_over(bounds_m: Bounds, spacing_m: float, crs: Any | None) -> Grid:
    """The grid whose south-west corner is that of ``bounds_m`` and whose size is nearest to theirs.

    Raises:
        InputError: the spacing is not a positive number, or there would be more than `MAX_CELLS`
            cells.
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise InputError(
            f"`spacing_m` must be a positive number of metres, got {spacing_m}; 4 is usual"
        )
    west, south, east, north = bounds_m
    with np.errstate(over="ignore"):
        cols, rows = np.maximum(1.0, np.rint(np.array([east - west, north - south]) / spacing_m))
        cells = rows * cols
    if not cells <= MAX_CELLS:
        raise InputError(
            f"{east - west:.4g} x {north - south:.4g} m in cells of {spacing_m:g} m are "
            f"{cells:.3g} cells, more than "
            f"{MAX_CELLS:,}; choose a smaller `box` or a larger `spacing_m`"
        )
    origin = (float(west + spacing_m / 2), float(south + spacing_m / 2))
    return Grid(
        shape=(int(rows), int(cols)),
        spacing_m=float(spacing_m),
        origin_m=origin,
        crs=crs_label(crs),
    )


def _check_degrees(bounds: Bounds, crs: Any) -> None:
    west, south, east, north = bounds
    if -180.5 <= west <= east <= 360.5 and -90.5 <= south <= north <= 90.5:
        return
    hint = "give `crs` as the system they are in, e.g. 'EPSG:32617', or 'local' for plain metres"
    if -90.5 <= west <= east <= 90.5 and -180.5 <= south <= north <= 360.5:
        hint = "latitude and longitude look swapped, longitude comes first"
    raise InputError(
        f"coordinates {_shown(bounds)} are not longitudes and latitudes of {crs.name!r}; {hint}"
    )


def _shown(bounds: Bounds) -> str:
    return "[" + ", ".join(f"{v:.9g}" for v in bounds) + "]"
