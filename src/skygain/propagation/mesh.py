"""Triangles for the ray tracer: prisms from building polygons, boxes from a height raster, and the
ground beneath.

All buildings of a city become one mesh. Within a building the vertices are shared and the triangles
are wound outwards, because the ray tracer finds its diffracting edges as pairs of triangles that
share one. Vertices are not shared between buildings, so that two buildings that touch keep their
own edges.
"""

from __future__ import annotations

__all__ = [
    "Mesh",
    "buildings_of_raster",
    "city_buildings",
    "clear_of_plane",
    "ground_mesh",
    "prism_mesh",
    "risen",
]

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.city import Building, City
from skygain.ground.errors import require

SINK_M = 0.1
"""how far the walls of a building on the ground go below it, so that no ray slips through the
seam"""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh."""

    vertices_m: NDArray[np.float64]
    """``[vertex, (x, y, z)]``"""
    faces: NDArray[np.int64]
    """``[triangle, 3]`` vertex numbers, counter-clockwise seen from outside"""

    @property
    def area_m2(self) -> float:
        """Total area of the triangles."""
        a, b, c = (self.vertices_m[self.faces[:, i]] for i in range(3))
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2)

    @staticmethod
    def joined(parts: Iterable[Mesh]) -> Mesh:
        """One mesh of several; vertices are not merged."""
        vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
        for part in parts:
            vertices.append(part.vertices_m)
            faces.append(part.faces + count)
            count += len(part.vertices_m)
        return Mesh(np.concatenate(vertices), np.concatenate(faces))


def city_buildings(city: City) -> tuple[Building, ...]:
    """The city's polygons, or boxes made from its height raster when it has none (see
    `buildings_of_raster`)."""
    return city.buildings or buildings_of_raster(city)


def risen(city: City) -> tuple[Building, ...]:
    """The city's buildings over relief, heights above its lowest ground.

    A building with an outline stands on the mean of the ground at its corners; boxes of a raster
    get the roofs of their cells. Walls reach down to the lowest ground.
    """
    lowest = float(city.ground_m.min())
    if not city.buildings:
        above = np.where(city.height_m > 0, city.surface_m - lowest, 0.0)
        return buildings_of_raster(replace(city, height_m=above))
    found = []
    for b in city.buildings:
        street = np.mean([city.ground_at(x, y) for x, y in b.footprint_m.tolist()]) - lowest
        base = b.base_m + street if b.base_m > 0 else b.base_m
        found.append(replace(b, height_m=float(b.height_m + street), base_m=float(base)))
    return tuple(found)


def clear_of_plane(
    buildings: Iterable[Building], altitude_m: float, clearance_m: float
) -> tuple[Building, ...]:
    """The buildings with each horizontal edge nearer than ``clearance_m`` to the plane at
    ``altitude_m`` moved away to that distance.

    A roof that reaches the plane is raised and one below it is lowered, so that no cell changes
    between indoors and outdoors.
    """

    def moved(z: float) -> float:
        if abs(z - altitude_m) >= clearance_m or z <= 0:
            return z
        return altitude_m + clearance_m if z >= altitude_m else max(altitude_m - clearance_m, 0.0)

    return tuple(replace(b, height_m=moved(b.height_m), base_m=moved(b.base_m)) for b in buildings)


def ground_mesh(city: City, margin_m: float) -> Mesh:
    """A flat square at height 0 that reaches ``margin_m`` beyond the map on every side."""
    west, south, east, north = city.grid.bounds_m
    x0, y0, x1, y1 = west - margin_m, south - margin_m, east + margin_m, north + margin_m
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def prism_mesh(building: Building) -> Mesh:
    """Walls and roof of one building; an underside too if its base is above the ground.

    A building on the ground has no floor (its lower edges must not diffract), and its walls end
    `SINK_M` below the ground. An outline that crosses itself is repaired first; one without area
    gives an empty mesh.
    """
    shapely = require("shapely", "raytrace")
    outline = (
        shapely.Polygon(building.footprint_m, building.holes_m)
        if len(building.footprint_m) >= 3
        else shapely.Polygon()
    )
    if not outline.is_valid:
        outline = shapely.make_valid(outline)
    if building.height_m <= building.base_m:
        return Mesh.joined([])
    polygons = [p for p in shapely.get_parts(outline) if p.geom_type == "Polygon" and p.area > 0]
    return Mesh.joined(_extruded(p, building.base_m, building.height_m) for p in polygons)


def _extruded(polygon: Any, base_m: float, height_m: float) -> Mesh:
    shapely = require("shapely", "raytrace")
    polygon = shapely.remove_repeated_points(shapely.orient_polygons(polygon), 1e-3)
    rings = [np.asarray(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
    plan = np.concatenate(rings)
    count = len(plan)
    floating = base_m > 0
    bottom = base_m if floating else -SINK_M
    vertices = np.concatenate(
        [np.c_[plan, np.full(count, bottom)], np.c_[plan, np.full(count, height_m)]]
    )

    number = {(float(x), float(y)): i for i, (x, y) in enumerate(plan)}
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    corners = [np.asarray(t.exterior.coords)[:3] for t in shapely.orient_polygons(triangles)]
    roof = np.array(
        [[number[float(x), float(y)] for x, y in c] for c in corners], dtype=np.int64
    ).reshape(-1, 3)

    walls, first = [], 0
    for ring in rings:
        here = first + np.arange(len(ring))
        there = first + (np.arange(len(ring)) + 1) % len(ring)
        walls += [np.c_[here, there, there + count], np.c_[here, there + count, here + count]]
        first += len(ring)
    faces = [*walls, roof + count]
    if floating:
        faces.append(roof[:, ::-1])
    return Mesh(vertices, np.concatenate(faces))


def buildings_of_raster(city: City, step_m: float = 0.5) -> tuple[Building, ...]:
    """Boxes that reproduce a height raster: neighbouring cells of equal height are merged into
    rectangles.

    Heights are rounded to ``step_m`` first, so that the noise of a measured raster does not become
    a forest of towers; what rounds to 0 is ground. Rectangles are grown east, then north, from the
    south-west corner of what is left: not the smallest number of boxes, but a good one, and always
    the same.
    """
    level = np.rint(city.height_m / step_m).astype(np.int64)
    left = level > 0
    half = city.grid.spacing_m / 2
    boxes = []
    for row, col in np.argwhere(left):
        if not left[row, col]:
            continue
        here = level[row, col]
        same = left & (level == here)
        width = int(np.argmin(np.append(same[row, col:], False)))
        full = same[row:, col : col + width].all(axis=1)
        depth = int(np.argmin(np.append(full, False)))
        left[row : row + depth, col : col + width] = False
        x0, y0 = city.grid.xy_m((row, col)) - half
        x1, y1 = city.grid.xy_m((row + depth - 1, col + width - 1)) + half
        boxes.append(
            Building(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), float(here * step_m))
        )
    return tuple(boxes)
