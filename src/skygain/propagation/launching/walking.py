"""Walks over the map's plan: the next wall on a line, and whether a line in space is free.

All of it is compiled and takes the arrays of `Geometry`. A wall that a line leaves through comes
a hair before one that it enters at the same place, so that touching buildings are taken in order.
"""

from __future__ import annotations

__all__ = ["FAR", "HILL", "blocker", "entry", "next_wall"]

import math

import numba
import numpy as np
from numpy.typing import NDArray

FAR = 1e30
"""stands for infinity in compiled code"""

HILL = -2
"""what `blocker` says where the ground stands in the way"""
_HAIR_M = 2e-6
"""by how much leaving comes before entering"""


@numba.njit(cache=True, nogil=True)
def entry(
    x: float, y: float, dx: float, dy: float, frame: NDArray[np.float64], rows: int, cols: int
) -> tuple[float, float]:
    """Where a line enters the box of the index and where it leaves, as lengths; (1, 0) if never."""
    low, high = 0.0, FAR
    for axis in range(2):
        p, d = (x, dx) if axis == 0 else (y, dy)
        near = frame[axis]
        far = near + frame[2] * (cols if axis == 0 else rows)
        if abs(d) < 1e-15:
            if p < near or p > far:
                return 1.0, 0.0
            continue
        a, b = (near - p) / d, (far - p) / d
        if a > b:
            a, b = b, a
        low, high = max(low, a), min(high, b)
    return low, high


@numba.njit(cache=True, nogil=True)
def next_wall(
    x: float,
    y: float,
    dx: float,
    dy: float,
    after_u: float,
    after_wall: int,
    skip: int,
    limit: float,
    cell: int,
    walls: NDArray[np.float64],
    first: NDArray[np.int64],
    listed: NDArray[np.int64],
) -> tuple[float, int]:
    """The wall of one index cell that comes next after (``after_u``, ``after_wall``).

    Returns its length along the line and its number, or (``limit``, -1) if there is none before
    ``limit``.
    """
    best_u, best = limit, -1
    for k in range(first[cell], first[cell + 1]):
        w = listed[k]
        if w == skip:
            continue
        wall = walls[w]
        across = dx * wall[4] + dy * wall[5]
        if abs(across) < 1e-12:
            continue
        u = ((wall[0] - x) * wall[4] + (wall[1] - y) * wall[5]) / across
        if u < -1e-9 or u >= best_u + _HAIR_M:
            continue
        # the place on the wall, between its ends
        ex, ey = wall[2] - wall[0], wall[3] - wall[1]
        place = (x + u * dx - wall[0]) * ex + (y + u * dy - wall[1]) * ey
        length2 = ex * ex + ey * ey
        if place < -1e-9 * length2 or place > (1.0 + 1e-9) * length2:
            continue
        if across > 0.0:
            u -= _HAIR_M
        if u < after_u or (u == after_u and w <= after_wall):
            continue
        if u < best_u or (u == best_u and best >= 0 and w < best):
            best_u, best = u, w
    return best_u, best


@numba.njit(cache=True, nogil=True)
def _stops(
    wall: NDArray[np.float64],
    x0: float,
    y0: float,
    z0: float,
    dx: float,
    dy: float,
    rise: float,
    length: float,
) -> bool:
    """Whether a wall stands in a line from a point, of a plan direction, rise and length."""
    across = dx * wall[4] + dy * wall[5]
    if abs(across) < 1e-12:
        return False
    at = ((wall[0] - x0) * wall[4] + (wall[1] - y0) * wall[5]) / across
    if at < 1e-3 or at > length - 1e-3:
        return False
    z = z0 + rise * at
    if z >= wall[7] or z <= wall[6] > 0.0:
        return False
    ex, ey = wall[2] - wall[0], wall[3] - wall[1]
    place = (x0 + at * dx - wall[0]) * ex + (y0 + at * dy - wall[1]) * ey
    return 0.0 <= place <= ex * ex + ey * ey


@numba.njit(cache=True, nogil=True)
def blocker(
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    hint: int,
    walls: NDArray[np.float64],
    first: NDArray[np.int64],
    listed: NDArray[np.int64],
    tallest: NDArray[np.float64],
    frame: NDArray[np.float64],
    ground: NDArray[np.float64],
) -> int:
    """A wall that stands between two points, -1 if there is none, `HILL` if the ground does.

    Walls met within a millimetre of an end do not count, so that an end may lie on one. Walls
    are met from inside too: a line that enters through a roof is stopped where it would leave.
    The wall ``hint`` (-1 for none) is tried first: what stopped a neighbour often stops this line.
    """
    rows, cols = tallest.shape
    dx, dy = x1 - x0, y1 - y0
    length = math.hypot(dx, dy)
    if length < 2e-3:
        return -1
    dx /= length
    dy /= length
    rise = (z1 - z0) / length
    if hint >= 0 and _stops(walls[hint], x0, y0, z0, dx, dy, rise, length):
        return hint
    begin, end = entry(x0, y0, dx, dy, frame, rows, cols)
    end = min(end, length)
    if begin >= end:
        return -1
    side = frame[2]
    gx, gy = x0 + begin * dx - frame[0], y0 + begin * dy - frame[1]
    c = min(max(math.floor(gx / side), 0), cols - 1)
    r = min(max(math.floor(gy / side), 0), rows - 1)
    step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    pace_x = side / abs(dx) if abs(dx) > 1e-15 else FAR
    pace_y = side / abs(dy) if abs(dy) > 1e-15 else FAR
    edge_x = frame[0] + (c + (1 if dx > 0 else 0)) * side
    edge_y = frame[1] + (r + (1 if dy > 0 else 0)) * side
    next_x = (edge_x - x0) / dx if abs(dx) > 1e-15 else FAR
    next_y = (edge_y - y0) / dy if abs(dy) > 1e-15 else FAR
    u = begin
    relief = len(ground) > 0
    while u < end:
        leave = min(next_x, next_y, end)
        if relief and z0 + rise * 0.5 * (u + leave) < ground[r, c]:
            return HILL
        lowest = z0 + rise * (u if rise > 0 else leave)
        if lowest < tallest[r, c]:
            cell = r * cols + c
            for k in range(first[cell], first[cell + 1]):
                if _stops(walls[listed[k]], x0, y0, z0, dx, dy, rise, length):
                    return int(listed[k])
        u = leave
        if next_x < next_y:
            next_x += pace_x
            c += step_c
        else:
            next_y += pace_y
            r += step_r
        if c < 0 or c >= cols or r < 0 or r >= rows:
            break
    return -1
