"""Polygons with their tags into prisms, and prisms into a raster."""

from __future__ import annotations

__all__ = ["above_ground", "by_third_coordinate", "prisms", "rasterised", "with_parts"]

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.reading import CityOptions
from skygain.cities.tags import BuildingTags
from skygain.city import Building, City
from skygain.grid import Grid
from skygain.ground.errors import InputError, require

_TALL_M, _SEVERAL = 100.0, 4
"""so many buildings that are all higher than this are heights above the sea"""
_COVERED = 0.9
"""share of an outline that parts must cover to replace it entirely"""


def with_parts(
    polygons: NDArray[np.object_], tags: list[BuildingTags], counts: Counter[str]
) -> tuple[NDArray[np.object_], list[BuildingTags]]:
    """Apply the rule for parts: outlines without what their parts cover, then the parts.

    A part belongs to an outline if more than half of it lies inside.
    """
    shapely = require("shapely", "geo")
    is_part = np.array([t.is_part for t in tags], dtype=bool)
    parts = np.flatnonzero(is_part)
    if not len(parts):
        return polygons, tags
    tree = shapely.STRtree(polygons[parts])
    part_tags = {int(i): tags[i] for i in parts}
    found: list[Any] = []
    found_tags: list[BuildingTags] = []
    for i in np.flatnonzero(~is_part):
        outline = polygons[i]
        near = parts[np.sort(tree.query(outline, predicate="intersects"))]
        own = near[
            shapely.area(shapely.intersection(polygons[near], outline))
            > 0.5 * shapely.area(polygons[near])
        ]
        pieces = [outline]
        if len(own):
            left = shapely.difference(outline, shapely.union_all(polygons[own]))
            replaced = shapely.area(left) < (1 - _COVERED) * shapely.area(outline)
            counts[
                "outlines replaced by their parts" if replaced else "outlines cut by their parts"
            ] += 1
            pieces = (
                []
                if replaced
                else [p for p in shapely.get_parts(left) if p.geom_type == "Polygon" and p.area > 0]
            )
            for j in own:
                if part_tags[int(j)].height_m is None and tags[i].height_m is not None:
                    part_tags[int(j)] = replace(part_tags[int(j)], height_m=tags[i].height_m)
        found += pieces
        found_tags += [tags[i]] * len(pieces)
    return np.array([*found, *polygons[parts]], dtype=object), [*found_tags, *part_tags.values()]


def by_third_coordinate(
    polygons: NDArray[np.object_],
    tags: list[BuildingTags],
    city: City,
    options: CityOptions,
    counts: Counter[str],
    remarks: list[str],
) -> list[BuildingTags]:
    """Heights from the polygons' own third coordinate, where the ground beneath is known."""
    known = [tag.z_m for tag in tags if tag.z_m is not None and tag.height_m in (None, tag.z_m)]
    asked = options.height_field is not None and options.height_field.lower().startswith("z")
    over_terrain = options.terrain not in (None, "none")
    if not known or not (asked or all(tag.height_m is None for tag in tags)):
        return tags
    if not over_terrain:
        if not asked:
            remarks.append(
                f"the polygons have a third coordinate from {min(known):g} to {max(known):g} m, "
                "which is not used: give `terrain` if it is the roofs' height above sea level, or "
                "`height_field` z if it is above ground"
            )
        return tags
    found = []
    for polygon, tag in zip(polygons, tags, strict=True):
        if tag.z_m is not None and tag.height_m in (None, tag.z_m):
            above = tag.z_m - city.ground_at(polygon.centroid.x, polygon.centroid.y)
            counts["heights from the third coordinate minus the terrain"] += above > 0
            tag = replace(tag, height_m=above if 0 < above <= 1000 else None)
        found.append(tag)
    return found


def above_ground(
    polygons: NDArray[np.object_],
    tags: list[BuildingTags],
    city: City,
    terrain: str | None,
    counts: Counter[str],
) -> list[BuildingTags]:
    """Heights less the ground beneath, where they can only be those of roofs above the sea.

    Raises:
        InputError: they are, and no terrain is given; or they are in another unit than metres.
    """
    given = np.array([t.height_m for t in tags if t.height_m is not None and not t.from_levels])
    beyond = sum(t.is_beyond for t in tags)
    if beyond > 1 and beyond >= len(given):
        raise InputError(
            f"{beyond} of {len(tags)} buildings are given as higher than 1000 m; name the column "
            "with its unit, e.g. `height_field=height:cm`, or subtract the ground's height first"
        )
    if terrain == "none" or len(given) < _SEVERAL or given.min() < _TALL_M:
        return tags
    if np.ptp(given) > given.min():  # towers differ by more
        return tags
    if terrain is None:
        raise InputError(
            f"every building is {given.min():g} to {given.max():g} m high, so these seem to be "
            "heights above sea level; give `terrain` (a file of the ground's height, or its height "
            "in metres where it is level), or 'none' if they are above ground"
        )
    found = []
    for polygon, tag in zip(polygons, tags, strict=True):
        if tag.height_m is not None and not tag.from_levels:
            above = tag.height_m - city.ground_at(polygon.centroid.x, polygon.centroid.y)
            counts["heights above sea level, minus the terrain"] += above > 0
            tag = replace(tag, height_m=above if above > 0 else None)
        found.append(tag)
    return found


def prisms(
    polygons: NDArray[np.object_],
    tags: list[BuildingTags],
    default_height_m: float,
    counts: Counter[str],
) -> tuple[Building, ...]:
    shapely = require("shapely", "geo")
    found = []
    for polygon, tag in zip(
        shapely.orient_polygons(shapely.remove_repeated_points(polygons)), tags, strict=True
    ):
        height, base = tag.height_m, tag.base_m
        counts["heights from levels"] += tag.from_levels
        counts["heights or levels not understood"] += tag.misread
        if height is None:
            height = base + default_height_m
            counts[f"without a height, taken as {default_height_m:g} m"] += 1
        if base >= height:
            base = 0.0
            counts["undersides above the top, taken as the ground"] += 1
        rings = [np.array(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
        found.append(
            Building(
                footprint_m=rings[0],
                height_m=float(height),
                base_m=float(base),
                holes_m=tuple(rings[1:]),
                material=tag.material,
            )
        )
    return tuple(found)


def rasterised(buildings: Sequence[Building], grid: Grid) -> NDArray[np.float32]:
    """``[row, col]`` height of the highest building over each cell's centre, 0 where there is
    none."""
    features = require("rasterio.features", "geo")
    rasterio = require("rasterio", "geo")
    shapely = require("shapely", "geo")
    if not buildings:
        return np.zeros(grid.shape, dtype=np.float32)
    west, _, _, north = grid.bounds_m
    lowest_first = sorted(buildings, key=lambda b: b.height_m)
    height = features.rasterize(
        ((shapely.Polygon(b.footprint_m, b.holes_m), b.height_m) for b in lowest_first),
        out_shape=grid.shape,
        transform=rasterio.Affine(grid.spacing_m, 0.0, west, 0.0, -grid.spacing_m, north),
        dtype="float32",
    )
    return np.ascontiguousarray(height[::-1], dtype=np.float32)
