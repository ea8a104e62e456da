"""Reflections before and after one diffraction at a vertical corner.

The launch writes down every corner that one of its beams passes: by which walls it came, at which
unfolded length, and which slopes are left. From each corner a fan of azimuths goes on with what
reflections remain. A vertical edge keeps the slope of a ray, so the vertical planes of the launch
carry on behind it; only the spreading and the field change.
"""

from __future__ import annotations

__all__ = ["Corners", "empty_book", "fan_out", "new_book", "strengths", "vertical_corners"]

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from skygain.propagation.launching.compiled import inner
from skygain.propagation.launching.following import (
    MOST_REFLECTIONS,
    begin,
    bend_of,
    follow,
    new_scratch,
    strength,
)
from skygain.propagation.launching.geometry import Geometry
from skygain.propagation.launching.pieces import MOST, inside
from skygain.propagation.launching.rays import signature

_BESIDE_M = 1.0
"""a corner is looked for in every cell that comes this near to it: a beam is never half as wide"""
_ROOM = 200_000
"""most arrivals at corners of one share of the work"""


@dataclass(frozen=True)
class Corners:
    """The vertical edges of a city, by cell of the index."""

    first: NDArray[np.int64]
    """``[cell + 1]`` where the corners of each index cell begin in ``listed``"""
    listed: NDArray[np.int64]
    """corners, cell by cell"""
    xy_m: NDArray[np.float64]
    """``[corner, (x, y)]``"""
    wall_ends: NDArray[np.int64]
    """``[wall, 2]`` the corners at both ends of each wall, -1 where there is none"""
    span_m: NDArray[np.float64]
    """``[corner, (low, top)]``"""
    faces: NDArray[np.float64]
    """``[corner, 2, (x, y, z)]`` normals of the faces"""
    material: NDArray[np.int64]
    """``[corner]``"""


def vertical_corners(geometry: Geometry) -> Corners:
    """The vertical edges among the geometry's."""
    edges = geometry.edges
    chosen = np.flatnonzero(edges.along[:, 2] == 1) if len(edges.along) else np.zeros(0, np.int64)
    origin = edges.origin_m[chosen]
    rows, cols = geometry.tallest_m.shape
    frame = geometry.frame
    reach = int(np.ceil(_BESIDE_M / frame[2]))
    shifts = np.linspace(-_BESIDE_M, _BESIDE_M, 2 * reach + 1)  # no cell between is left out
    cells: list[NDArray[np.int64]] = []
    for dx in shifts:
        for dy in shifts:
            col = np.floor((origin[:, 0] + dx - frame[0]) / frame[2]).astype(np.int64)
            row = np.floor((origin[:, 1] + dy - frame[1]) / frame[2]).astype(np.int64)
            cells.append(np.clip(row, 0, rows - 1) * cols + np.clip(col, 0, cols - 1))
    numbers = np.tile(np.arange(len(origin)), len(cells))
    pairs = np.unique(np.c_[np.concatenate(cells), numbers], axis=0)
    first = np.zeros(rows * cols + 1, dtype=np.int64)
    np.add.at(first, pairs[:, 0] + 1, 1)
    place = {(round(x, 5), round(y, 5)): i for i, (x, y) in enumerate(origin[:, :2].tolist())}
    ends = [
        [place.get((round(x, 5), round(y, 5)), -1) for x, y in (wall[:2], wall[2:4])]
        for wall in geometry.walls.tolist()
    ]
    return Corners(
        first=np.cumsum(first),
        listed=np.ascontiguousarray(pairs[:, 1]),
        xy_m=np.ascontiguousarray(origin[:, :2]),
        wall_ends=np.array(ends, dtype=np.int64).reshape(-1, 2),
        span_m=np.c_[origin[:, 2], origin[:, 2] + edges.length_m[chosen]],
        faces=np.ascontiguousarray(edges.normals[chosen]),
        material=edges.material[chosen],
    )


def new_book(corners: Corners) -> tuple[Any, ...]:
    """Where `follow` writes down the corners it passes."""
    return (
        True,
        corners.first,
        corners.listed,
        corners.xy_m,
        corners.wall_ends,
        np.zeros(1, dtype=np.int64),
        np.empty((_ROOM, 4), dtype=np.int64),
        np.empty((_ROOM, 6)),
        np.empty((_ROOM, MOST_REFLECTIONS, 3)),
        np.empty((_ROOM, MOST_REFLECTIONS + 1), dtype=np.int64),
        np.empty((_ROOM, MOST, 2)),
    )


def empty_book() -> tuple[Any, ...]:
    """A book in which nothing is written."""
    none = np.zeros(0, dtype=np.int64)
    return (
        False,
        none,
        none,
        np.zeros((0, 2)),
        np.zeros((0, 2), dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.zeros((0, 4), dtype=np.int64),
        np.zeros((0, 6)),
        np.zeros((0, MOST_REFLECTIONS, 3)),
        np.zeros((0, MOST_REFLECTIONS + 1), dtype=np.int64),
        np.zeros((0, MOST, 2)),
    )


@numba.njit(cache=True, nogil=True)
def strengths(book, altitude, field, pattern, table, ground):
    """|E|² at the corner of every arrival, spreading included, at the slope of one altitude."""
    count, numbers, lengths, met, kinds, _slopes = book[5:]
    found = np.zeros(count[0])
    for k in range(count[0]):
        s, z, azimuth = lengths[k, 0], lengths[k, 1], lengths[k, 5]
        found[k] = strength(
            max(s, 0.1), altitude - z, met[k], kinds[k], numbers[k, 1], field, pattern, azimuth,
            table, ground,
        )  # fmt: skip
    return found


@numba.njit(cache=True, nogil=True)
def _divided(xy, faces, fans, halvings, compared, world, fan):
    """The azimuths round a corner, outside its building: ``fan[part, (middle, width)]``.

    As in the launch an interval is halved while its borders meet different walls.
    """
    step = 2.0 * math.pi / fans
    waiting = np.empty((halvings + 2, 2))
    level = np.empty(halvings + 2, dtype=np.int64)
    parts = 0
    for number in range(fans):
        middle = (number + 0.5) * step
        if _inside_wedge(middle, faces):
            continue
        waiting[0, 0], waiting[0, 1], level[0] = number * step, step, 0
        n = 1
        while n:
            n -= 1
            low, width, deep = waiting[n, 0], waiting[n, 1], level[n]
            if deep < halvings and (
                _mark(low, xy, compared, world) != _mark(low + width, xy, compared, world)
            ):
                for half in range(2):
                    waiting[n, 0], waiting[n, 1] = low + half * 0.5 * width, 0.5 * width
                    level[n] = deep + 1
                    n += 1
                continue
            if not _inside_wedge(low + 0.5 * width, faces):
                fan[parts, 0], fan[parts, 1] = low + 0.5 * width, width
                parts += 1
    return parts


@inner
def _inside_wedge(azimuth, faces):
    x, y = math.cos(azimuth), math.sin(azimuth)
    return x * faces[0, 0] + y * faces[0, 1] <= 1e-9 and x * faces[1, 0] + y * faces[1, 1] <= 1e-9


@numba.njit(cache=True, nogil=True)
def _mark(azimuth, xy, compared, world):
    """The walls that a ray from just beside the corner meets."""
    place = np.array([xy[0] + 2e-3 * math.cos(azimuth), xy[1] + 2e-3 * math.sin(azimuth)])
    return signature(azimuth, place, compared, world)


@numba.njit(cache=True, nogil=True)
def fan_out(
    chosen,
    book,
    span,
    faces_of,
    material_of,
    fans,
    halvings,
    compared,
    most,
    field,
    pattern,
    theory,
    altitudes,
    table,
    ground,
    world,
    shape,
    closed_book,
    out,
):
    """Send a fan of azimuths from the corner of each chosen arrival, corner by corner."""
    xy = book[3]
    _count, numbers_of, lengths_of, met_of, kinds_of, slopes_of = book[5:]
    scratch = new_scratch(len(altitudes))
    place, slopes, counts, met, kinds, _entered, _entered_s, _lanes, _numbers = scratch
    plan = np.empty(4)
    fan = np.empty((fans * 2**halvings, 2))
    before, parts = -1, 0
    left = np.empty((MOST, 2))
    for arrival in chosen:
        corner, w = numbers_of[arrival, 0], numbers_of[arrival, 1]
        n, roofed = numbers_of[arrival, 2], numbers_of[arrival, 3]
        s, z = lengths_of[arrival, 0], lengths_of[arrival, 1]
        faces = faces_of[corner]
        plan[0], plan[1] = lengths_of[arrival, 3], lengths_of[arrival, 4]
        in0 = plan[0] * faces[0, 0] + plan[1] * faces[0, 1]
        in1 = plan[0] * faces[1, 0] + plan[1] * faces[1, 1]
        if s < 0.1 or (in0 >= -1e-6 and in1 >= -1e-6):
            continue
        low, top = span[corner, 0], span[corner, 1]
        m = inside(slopes_of[arrival], n, (low - z) / s, (top - z) / s, left, 0)
        if roofed == 0:
            m = inside(slopes_of[arrival], n, -(top + z) / s, -(low + z) / s, left, m)
        if m == 0:
            continue
        bend = bend_of(w, faces, plan, theory)
        physics = (field, pattern, lengths_of[arrival, 5], table, ground)
        if corner != before:
            before = corner
            parts = _divided(xy[corner], faces, fans, halvings, compared, world, fan)
        for number in range(parts):
            azimuth, width = fan[number, 0], fan[number, 1]
            ox, oy = math.cos(azimuth), math.sin(azimuth)
            plan[2], plan[3] = ox, oy
            begin(scratch, xy[corner, 0], xy[corner, 1], z, azimuth)
            place[0, 4], place[0, 6], place[0, 7] = s, 1e-3, lengths_of[arrival, 2]
            for i in range(m):
                slopes[0, i, 0], slopes[0, i, 1] = left[i, 0], left[i, 1]
            counts[0, 0], counts[0, 1], counts[0, 2] = m, w + 1, roofed
            for i in range(w):
                met[0, i, 0], met[0, i, 1], met[0, i, 2] = (
                    met_of[arrival, i, 0],
                    met_of[arrival, i, 1],
                    met_of[arrival, i, 2],
                )
            met[0, w, 0], met[0, w, 1], met[0, w, 2] = s, 0.0, 0.0
            for i in range(w + 1):
                kinds[0, i] = kinds_of[arrival, i]
            kinds[0, w + 1] = material_of[corner]
            follow(
                width, most + 1, physics, altitudes, world, scratch, shape, bend, closed_book, out
            )
