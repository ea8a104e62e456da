"""Walks over the map's plan: the next wall on a line, and whether a line in space is free.

All of it is compiled and takes the arrays of `Geometry`. A wall that a line leaves through comes
a hair before one that it enters at the same place, so that touching buildings are taken in order.
"""

from __future__ import annotations

__all__ = ["FAR", "HILL", "blocker", "entry", "next_wall", "stopped", "unblocked"]

import math

import numba
import numpy as np
from numpy.typing import NDArray

from skygain.propagation.launching.compiled import inner

FAR = 1e30
"""stands for infinity in compiled code"""

HILL = -2
"""what `blocker` says where the ground stands in the way"""
_HAIR_M = 2e-6
"""by how much leaving comes before entering"""


@inner
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


@inner
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
        across = dx * walls[w, 4] + dy * walls[w, 5]
        if abs(across) < 1e-12:
            continue
        u = ((walls[w, 0] - x) * walls[w, 4] + (walls[w, 1] - y) * walls[w, 5]) / across
        if u < -1e-9 or u >= best_u + _HAIR_M:
            continue
        # the place on the wall, between its ends
        ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
        place = (x + u * dx - walls[w, 0]) * ex + (y + u * dy - walls[w, 1]) * ey
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


@inner
def stopped(
    w: int,
    walls: NDArray[np.float64],
    x0: float,
    y0: float,
    dx: float,
    dy: float,
    length: float,
    low: NDArray[np.float64],
    rise: NDArray[np.float64],
    open_lines: int,
) -> int:
    """Which of ``open_lines`` a wall leaves open; all have one plan, from a point in a direction.

    Line j, bit j of the number, starts at the height ``low[j]`` and rises ``rise[j]`` a metre.
    """
    across = dx * walls[w, 4] + dy * walls[w, 5]
    if abs(across) < 1e-12:
        return open_lines
    at = ((walls[w, 0] - x0) * walls[w, 4] + (walls[w, 1] - y0) * walls[w, 5]) / across
    if at < 1e-3 or at > length - 1e-3:
        return open_lines
    base, top = walls[w, 6], walls[w, 7]
    hit, rest, j = 0, open_lines, 0
    while rest:
        if rest & 1:
            z = low[j] + rise[j] * at
            if z < top and not (z <= base > 0.0):
                hit |= 1 << j
        rest >>= 1
        j += 1
    if hit == 0:
        return open_lines
    ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
    place = (x0 + at * dx - walls[w, 0]) * ex + (y0 + at * dy - walls[w, 1]) * ey
    if 0.0 <= place <= ex * ex + ey * ey:
        return open_lines & ~hit
    return open_lines


@inner
def unblocked(
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    low: NDArray[np.float64],
    rise: NDArray[np.float64],
    open_lines: int,
    hint: int,
    walls: NDArray[np.float64],
    first: NDArray[np.int64],
    listed: NDArray[np.int64],
    tallest: NDArray[np.float64],
    frame: NDArray[np.float64],
    ground: NDArray[np.float64],
) -> tuple[int, int]:
    """Which of ``open_lines`` between two places nothing stands in, and what stopped the last.

    The lines have one plan and heights of their own, as in `stopped`; the other number is a wall,
    -1 if there is none, or `HILL` for the ground. Walls met within a millimetre of an end do not
    count, so that an end may lie on one. Walls are met from inside too: a line that enters through
    a roof is stopped where it would leave. The wall ``hint`` (-1 for none) is tried first: what
    stopped a neighbour often stops these lines.
    """
    rows, cols = tallest.shape
    dx, dy = x1 - x0, y1 - y0
    length = math.hypot(dx, dy)
    if length < 2e-3:
        return open_lines, -1
    dx /= length
    dy /= length
    last = -1
    if hint >= 0:
        left = stopped(hint, walls, x0, y0, dx, dy, length, low, rise, open_lines)
        if left != open_lines:
            open_lines, last = left, hint
            if left == 0:
                return 0, hint
    begin, end = entry(x0, y0, dx, dy, frame, rows, cols)
    end = min(end, length)
    if begin >= end:
        return open_lines, last
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
        lowest, rest, j = FAR, open_lines, 0
        while rest:
            if rest & 1:
                if relief and low[j] + rise[j] * 0.5 * (u + leave) < ground[r, c]:
                    open_lines, last = open_lines & ~(1 << j), HILL
                lowest = min(lowest, low[j] + rise[j] * (u if rise[j] > 0 else leave))
            rest >>= 1
            j += 1
        if lowest < tallest[r, c]:
            cell = r * cols + c
            for k in range(first[cell], first[cell + 1]):
                left = stopped(listed[k], walls, x0, y0, dx, dy, length, low, rise, open_lines)
                if left != open_lines:
                    open_lines, last = left, int(listed[k])
                    if left == 0:
                        break
        if open_lines == 0:
            break
        u = leave
        if next_x < next_y:
            next_x += pace_x
            c += step_c
        else:
            next_y += pace_y
            r += step_r
        if c < 0 or c >= cols or r < 0 or r >= rows:
            break
    return open_lines, last


@numba.njit(cache=True, nogil=True)
def blocker(
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    walls: NDArray[np.float64],
    first: NDArray[np.int64],
    listed: NDArray[np.int64],
    tallest: NDArray[np.float64],
    frame: NDArray[np.float64],
    ground: NDArray[np.float64],
) -> int:
    """What stands between two points: a wall, -1 for nothing, `HILL` for the ground."""
    length = max(math.hypot(x1 - x0, y1 - y0), 1e-9)
    low, rise = np.full(1, z0), np.full(1, (z1 - z0) / length)
    _left, last = unblocked(
        x0, y0, x1, y1, low, rise, 1, -1, walls, first, listed, tallest, frame, ground
    )
    return last
