"""Where a UAV may be in continuous space: the area less all that has to be kept clear of.

Distances are kept between points, not between cells: obstacles grow by the clearance, the area
shrinks by it, and a leg is legal when the whole of it lies in what is left.
"""

from __future__ import annotations

__all__ = ["Airspace", "Ways", "obstacles", "reachable", "straightened", "way_between"]

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from skygain.city import City
from skygain.flight.ways import steps_between
from skygain.grid import Grid
from skygain.ground.errors import require

FOLLOWING_M = 1.0
"""a leg over sloping ground stays this near to the altitude asked for"""
_SEGMENTS = 8
_SAMPLE_CELLS = 0.1
"""a vehicle reads every tenth of a cell"""
_LONGEST = 80
"""points that one leg replaces at most"""
_ROUNDING_M = 0.005
"""what coordinates lose in the vehicles' files"""


def obstacles(city: City, altitude_m: float, clearance_m: float, level_m: float | None) -> list:
    """Polygons, in the city's metres, that a flight has to keep ``clearance_m`` away from.

    Args:
        city: with its buildings and its ground.
        altitude_m: of the flight above ground.
        clearance_m: least distance, upwards too: what ends less than that below the flight counts.
        level_m: height of a flight that keeps a level, in the zero of the city's ground; ``None``
            where it follows the ground.
    """
    shapely = require("shapely", "geo")
    found: list[Any] = []
    slack = 0.0 if city.is_level or level_m is not None else FOLLOWING_M
    reach = max(1, math.ceil(clearance_m / city.grid.spacing_m))
    disk = np.hypot(*np.ogrid[-reach : reach + 1, -reach : reach + 1]) <= reach
    if level_m is None:
        roof, limit = city.height_m, altitude_m - clearance_m - slack
        if not city.is_level:
            # the ground nearby may rise faster than a leg does
            near = ndimage.maximum_filter(np.asarray(city.ground_m), footprint=disk, mode="nearest")
            steep = near - city.ground_m > max(limit, 0.0)
            found += _squares(steep, city.grid)
    else:
        roof, limit = city.surface_m, level_m - clearance_m
        if not city.is_level:
            found += _squares(np.asarray(city.ground_m) > limit, city.grid)
    for building in city.buildings:
        top = building.height_m
        if level_m is not None:
            x, y = building.footprint_m.T
            top += max(city.ground_at(a, b) for a, b in zip(x, y, strict=True))
        if top > limit:
            polygon = shapely.Polygon(building.footprint_m, list(building.holes_m))
            found.append(polygon if polygon.is_valid else polygon.buffer(0))
    if not city.buildings:
        found += _squares(np.asarray(roof) > limit, city.grid)
    return [one for one in found if not one.is_empty]


def _squares(mask: NDArray[np.bool_], grid: Grid) -> list:
    """The cells of ``mask`` as polygons."""
    if not mask.any():
        return []
    features, rasterio = require("rasterio.features", "geo"), require("rasterio", "geo")
    shapely = require("shapely", "geo")
    west, south, _, _ = grid.bounds_m
    place = rasterio.Affine(grid.spacing_m, 0.0, west, 0.0, grid.spacing_m, south)
    shapes = features.shapes(mask.astype(np.uint8), mask=mask, transform=place)
    return [shapely.geometry.shape(one) for one, _ in shapes]


@dataclass(frozen=True, eq=False)
class Airspace:
    """Where legs may lie, in the metres of a grid."""

    grid: Grid
    """the map"""
    free: Any
    """a Shapely geometry: the centre of a UAV stays inside"""

    @classmethod
    def clear_of(cls, grid: Grid, area: Any, solid: Sequence[Any], clearance_m: float) -> Airspace:
        """What is left of ``area`` at least ``clearance_m`` from its edge and from ``solid``."""
        shapely = require("shapely", "geo")
        # an arc is drawn by chords: a wider buffer keeps them outside the true distance
        wide = (clearance_m + _ROUNDING_M) / math.cos(math.pi / (4 * _SEGMENTS))
        free = area.buffer(-wide, quad_segs=_SEGMENTS)
        if solid:
            kept = shapely.union_all(np.array(solid)).buffer(wide, quad_segs=_SEGMENTS)
            free = free.difference(kept)
        free = shapely.set_precision(free, 1e-6) if not free.is_valid else free
        shapely.prepare(free)
        return cls(grid, free)

    def clear(self, points_m: NDArray[np.float64]) -> bool:
        """Whether the whole polyline ``points_m[n, (x, y)]`` is clear."""
        shapely = require("shapely", "geo")
        line = shapely.Point(points_m[0]) if len(points_m) == 1 else shapely.LineString(points_m)
        return bool(self.free.covers(line))

    def clear_each(self, start_m: NDArray, end_m: NDArray) -> NDArray[np.bool_]:
        """``[n]`` whether each leg from ``start_m[n, (x, y)]`` to ``end_m[n, (x, y)]`` is clear."""
        shapely = require("shapely", "geo")
        legs = shapely.linestrings(np.stack([start_m, end_m], axis=1))
        return np.asarray(shapely.covers(self.free, legs))

    def clear_corners(self, points_m: NDArray[np.float64], room_m: float) -> NDArray[np.bool_]:
        """``[n]`` whether each corner of a clear polyline may be cut by up to ``room_m``, or half
        of its shorter leg; true for both ends."""
        shapely = require("shapely", "geo")
        points = np.asarray(points_m, dtype=float)
        clear = np.ones(len(points), dtype=bool)
        if len(points) < 3:
            return clear
        step = np.diff(points, axis=0)
        length = np.hypot(*step.T)
        unit = step / np.maximum(length, 1e-9)[:, None]
        room = np.minimum(room_m, np.minimum(length[:-1], length[1:]) / 2)[:, None]
        corner = points[1:-1]
        rings = np.stack([corner - room * unit[:-1], corner, corner + room * unit[1:]], axis=1)
        # what is flown lies between the legs and the chord, and both legs are clear
        clear[1:-1] = shapely.covers(self.free, shapely.convex_hull(shapely.linestrings(rings)))
        return clear

    def cells_along(self, points_m: NDArray[np.float64]) -> NDArray[np.int64] | None:
        """``[k, (row, col)]`` cells under the polyline ``points_m[n, (x, y)]``, each a neighbour of
        the one before; ``None`` where it leaves the flyable cells."""
        cells = _under(self.grid, points_m)
        flyable = self.flyable
        if not (self.grid.contains(cells).all() and flyable[cells[:, 0], cells[:, 1]].all()):
            return None
        askew = np.flatnonzero(np.abs(np.diff(cells, axis=0)).sum(axis=1) == 2)
        between = np.stack([cells[askew, 0], cells[askew + 1, 1]], axis=1)
        other = np.stack([cells[askew + 1, 0], cells[askew, 1]], axis=1)
        blocked = ~flyable[between[:, 0], between[:, 1]]
        between[blocked] = other[blocked]
        if not flyable[between[:, 0], between[:, 1]].all():
            return None
        return np.insert(cells, askew + 1, between, axis=0)

    def cells_read(self, points_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """``[k, (row, col)]`` flyable cells that a vehicle reads on its way along a clear polyline,
        in their order."""
        found = self.cells_along(points_m)
        if found is None:
            found = _under(self.grid, points_m)
            found = found[self.grid.contains(found)]
            found = found[self.flyable[found[:, 0], found[:, 1]]]
        return found

    @cached_property
    def flyable(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells whose centre is clear, and from which every move to a neighbour that
        is flyable as well is clear on its whole length."""
        shapely = require("shapely", "geo")
        grid = self.grid
        centre = grid.xy_m(grid.cells)
        inside = np.asarray(shapely.covers(self.free, shapely.points(centre))).reshape(grid.shape)
        margin = np.full(grid.shape, np.inf)
        bad = []
        for shift in ((0, 1), (1, 0)):
            pairs = (
                inside[: grid.shape[0] - shift[0], : grid.shape[1] - shift[1]]
                & inside[shift[0] :, shift[1] :]
            )
            first = np.argwhere(pairs)
            second = first + shift
            if len(first):
                clear = self.clear_each(grid.xy_m(first), grid.xy_m(second))
                bad.append(np.stack([first[~clear], second[~clear]], axis=1))
        for pair in np.concatenate(bad) if bad else ():
            for cell in map(tuple, pair):
                if not np.isfinite(margin[cell]):
                    margin[cell] = self.free.boundary.distance(shapely.Point(grid.xy_m(cell)))
            a, b = map(tuple, pair)
            inside[a if margin[a] <= margin[b] else b] = False
        inside.flags.writeable = False
        return inside


def _under(grid: Grid, points_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """``[k, (row, col)]`` cells read on the way along a polyline, in their order."""
    points = (np.asarray(points_m, dtype=float) - np.asarray(grid.origin_m)) / grid.spacing_m
    parts = [points[:1]]
    for start, end in pairwise(points):
        n = max(1, math.ceil(math.dist(start, end) / _SAMPLE_CELLS))
        parts.append(start + np.linspace(0.0, 1.0, n + 1)[1:, None] * (end - start))
    cells = np.rint(np.concatenate(parts)[:, ::-1]).astype(np.int64)
    return cells[np.r_[True, (np.diff(cells, axis=0) != 0).any(axis=1)]]


def straightened(
    space: Airspace, points_m: NDArray[np.float64], tolerance_m: float
) -> NDArray[np.float64]:
    """The polyline ``points_m[n, (x, y)]`` with stairs and bends left out that lie within
    ``tolerance_m`` of a clear leg over flyable cells."""
    points = np.asarray(points_m, dtype=float)
    kept, at = [0], 0
    while at < len(points) - 1:
        reach = [at + 1]
        for ahead in range(at + 2, min(len(points), at + _LONGEST)):
            if _strays(points[at : ahead + 1]) > tolerance_m:
                break
            reach.append(ahead)
        for ahead in reversed(reach):
            leg = points[[at, ahead]]
            if ahead == at + 1 or (space.clear(leg) and space.cells_along(leg) is not None):
                break
        at = ahead
        kept.append(at)
    return points[kept]


def _strays(points: NDArray[np.float64]) -> float:
    """How far a polyline lies off the leg between its ends; infinite if it goes back."""
    leg = points[-1] - points[0]
    length = float(np.hypot(*leg))
    if length < 1e-9:
        return float("inf")
    along = (points - points[0]) @ (leg / length)
    if (np.diff(along) < -1e-6).any():
        return float("inf")
    off = (points - points[0]) @ np.array([-leg[1], leg[0]]) / length
    return float(np.abs(off).max())


def reachable(flyable: NDArray[np.bool_], cell: NDArray[np.int64]) -> NDArray[np.bool_]:
    """``[row, col]`` flyable cells that moves lead to from ``cell``."""
    return np.asarray(steps_between(flyable, cell) >= 0)


@dataclass(frozen=True, eq=False)
class Ways:
    """Short clear ways from every flyable cell to one place."""

    space: Airspace
    """where legs may lie"""
    place_m: NDArray[np.float64]
    """(x, y) where all ways end"""
    distance_m: NDArray[np.float64]
    """``[row, col]`` length along cells, infinite where there is no way"""
    before: NDArray[np.int32]
    """``[row * col]`` the next cell on the way, negative at its end"""

    @classmethod
    def to(cls, space: Airspace, place_m: NDArray[np.float64], cell: NDArray[np.int64]) -> Ways:
        """The ways to ``place_m``, which is in clear sight of the flyable ``cell``."""
        grid, flyable = space.grid, space.flyable
        rows, cols, length = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            first = np.argwhere(flyable)
            second = first + np.array([dr, dc])
            keep = grid.contains(second)
            first, second = first[keep], second[keep]
            keep = flyable[second[:, 0], second[:, 1]]
            first, second = first[keep], second[keep]
            if dr and dc and len(first):  # straight moves between flyable cells are clear anyway
                keep = space.clear_each(grid.xy_m(first), grid.xy_m(second))
                first, second = first[keep], second[keep]
            rows.append(grid.flat(first))
            cols.append(grid.flat(second))
            length.append(np.full(len(first), math.hypot(dr, dc) * grid.spacing_m))
        edges = (np.concatenate(length), (np.concatenate(rows), np.concatenate(cols)))
        graph = coo_matrix(edges, shape=(grid.size, grid.size)).tocsr()
        distance, before = dijkstra(
            graph, directed=False, indices=int(grid.flat(cell)), return_predecessors=True
        )
        return cls(space, np.asarray(place_m, dtype=float), distance.reshape(grid.shape), before)

    def way(self, cell: NDArray[np.int64]) -> NDArray[np.float64]:
        """``[n, (x, y)]`` from the centre of ``cell`` to the place, straightened."""
        grid = self.space.grid
        at, cells = int(grid.flat(cell)), []
        while at >= 0:
            cells.append(divmod(at, grid.shape[1]))
            at = int(self.before[at])
        points = np.vstack([grid.xy_m(np.array(cells)), self.place_m])
        return way_between(self.space, points)


def way_between(space: Airspace, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """A clear polyline with its corners cut wherever the direct leg is clear too."""
    kept, at = [points_m[0]], 0
    while at < len(points_m) - 1:
        ahead = len(points_m) - 1
        while ahead > at + 1 and not space.clear(points_m[[at, ahead]]):
            # halve first, then walk: most ways are straight or turn once
            ahead = at + 1 + (ahead - at - 1) // 2 if ahead - at > 8 else ahead - 1
        at = ahead
        if math.dist(points_m[at], kept[-1]) > 1e-6:
            kept.append(points_m[at])
    return np.array(kept)
