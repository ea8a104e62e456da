"""What rays meet: walls, edges and an index of walls by cell, made from the buildings of a city.

Every building is a prism of any outline: courtyards, undersides and touching walls included. A
city known as a height raster becomes boxes first. Outlines that cross themselves are filled by
the even-odd rule; what has no area or no height is left out.
"""

from __future__ import annotations

__all__ = ["Geometry", "city_geometry"]

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from skygain.city import Building, City
from skygain.propagation.launching.edges import Edges, find_edges

_SHORTEST_M = 1e-3
"""corners nearer than this to each other are one"""


@dataclass(frozen=True)
class Geometry:
    """Walls, edges, and which walls touch which cell of the index."""

    walls: NDArray[np.float64]
    """``[wall, (x0, y0, x1, y1, normal x, normal y, base, height)]``, normals point outwards"""
    owner: NDArray[np.int64]
    """``[wall, (building, material)]``"""
    edges: Edges
    """where rays diffract"""
    first: NDArray[np.int64]
    """``[cell + 1]`` where the walls of each index cell begin in ``listed``"""
    listed: NDArray[np.int64]
    """walls, cell by cell"""
    tallest_m: NDArray[np.float64]
    """``[row, col]`` greatest height of the walls of an index cell, 0 where there is none"""
    frame: NDArray[np.float64]
    """south-west corner of the index (x, y), side of its cells, and the cells by which it is
    larger than the map in the south and in the west"""
    ground_m: NDArray[np.float64]
    """``[row, col]`` height of the ground over its lowest place, by index cell; empty where it is
    level"""


def city_geometry(city: City, buildings: Sequence[Building], materials: Sequence[int]) -> Geometry:
    """The walls and edges of ``buildings`` (``materials`` has a number for each) over the map.

    Over relief all heights are above the lowest ground (`skygain.propagation.mesh.risen`).
    """
    walls, owner = [], []
    outlines = [_outline(b) for b in buildings]
    for number, (building, segments) in enumerate(zip(buildings, outlines, strict=True)):
        if len(segments):
            heights = np.broadcast_to((building.base_m, building.height_m), (len(segments), 2))
            walls.append(np.c_[segments, heights])
            owner += [(number, materials[number])] * len(segments)
    wall = np.concatenate(walls) if walls else np.zeros((0, 8))
    frame, shape = _frame(city, wall)
    first, listed = _index(wall, frame, shape[0], shape[1])
    tallest = np.zeros(shape)
    _fill_tallest(wall, first, listed, tallest)
    return Geometry(
        walls=wall,
        owner=np.array(owner, dtype=np.int64).reshape(-1, 2),
        edges=find_edges(buildings, outlines, materials),
        first=first,
        listed=listed,
        tallest_m=tallest,
        frame=frame,
        ground_m=_ground(city, frame, shape),
    )


def _frame(city: City, wall: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """The index: the map's own cells, and as many more around it as the walls need."""
    west, south, east, north = city.grid.bounds_m
    side = city.grid.spacing_m
    rows, cols = city.grid.shape
    more = [0, 0, 0, 0]
    if len(wall):
        x, y = wall[:, [0, 2]], wall[:, [1, 3]]
        beyond = np.array([west - x.min(), south - y.min(), x.max() - east, y.max() - north])
        more = [int(n) for n in np.maximum(np.ceil(beyond / side + 1e-6), 0)]
    frame = np.array([west - more[0] * side, south - more[1] * side, side, more[1], more[0]])
    return frame, (rows + more[1] + more[3], cols + more[0] + more[2])


def _ground(city: City, frame: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """The relief over the index; beyond the map that of the nearest cell."""
    if city.is_level:
        return np.zeros((0, 0))
    rows, cols = city.grid.shape
    row = np.clip(np.arange(shape[0]) - int(frame[3]), 0, rows - 1)
    col = np.clip(np.arange(shape[1]) - int(frame[4]), 0, cols - 1)
    return (city.ground_m - city.ground_m.min()).astype(float)[np.ix_(row, col)]


def _outline(building: Building) -> NDArray[np.float64]:
    """``[segment, (x0, y0, x1, y1, normal x, normal y)]`` with the building on the left."""
    if not building.height_m > max(building.base_m, 0.0):
        return np.zeros((0, 6))
    rings = [_cleaned(ring) for ring in (building.footprint_m, *building.holes_m)]
    rings = [ring for ring in rings if len(ring) >= 3]
    if not rings:
        return np.zeros((0, 6))
    parts = [np.c_[ring, np.roll(ring, -1, axis=0)] for ring in rings]
    segments = np.concatenate(parts)
    crossing = _crossed(segments)
    if len(crossing) or len(rings) > 1:
        segments = _split(segments, crossing)
        segments = _boundary(segments, rings)
    elif _area(rings[0]) < 0:
        segments = segments[::-1][:, [2, 3, 0, 1]]
    step = segments[:, 2:] - segments[:, :2]
    length = np.hypot(step[:, 0], step[:, 1])
    segments, step, length = (a[length > _SHORTEST_M] for a in (segments, step, length))
    return np.c_[segments, step[:, 1] / length, -step[:, 0] / length]


def _cleaned(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """The ring without repeated corners; empty if it has no area."""
    ring = np.asarray(ring, dtype=float).reshape(-1, 2)
    ring = ring[np.isfinite(ring).all(axis=1)]
    keep = np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) > _SHORTEST_M
    ring = ring[keep]
    if len(ring) < 3:
        return np.zeros((0, 2))
    spread = np.ptp(ring, axis=0).max()
    flat = np.linalg.svd(ring - ring.mean(axis=0), compute_uv=False)[-1] < _SHORTEST_M * spread / 10
    return np.zeros((0, 2)) if flat else ring


def _area(ring: NDArray[np.float64]) -> float:
    x, y = (ring - ring[0]).T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


def _crossed(segments: NDArray[np.float64]) -> list[tuple[int, int, float, float]]:
    """(i, j, place on i, place on j) of every pair of segments that cross inside both."""
    found = []
    start, step = segments[:, :2], segments[:, 2:] - segments[:, :2]
    for i in range(len(segments) - 1):
        other = np.arange(i + 1, len(segments))
        cross = step[i, 0] * step[other, 1] - step[i, 1] * step[other, 0]
        offset = start[other] - start[i]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (offset[:, 0] * step[other, 1] - offset[:, 1] * step[other, 0]) / cross
            u = (offset[:, 0] * step[i, 1] - offset[:, 1] * step[i, 0]) / cross
        inside = (t > 1e-9) & (t < 1 - 1e-9) & (u > 1e-9) & (u < 1 - 1e-9)
        hits = zip(other[inside], t[inside], u[inside], strict=True)
        found += [(i, int(j), float(a), float(b)) for j, a, b in hits]
    return found


def _split(
    segments: NDArray[np.float64], crossing: list[tuple[int, int, float, float]]
) -> NDArray[np.float64]:
    """The segments cut at their crossings."""
    cuts: dict[int, list[float]] = {}
    for i, j, t, u in crossing:
        cuts.setdefault(i, []).append(t)
        cuts.setdefault(j, []).append(u)
    parts = []
    for i, segment in enumerate(segments):
        places = np.array([0.0, *sorted(cuts.get(i, [])), 1.0])[:, None]
        points = segment[:2] + places * (segment[2:] - segment[:2])
        parts.append(np.c_[points[:-1], points[1:]])
    return np.concatenate(parts)


def _boundary(
    segments: NDArray[np.float64], rings: list[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """The segments that have the building on one side only, turned to have it on the left."""
    middle = (segments[:, :2] + segments[:, 2:]) / 2
    step = segments[:, 2:] - segments[:, :2]
    length = np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-12)
    left = np.c_[-step[:, 1], step[:, 0]] / length[:, None] * _SHORTEST_M
    on_left, on_right = _inside(middle + left, rings), _inside(middle - left, rings)
    turned = segments[:, [2, 3, 0, 1]]
    return np.where(on_left[:, None], segments, turned)[on_left != on_right]


def _inside(points: NDArray[np.float64], rings: list[NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Even-odd rule for each point over all rings."""
    odd = np.zeros(len(points), dtype=bool)
    x, y = points[:, :1], points[:, 1:]
    for ring in rings:
        (x0, y0), (x1, y1) = ring.T, np.roll(ring, -1, axis=0).T
        rise = np.where(y1 == y0, 1.0, y1 - y0)
        crosses = ((y0 <= y) != (y1 <= y)) & (x < x0 + (y - y0) * (x1 - x0) / rise)
        odd ^= crosses.sum(axis=1) % 2 == 1
    return odd


@numba.njit(cache=True, nogil=True)
def _touches(wall: NDArray[np.float64], west: float, south: float, side: float) -> bool:
    """Whether a wall touches a square cell, by the axis that could separate them."""
    x0, y0, x1, y1 = wall[0] - west, wall[1] - south, wall[2] - west, wall[3] - south
    slack = 1e-6
    if min(x0, x1) > side + slack or max(x0, x1) < -slack:
        return False
    if min(y0, y1) > side + slack or max(y0, y1) < -slack:
        return False
    nx, ny = wall[4], wall[5]
    half = 0.5 * side
    return abs(nx * (x0 - half) + ny * (y0 - half)) <= half * (abs(nx) + abs(ny)) + slack


@numba.njit(cache=True, nogil=True)
def _index(
    walls: NDArray[np.float64], frame: NDArray[np.float64], rows: int, cols: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """``first`` and ``listed`` of `Geometry`."""
    west, south, side = frame[0], frame[1], frame[2]
    counts = np.zeros(rows * cols + 1, dtype=np.int64)
    listed = np.zeros(0, dtype=np.int64)
    for fill in range(2):
        if fill == 1:
            for c in range(rows * cols):
                counts[c + 1] += counts[c]
            listed = np.empty(counts[rows * cols], dtype=np.int64)
            place = counts[:-1].copy()
        for w in range(len(walls)):
            wall = walls[w]
            low_c = max(int((min(wall[0], wall[2]) - 1e-5 - west) / side), 0)
            high_c = min(int((max(wall[0], wall[2]) + 1e-5 - west) / side), cols - 1)
            low_r = max(int((min(wall[1], wall[3]) - 1e-5 - south) / side), 0)
            high_r = min(int((max(wall[1], wall[3]) + 1e-5 - south) / side), rows - 1)
            for r in range(low_r, high_r + 1):
                for c in range(low_c, high_c + 1):
                    if _touches(wall, west + c * side, south + r * side, side):
                        cell = r * cols + c
                        if fill == 0:
                            counts[cell + 1] += 1
                        else:
                            listed[place[cell]] = w
                            place[cell] += 1
    return counts, listed


@numba.njit(cache=True, nogil=True)
def _fill_tallest(
    walls: NDArray[np.float64],
    first: NDArray[np.int64],
    listed: NDArray[np.int64],
    tallest: NDArray[np.float64],
) -> None:
    rows, cols = tallest.shape
    for r in range(rows):
        for c in range(cols):
            for k in range(first[r * cols + c], first[r * cols + c + 1]):
                tallest[r, c] = max(tallest[r, c], walls[listed[k], 7])
