"""Cities from building footprints, in any format that `skygain.cities.vector` reads.

Polygons become prisms. Roof shapes are ignored: a building has one height, that of its highest
point, as OpenStreetMap's ``height`` is defined. Four rules need saying:

- *Buildings.* A polygon tagged ``building`` or ``building:part`` is one, and so is one with a
  height or levels. Where nothing is tagged, every polygon is one.
- *Parts.* Where polygons tagged ``building:part`` lie on a building, they count and the building's
  own outline does not: the outline keeps its height only where no part covers it, and goes entirely
  if less than a tenth is left.
- *Missing heights.* ``height`` counts before ``building:levels`` (3 m each); a part without either
  takes its building's height; all others get a default, and how many did is counted.
- *Overhangs.* The raster has one height per cell, and UAVs are kept out of cells by it. A cell
  under a bridge or an overhanging part therefore has the height of its top, although the street is
  open beneath. The polygons keep their base, so rays do pass.
"""

from __future__ import annotations

__all__ = ["DEFAULT_HEIGHT_M", "read_footprints"]

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.layers import Z
from skygain.cities.prisms import above_ground, by_third_coordinate, prisms, rasterised, with_parts
from skygain.cities.reading import (
    CityOptions,
    Reading,
    check_overlap,
    city_name,
    existing_file,
)
from skygain.cities.tags import (
    HEIGHT_NAMES,
    LEVEL_M,
    BuildingTags,
    HeightField,
    height_like,
    parse_height_field,
    plain_name,
    read_tags,
)
from skygain.cities.vector import Layer, open_layer
from skygain.city import City
from skygain.frames import (
    Bounds,
    box_in_metres,
    grid_over,
    in_degrees,
    metric_crs,
    parse_crs,
    transformed_bounds,
)
from skygain.ground.errors import InputError, require

DEFAULT_HEIGHT_M = 3 * LEVEL_M
"""height of a building for which the file gives none"""

_FARTHEST = 1e8
"""no projection has coordinates beyond this; arithmetic with larger ones overflows"""

_STRAY_M = 20_000.0
"""a polygon closer to the middle of all is no stray"""

_MARGIN_M = 100.0
"""how far beyond a box parts are looked for"""


def read_footprints(path: str | Path, options: CityOptions | None = None, **given: Any) -> Reading:
    """Read building footprints.

    Args:
        path: the file; its ending says what it is (see `skygain.cities.vector.SUFFIXES`).
        options: how; ``given`` are single fields of `CityOptions`, which count before it.

    Returns:
        The city with its polygons, in the file's projection or, if that is none in true metres, in
        UTM.

    Raises:
        InputError: the file is unreadable, has no building polygons (in the box), no coordinate
            reference system, or coordinates that do not fit it.
    """
    options = replace(options or CityOptions(), **given)
    path = existing_file(path)
    default = options.default_height_m
    if default is not None and not (math.isfinite(default) and default > 0):
        raise InputError(f"`default_height_m` must be a positive number of metres, got {default}")
    if options.terrain is not None and options.terrain.startswith("band:"):
        raise InputError(f"{path.name}: footprints have no bands; give `terrain` as a raster file")
    try:
        return _read(path, options)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    except require("shapely", "geo").errors.GEOSException as error:
        raise InputError(
            f"{path.name}: the polygons cannot be mended ({error}); repair them in a GIS first"
        ) from error


def _read(path: Path, options: CityOptions) -> Reading:
    box, spacing_m = options.box, 4.0 if options.spacing_m is None else options.spacing_m
    field = parse_height_field(options.height_field)
    source = open_layer(
        path,
        options.layer,
        options.crs,
        field=field.name if field else None,
        skip_bad=options.skip_bad,
    )
    field = _found(field, source)
    target, bounds, window = _frame(source.crs, box)
    geometries, attributes = source.features(window, field.name if field else None)
    if box is not None and window is not None and not len(geometries):
        _explain_miss(source, window, box)
    counts: Counter[str] = Counter()
    counts["lines that are no features, left out"] = source.left_out
    geometries, tags = _selected(geometries, [read_tags(a, field) for a in attributes], counts)
    if bounds is None and len(geometries):
        target = metric_crs(source.crs, _bounds(geometries))
    polygons, tags = _polygons(_projected(geometries, source.crs, target), tags, counts)
    if not len(polygons):
        found = (
            "; ".join(f"{count} {what}" for what, count in sorted(counts.items()) if count)
            or "nothing at all"
        )
        raise InputError(
            f"no building polygons{' in the box' if box else ''}, found {found}; expected polygons "
            "with an area"
        )
    if target is None:
        _check_metres(polygons)
    if bounds is None:
        data_m = _bounds(polygons)
        bounds = _outward(data_m, spacing_m) if box is None else box_in_metres(box, target)
        if box is not None:
            check_overlap(bounds, data_m, box, target)
    if box is None:
        _check_together(polygons, target)
    grid = grid_over(bounds, spacing_m, target)
    polygons, tags = _meeting(
        *with_parts(*_meeting(polygons, tags, _grown(grid.bounds_m)), counts), grid.bounds_m
    )
    if not len(polygons):
        raise InputError("no building polygons in the box; choose a `box` that has some")
    city = City(grid=grid, height_m=np.zeros(grid.shape, np.float32), name=city_name(path))
    remarks: list[str] = []
    if options.terrain not in (None, "none"):
        city = _over(city, str(options.terrain))
        remarks.append(
            f"the ground lies {city.ground_m.min():.4g} to {city.ground_m.max():.4g} m high"
        )
    tags = by_third_coordinate(polygons, tags, city, options, counts, remarks)
    tags = above_ground(polygons, tags, city, options.terrain, counts)
    default = DEFAULT_HEIGHT_M if options.default_height_m is None else options.default_height_m
    missing = sum(tag.height_m is None for tag in tags)
    buildings = prisms(polygons, tags, default, counts)
    city = replace(city, buildings=buildings, height_m=rasterised(buildings, grid))
    named = [
        name for name in source.fields if height_like(name) and plain_name(name) not in HEIGHT_NAMES
    ]
    if 2 * missing > len(tags) and named and field is None:
        remarks.append(
            f"heights may stand in {', '.join(named[:5])}: give `height_field` with the unit, e.g. "
            f"{named[0]}:m or {named[0]}:ft"
        )
    if not city.height_m.any():
        remarks.append(
            f"no cell's centre is built up, the buildings are smaller than cells of {spacing_m:g} "
            "m; give a smaller `spacing_m`"
        )
    return Reading(
        city,
        {
            "buildings": len(buildings),
            **{what: count for what, count in sorted(counts.items()) if count},
        },
        tuple(remarks),
    )


def _found(field: HeightField | None, source: Layer) -> HeightField | None:
    """The field as the layer calls it.

    Raises:
        InputError: it has none of that name.
    """
    if field is None or field.name in source.fields or source.is_osm or not source.fields:
        return field
    for name in source.fields:
        if plain_name(name) == plain_name(field.name):
            return replace(field, name=name)
    if field.name.lower() == "z":
        return replace(field, name=Z)
    raise InputError(
        f"there is no column {field.name!r} for `height_field`; the file has "
        f"{', '.join(source.fields)[:300]}"
    )


def _check_metres(polygons: NDArray[np.object_]) -> None:
    west, south, east, north = _bounds(polygons)
    if max(east - west, north - south) < 2.0 and in_degrees((west, south, east, north)):
        raise InputError(
            f"all polygons lie within {max(east - west, north - south):.3g} m, so the coordinates "
            "look like degrees; give `crs` as 'EPSG:4326'"
        )


def _check_together(polygons: NDArray[np.object_], target: Any | None) -> None:
    """Refuse a few strays far from all others, for which the map would be mostly empty."""
    x0, y0, x1, y1 = require("shapely", "geo").bounds(polygons).T
    middle = np.stack([(x0 + x1) / 2, (y0 + y1) / 2], axis=-1)
    away = np.hypot(*(middle - np.median(middle, axis=0)).T)
    stray = away > max(_STRAY_M, 20 * float(np.median(away)))
    if 0 < stray.sum() <= 0.2 * len(polygons):
        rest = _bounds(polygons[~stray])
        if target is not None:
            rest = transformed_bounds(rest, target, parse_crs("EPSG:4326"))
        corners = ",".join(f"{v:.10g}" for v in rest)
        raise InputError(
            f"{int(stray.sum())} of {len(polygons)} polygons lie up to {away.max() / 1000:,.0f} km "
            f"from the others; leave them out with `box={corners}`, or mend their coordinates"
        )


def _over(city: City, terrain: str) -> City:
    """The city on the ground that the terrain model says."""
    from skygain.cities.elevations import filled
    from skygain.cities.raster import terrain_on

    ground, datum = terrain_on(terrain, city.grid)
    return replace(city, ground_m=filled(ground)[0].astype(np.float32), ground_datum=datum)


def _frame(own: Any | None, box: Bounds | None) -> tuple[Any | None, Bounds | None, Bounds | None]:
    """Projection of the map, its bounds in metres, and the rectangle of the file's coordinates to
    read for it.

    All are ``None`` where they follow from the data: without a box, or with a box in the metres of
    a UTM zone yet to be found.
    """
    if box is None:
        return None, None, None
    if own is None:
        bounds = box_in_metres(box, None)
        return None, bounds, _grown(bounds)
    if in_degrees(box):
        target = metric_crs(own, box_in_metres(box, own))
        bounds = box_in_metres(box, target)
        return target, bounds, transformed_bounds(_grown(bounds), target, own)
    bounds = box_in_metres(box, own)
    if own.is_projected and metric_crs(own, bounds) == own:
        return own, bounds, _grown(bounds)
    return None, None, None


def _explain_miss(source: Layer, window: Bounds, box: Bounds) -> None:
    extent = source.extent()
    if extent is not None:
        check_overlap(window, extent, box, source.crs)


def _selected(
    geometries: NDArray[np.object_], tags: list[BuildingTags], counts: Counter[str]
) -> tuple[NDArray[np.object_], list[BuildingTags]]:
    """The features that are buildings above ground and have finite coordinates."""
    wanted = np.array([t.is_building for t in tags], dtype=bool)
    if not wanted.any():
        wanted[:] = True
    else:
        tall = ~wanted & np.array([t.is_tall for t in tags], dtype=bool)
        counts["untagged polygons with a height, taken as buildings"] += int(tall.sum())
        wanted |= tall
        counts["features that are no buildings, left out"] += int((~wanted).sum())
    underground = wanted & np.array([t.is_underground for t in tags], dtype=bool)
    counts["underground, left out"] += int(underground.sum())
    wanted &= ~underground
    solid = _placed(geometries)
    counts["without a polygon, left out"] += int((wanted & ~solid).sum())
    kept = np.flatnonzero(wanted & solid)
    return geometries[kept], [tags[i] for i in kept]


def _projected(
    geometries: NDArray[np.object_], own: Any | None, target: Any | None
) -> NDArray[np.object_]:
    if own is None or target is None or own == target:
        return geometries
    shapely = require("shapely", "geo")
    pyproj = require("pyproj", "geo")
    transformer = pyproj.Transformer.from_crs(own, target, always_xy=True)
    moved: NDArray[np.object_] = shapely.transform(
        geometries,
        lambda xy: np.column_stack(transformer.transform(xy[:, 0], xy[:, 1], errcheck=False)),
    )
    return moved


def _polygons(
    geometries: NDArray[np.object_], tags: list[BuildingTags], counts: Counter[str]
) -> tuple[NDArray[np.object_], list[BuildingTags]]:
    """Valid polygons with an area, counter-clockwise; one feature may give several."""
    shapely = require("shapely", "geo")
    finite = _placed(geometries)
    geometries = geometries.copy()
    broken = finite & ~shapely.is_valid(geometries)
    geometries[broken] = shapely.make_valid(
        geometries[broken], method="structure", keep_collapsed=False
    )
    geometries[~finite] = None
    counts["polygons mended"] += int(broken.sum())
    parts, owner = shapely.get_parts(geometries, return_index=True)
    polygons, within = shapely.get_parts(
        parts, return_index=True
    )  # a collection may hold multi-polygons
    owner = owner[within]
    good = (shapely.get_type_id(polygons) == shapely.GeometryType.POLYGON) & (
        shapely.area(polygons) > 0
    )
    counts["without a polygon, left out"] += len(geometries) - len(np.unique(owner[good]))
    return shapely.orient_polygons(polygons[good]), [tags[i] for i in owner[good]]


def _meeting(
    polygons: NDArray[np.object_], tags: list[BuildingTags], bounds_m: Bounds
) -> tuple[NDArray[np.object_], list[BuildingTags]]:
    """The polygons whose bounds overlap ``bounds_m``."""
    west, south, east, north = bounds_m
    x0, y0, x1, y1 = require("shapely", "geo").bounds(polygons).T
    kept = np.flatnonzero((x1 > west) & (x0 < east) & (y1 > south) & (y0 < north))
    return polygons[kept], [tags[i] for i in kept]


def _grown(bounds_m: Bounds) -> Bounds:
    """The bounds with a margin in which the parts of buildings at their edge are found."""
    west, south, east, north = bounds_m
    return west - _MARGIN_M, south - _MARGIN_M, east + _MARGIN_M, north + _MARGIN_M


def _outward(bounds_m: Bounds, spacing_m: float) -> Bounds:
    """The bounds moved outwards to multiples of the spacing, so that extracts of one city share
    their cells."""
    if not (math.isfinite(spacing_m) and spacing_m > 0):
        raise InputError(
            f"`spacing_m` must be a positive number of metres, got {spacing_m}; 4 is usual"
        )
    west, south, east, north = bounds_m
    low = np.floor(np.array([west, south]) / spacing_m) * spacing_m
    high = np.ceil(np.array([east, north]) / spacing_m) * spacing_m
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _bounds(geometries: NDArray[np.object_]) -> Bounds:
    west, south, east, north = (
        float(v) for v in require("shapely", "geo").total_bounds(geometries)
    )
    return west, south, east, north


def _placed(geometries: NDArray[np.object_]) -> NDArray[np.bool_]:
    """Which geometries exist and have coordinates that can be some place on Earth, in any unit."""
    bounds: NDArray[np.float64] = require("shapely", "geo").bounds(
        geometries
    )  # [geometry, edge], NaN for none
    return np.all(np.abs(bounds) < _FARTHEST, axis=1)
