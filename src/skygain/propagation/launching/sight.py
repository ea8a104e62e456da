"""What a diffracting edge sees: places that a ray reaches from the transmitter by way of it.

Altitudes are bits of a number. Paths over a vertical edge have one plan whatever their altitude,
so all bits are looked at together; a level edge is asked for one bit at a time.
"""

from __future__ import annotations

__all__ = ["MATERIAL", "WINDOWS", "WINDOWS_FOUND", "edge_rows", "in_sight", "near_walls"]

import math

import numpy as np
from numpy.typing import NDArray

from skygain.propagation.launching.compiled import inner
from skygain.propagation.launching.edges import Edges
from skygain.propagation.launching.walking import entry, stopped, unblocked

WINDOWS = 8
"""most parts of an edge that are looked at separately"""

ALONG, FRONT, APPROACH, MATERIAL = 3, 6, 12, 26
"""where in a row of `edge_rows` the direction, the normals, the transmitter and the material are"""
WINDOWS_FOUND = 27


def edge_rows(
    source: NDArray[np.float64],
    edges: Edges,
    windows: NDArray[np.float64],
    found: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Edges and how the transmitter's rays arrive at them, a row of numbers for each.

    The row is: one end (3), direction (3), normals of both faces (6); place along the edge nearest
    the transmitter, its distance from there and its direction (3) across the edge; face 0, the one
    it lights, as normal (3) and as the direction (3) into it; the exterior angle, the angle φ' from
    face 0, and ±1, by which the direction of the edge turns to make φ' grow from face 0; material;
    windows in sight (their number, and from and to of each).
    """
    rows = np.zeros((len(found), WINDOWS_FOUND + 1 + 2 * WINDOWS))
    rows[:, :3], rows[:, 3:6], rows[:, 6:12] = (
        edges.origin_m,
        edges.along,
        edges.normals.reshape(-1, 6),
    )
    away = source - edges.origin_m
    place = (away * edges.along).sum(axis=1)
    across = away - place[:, None] * edges.along
    distance = np.maximum(np.sqrt((across**2).sum(axis=1)), 1e-6)
    rows[:, 12], rows[:, 13] = place, distance
    rows[:, 14:17] = across / distance[:, None]
    lit = (away[:, None, :] * edges.normals).sum(axis=2) > 0
    nearer = np.where(lit[:, 0], 0, 1)
    number = np.arange(len(found))
    face, other = edges.normals[number, nearer], edges.normals[number, 1 - nearer]
    into = np.cross(face, edges.along)
    sign = np.where((into * other).sum(axis=1) > 0, -1.0, 1.0)
    into *= sign[:, None]
    rows[:, 17:20], rows[:, 20:23] = face, into
    inner = np.arccos(np.clip(-(face * other).sum(axis=1), -1, 1))
    rows[:, 23] = 2 * np.pi - inner
    rows[:, 24] = np.arctan2((across * face).sum(axis=1), (across * into).sum(axis=1)) % (2 * np.pi)
    rows[:, 25] = sign
    rows[:, MATERIAL] = edges.material
    rows[:, WINDOWS_FOUND] = found
    rows[:, WINDOWS_FOUND + 1 :] = windows.reshape(len(found), -1)
    return rows


@inner
def in_sight(
    edge, x, y, floor, wanted, hint, near, count, low, rise, altitudes, walls, first, listed,
    tallest, frame, ground,
):  # fmt: skip
    """Which of the ``wanted`` altitudes at a place get a ray, and a wall that stopped one.

    With a ``count`` of 0 or more only the first of ``near`` can stand in the way, and ``hint`` is
    a place among these. The ``floor`` is the ground's height. ``low`` and ``rise`` are room to
    work in, a number for each altitude.
    """
    ox, oy, oz, ux, uy, uz = edge[0], edge[1], edge[2], edge[3], edge[4], edge[5]
    rx, ry = x - ox, y - oy
    begin = 0
    while not (wanted >> begin) & 1:
        begin += 1
    rz = altitudes[begin] + floor - oz
    if (
        rx * edge[6] + ry * edge[7] + rz * edge[8] <= 1e-9
        and rx * edge[9] + ry * edge[10] + rz * edge[11] <= 1e-9
    ):
        return 0, hint
    a_r = rx * ux + ry * uy + rz * uz
    px, py, pz = rx - a_r * ux, ry - a_r * uy, rz - a_r * uz
    rho = max(math.sqrt(px * px + py * py + pz * pz), 1e-6)
    a_t, share = edge[12], edge[13] / (edge[13] + rho)
    at = a_t + (a_r - a_t) * share
    qx, qy = ox + at * ux, oy + at * uy
    length = max(math.hypot(x - qx, y - qy), 1e-9)
    seen, windows = 0, int(edge[WINDOWS_FOUND])
    j, rest = begin, wanted >> begin
    while rest:
        if rest & 1:
            rz = altitudes[j] + floor - oz
            at = a_t + (rx * ux + ry * uy + rz * uz - a_t) * share
            for i in range(WINDOWS_FOUND + 1, WINDOWS_FOUND + 1 + 2 * windows, 2):
                if edge[i] <= at <= edge[i + 1]:
                    seen |= 1 << j
                    break
            low[j] = oz + at * uz
            rise[j] = (rz - at * uz) / length
        rest >>= 1
        j += 1
    if seen == 0:
        return 0, hint
    if count < 0:
        return unblocked(
            qx, qy, x, y, low, rise, seen, hint, walls, first, listed, tallest, frame, ground
        )
    if length < 2e-3:
        return seen, hint
    dx, dy = (x - qx) / length, (y - qy) / length
    for k in range(count):
        # the one that stopped the last, then the others
        i = hint if k == 0 else (k - 1 if k <= hint else k)
        left = stopped(near[i], walls, qx, qy, dx, dy, length, low, rise, seen)
        if left != seen:
            seen, hint = left, i
            if left == 0:
                break
    return seen, hint


@inner
def near_walls(
    edge, west, south, side, lowest, near, marked, mark, walls, first, listed, shape, frame
):  # fmt: skip
    """The walls that can stand between a vertical edge and a cell: how many, written to ``near``.

    Walls beside the cell's outermost lines of sight are left out, and those below all lines to
    the height ``lowest`` or more. ``marked`` remembers by ``mark`` what was noted.
    """
    rows, cols = shape
    qx, qy = edge[0], edge[1]
    cx, cy = west + 0.5 * side - qx, south + 0.5 * side - qy
    # its two outermost corners, a hair inside
    left, right, furthest = 0.0, 0.0, 0.0
    lx, ly, rx, ry = cx, cy, cx, cy
    for corner in range(4):
        x = cx + (0.499999 if corner % 2 else -0.499999) * side
        y = cy + (0.499999 if corner // 2 else -0.499999) * side
        turn = (cx * y - cy * x) / math.hypot(x, y)
        furthest = max(furthest, math.hypot(x, y))
        if turn > left:
            left, lx, ly = turn, x, y
        if turn < right:
            right, rx, ry = turn, x, y
    share = edge[13] / (edge[13] + furthest)
    source = edge[2] + edge[5] * edge[12]
    under = min(lowest, source + (lowest - source) * share)
    wedge = max(abs(cx), abs(cy)) > side
    count, grid = 0, frame[2]
    for line in range(3):
        tx, ty = (lx, ly) if line == 0 else (rx, ry)
        x0, y0 = qx, qy
        if line == 2:
            # the cell itself, or all round an edge that is too near for lines
            x0, y0, tx, ty = qx + cx, qy + cy, 0.0, 0.0
        length = max(math.hypot(tx, ty), 1e-9)
        dx, dy = tx / length, ty / length
        begin, end = entry(x0, y0, dx, dy, frame, rows, cols)
        end = min(end, length)
        if begin > end:
            continue
        c = min(max(math.floor((x0 + begin * dx - frame[0]) / grid), 0), cols - 1)
        r = min(max(math.floor((y0 + begin * dy - frame[1]) / grid), 0), rows - 1)
        around = 1 if line == 2 and not wedge else 0
        for a in range(max(r - around, 0), min(r + around + 1, rows)):
            for b in range(max(c - around, 0), min(c + around + 1, cols)):
                count = _noted(a * cols + b, near, count, marked, mark, first, listed)
        if line == 2:
            continue
        pace_x = grid / abs(dx) if abs(dx) > 1e-15 else 1e30
        pace_y = grid / abs(dy) if abs(dy) > 1e-15 else 1e30
        next_x = (
            (frame[0] + (c + (1 if dx > 0 else 0)) * grid - x0) / dx if abs(dx) > 1e-15 else 1e30
        )
        next_y = (
            (frame[1] + (r + (1 if dy > 0 else 0)) * grid - y0) / dy if abs(dy) > 1e-15 else 1e30
        )
        while min(next_x, next_y) < end:
            if next_x < next_y:
                next_x += pace_x
                c += 1 if dx > 0 else -1
            else:
                next_y += pace_y
                r += 1 if dy > 0 else -1
            if c < 0 or c >= cols or r < 0 or r >= rows:
                break
            count = _noted(r * cols + c, near, count, marked, mark, first, listed)
    kept = 0
    for k in range(count):
        w = near[k]
        ax, ay, bx, by = walls[w, 0] - qx, walls[w, 1] - qy, walls[w, 2] - qx, walls[w, 3] - qy
        beside = wedge and (
            (lx * ay - ly * ax > 0.0 and lx * by - ly * bx > 0.0)
            or (rx * ay - ry * ax < 0.0 and rx * by - ry * bx < 0.0)
        )
        if not beside and walls[w, 7] > under:
            near[kept] = w
            kept += 1
    return kept


@inner
def _noted(cell, near, count, marked, mark, first, listed):
    for k in range(first[cell], first[cell + 1]):
        w = listed[k]
        if marked[w] != mark:
            marked[w] = mark
            near[count] = w
            count += 1
    return count
