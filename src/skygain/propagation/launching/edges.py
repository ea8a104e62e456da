"""Where rays diffract: the convex corners and the upper and lower edges of the walls.

What another building covers, because it touches, is no edge: the wall of a terraced house ends
at its neighbour, and a roof that continues at the same height has no rim there.
"""

from __future__ import annotations

__all__ = ["Edges", "find_edges"]

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.city import Building

_PROBE_M = 0.05
"""how far beside an edge its surroundings are looked at"""
_FLAT = float(np.sin(np.radians(0.5)))
"""a corner that turns by less than this is no edge"""

_Other = tuple[float, float, NDArray[np.float64]]
"""base, height and outline of a building nearby"""


@dataclass(frozen=True)
class Edges:
    """Straight edges of prisms."""

    origin_m: NDArray[np.float64]
    """``[edge, (x, y, z)]`` one end"""
    along: NDArray[np.float64]
    """``[edge, (x, y, z)]`` unit vector to the other end"""
    length_m: NDArray[np.float64]
    """``[edge]``"""
    normals: NDArray[np.float64]
    """``[edge, 2, (x, y, z)]`` outward normals of its two faces"""
    material: NDArray[np.int64]
    """``[edge]`` number of the material"""


def find_edges(
    buildings: Sequence[Building],
    outlines: Sequence[NDArray[np.float64]],
    materials: Sequence[int],
) -> Edges:
    """The edges of prisms whose ``outlines`` are ``[segment, (x0, y0, x1, y1, normal x, y)]``."""
    boxes = np.array([_box(outline) for outline in outlines], dtype=float).reshape(-1, 4)
    rows: list[tuple[float, ...]] = []
    for i, (building, outline) in enumerate(zip(buildings, outlines, strict=True)):
        if not len(outline):
            continue
        others = [
            (max(buildings[j].base_m, 0.0), buildings[j].height_m, outlines[j])
            for j in _near(boxes, i)
        ]
        base, top, kind = max(building.base_m, 0.0), building.height_m, materials[i]
        starts = {(round(s[0], 6), round(s[1], 6)): s for s in outline}
        for segment in outline:
            after = starts.get((round(segment[2], 6), round(segment[3], 6)))
            if after is not None and _turns_left(segment, after):
                low = _corner_low(segment, after, base, others)
                if low < top - _PROBE_M:
                    faces = (*segment[4:6], 0, *after[4:6], 0)
                    rows.append((*segment[2:4], low, 0, 0, 1, top - low, *faces, kind))
            for level, up in [(top, 1.0)] + ([(base, -1.0)] if base > 0 else []):
                ux, uy = -segment[5], segment[4]
                for a, b in _free_parts(segment, level, up, others):
                    x, y = segment[0] + a * ux, segment[1] + a * uy
                    faces = (*segment[4:6], 0, 0, 0, up)
                    rows.append((x, y, level, ux, uy, 0, b - a, *faces, kind))
    table = np.array(rows, dtype=float).reshape(-1, 14)
    return Edges(
        origin_m=np.ascontiguousarray(table[:, :3]),
        along=np.ascontiguousarray(table[:, 3:6]),
        length_m=np.ascontiguousarray(table[:, 6]),
        normals=np.ascontiguousarray(table[:, 7:13]).reshape(-1, 2, 3),
        material=table[:, 13].astype(np.int64),
    )


def _box(outline: NDArray[np.float64]) -> tuple[float, float, float, float]:
    if not len(outline):
        return (np.inf, np.inf, -np.inf, -np.inf)
    x, y = outline[:, [0, 2]], outline[:, [1, 3]]
    return (x.min(), y.min(), x.max(), y.max())


def _near(boxes: NDArray[np.float64], i: int) -> list[int]:
    """Buildings whose boxes come within two probes of that of building ``i``."""
    gap = 2 * _PROBE_M
    west, south, east, north = boxes[i]
    touch = (boxes[:, 0] <= east + gap) & (boxes[:, 2] >= west - gap)
    touch &= (boxes[:, 1] <= north + gap) & (boxes[:, 3] >= south - gap)
    return [int(j) for j in np.flatnonzero(touch) if j != i]


def _turns_left(segment: NDArray[np.float64], after: NDArray[np.float64]) -> bool:
    """Whether the corner between two consecutive segments is convex (the building is left)."""
    return bool(segment[4] * after[5] - segment[5] * after[4] > _FLAT)


def _covers(outline: NDArray[np.float64], x: float, y: float) -> bool:
    x0, y0, x1, y1 = outline[:, :4].T
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    crosses = ((y0 <= y) != (y1 <= y)) & (x < x0 + (y - y0) * (x1 - x0) / rise)
    return bool(crosses.sum() % 2)


def _corner_low(
    segment: NDArray[np.float64],
    after: NDArray[np.float64],
    base: float,
    others: Sequence[_Other],
) -> float:
    """Where the free part of a vertical corner begins: above what covers one of its faces."""
    corner, n0, nn = segment[2:4], segment[4:6], after[4:6]
    back, on = np.array([n0[1], -n0[0]]), np.array([-nn[1], nn[0]])
    probes = (
        corner + _PROBE_M * (n0 + back),
        corner + _PROBE_M * (nn + on),
        corner + _PROBE_M * (n0 + nn),
    )
    low = base
    for bottom, top, outline in others:
        if bottom <= low and top > low and any(_covers(outline, *p) for p in probes):
            low = top
    return low


def _free_parts(
    segment: NDArray[np.float64], level: float, up: float, others: Sequence[_Other]
) -> list[tuple[float, float]]:
    """The parts of a horizontal edge, as distances from its start, that nothing covers."""
    length = float(np.hypot(segment[2] - segment[0], segment[3] - segment[1]))
    normal, along = segment[4:6], np.array([-segment[5], segment[4]])
    cuts, probes = [0.0, length], []
    for side, height in ((1.0, level - up * _PROBE_M), (-1.0, level + up * _PROBE_M)):
        shift = side * _PROBE_M * normal
        blockers = [outline for bottom, top, outline in others if bottom < height < top]
        probes += [(shift, outline) for outline in blockers]
        for outline in blockers:
            cuts += _crossings(segment[:2] + shift, along, length, outline)
    if not probes:
        return [(0.0, length)]
    cuts = sorted(cuts)
    parts: list[tuple[float, float]] = []
    for a, b in itertools.pairwise(cuts):
        middle = segment[:2] + (a + b) / 2 * along
        if b - a < 1e-3 or any(_covers(o, *(middle + shift)) for shift, o in probes):
            continue
        if parts and a - parts[-1][1] < 1e-3:
            parts[-1] = (parts[-1][0], b)
        else:
            parts.append((a, b))
    return parts


def _crossings(
    start: NDArray[np.float64],
    along: NDArray[np.float64],
    length: float,
    outline: NDArray[np.float64],
) -> list[float]:
    """Where the line from ``start`` crosses an outline."""
    offset = outline[:, :2] - start
    step = outline[:, 2:4] - outline[:, :2]
    cross = along[0] * step[:, 1] - along[1] * step[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset[:, 0] * step[:, 1] - offset[:, 1] * step[:, 0]) / cross
        u = (offset[:, 0] * along[1] - offset[:, 1] * along[0]) / cross
    inside = (u >= -1e-9) & (u <= 1 + 1e-9) & (t > 0) & (t < length)
    return [float(v) for v in t[inside]]
