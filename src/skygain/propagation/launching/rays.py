"""The launch: azimuths all round the transmitter, more where neighbours go different ways."""

from __future__ import annotations

__all__ = ["launch_sector", "signature"]

import math

import numba
import numpy as np

from skygain.propagation.launching.compiled import inner
from skygain.propagation.launching.following import begin as begin_branch
from skygain.propagation.launching.following import bend_of, follow, new_scratch
from skygain.propagation.launching.walking import FAR, entry, next_wall
from skygain.propagation.launching.wedge import no_theory


@inner
def signature(azimuth, source, depth, world):
    """The walls that the ray of an azimuth meets in plan, one after the other, as one number."""
    walls, _owner, first, listed, tallest, frame, _ground = world
    rows, cols = tallest.shape
    side = frame[2]
    x, y, dx, dy = source[0], source[1], math.cos(azimuth), math.sin(azimuth)
    skip = -1
    mark = np.int64(1469598103)
    for _ in range(depth):
        u, end = entry(x, y, dx, dy, frame, rows, cols)
        if u >= end:
            break
        c = min(max(math.floor((x + u * dx - frame[0]) / side), 0), cols - 1)
        r = min(max(math.floor((y + u * dy - frame[1]) / side), 0), rows - 1)
        flat_x, flat_y = abs(dx) < 1e-15, abs(dy) < 1e-15
        pace_x = FAR if flat_x else side / abs(dx)
        pace_y = FAR if flat_y else side / abs(dy)
        next_x = FAR if flat_x else (frame[0] + (c + (1 if dx > 0 else 0)) * side - x) / dx
        next_y = FAR if flat_y else (frame[1] + (r + (1 if dy > 0 else 0)) * side - y) / dy
        hit_u, hit = 0.0, -1
        after_u, after_wall = u, -1
        while 0 <= c < cols and 0 <= r < rows:
            leave = min(next_x, next_y)
            cell = r * cols + c
            if first[cell] != first[cell + 1]:
                while True:
                    hit_u, hit = next_wall(
                        x, y, dx, dy, after_u, after_wall, skip, leave, cell, walls, first, listed
                    )
                    if hit < 0 or dx * walls[hit, 4] + dy * walls[hit, 5] < 0.0:
                        break
                    after_u, after_wall = hit_u, hit
                if hit >= 0:
                    break
            if next_x < next_y:
                next_x += pace_x
                c += 1 if dx > 0 else -1
            else:
                next_y += pace_y
                r += 1 if dy > 0 else -1
        if hit < 0:
            break
        mark = mark * np.int64(1000003) + np.int64(hit + 1)
        across = dx * walls[hit, 4] + dy * walls[hit, 5]
        x, y = x + hit_u * dx, y + hit_u * dy
        dx, dy = dx - 2 * across * walls[hit, 4], dy - 2 * across * walls[hit, 5]
        skip = hit
    return mark


@numba.njit(cache=True, nogil=True)
def launch_sector(
    begin,
    end,
    total,
    halvings,
    depth,
    source,
    most,
    field,
    pattern,
    altitudes,
    table,
    ground,
    world,
    shape,
    book,
    out,
):
    """Launch the azimuths number ``begin`` to ``end`` of ``total``; returns how many were traced.

    An interval is halved, up to ``halvings`` times, while the rays at its two borders meet
    different walls (the first ``depth`` of their reflections are compared).
    """
    scratch = new_scratch(len(altitudes))
    corner_free = bend_of(-1, np.zeros((2, 3)), np.zeros(4), no_theory())
    step = 2.0 * math.pi / total
    # a border that hits walls of a square lattice end-on would be ambiguous
    offset = 0.1234567 * step
    waiting = np.empty((halvings + 2, 2))
    marks = np.empty((halvings + 2, 2), dtype=np.int64)
    level = np.empty(halvings + 2, dtype=np.int64)
    traced = 0
    right = signature(offset + begin * step, source, depth, world)
    for number in range(begin, end):
        left = right
        right = signature(offset + (number + 1) * step, source, depth, world)
        waiting[0, 0], waiting[0, 1] = offset + number * step, step
        marks[0, 0], marks[0, 1], level[0] = left, right, 0
        n = 1
        while n:
            n -= 1
            low, width, deep = waiting[n, 0], waiting[n, 1], level[n]
            mark_low, mark_high = marks[n, 0], marks[n, 1]
            middle = low + 0.5 * width
            if mark_low != mark_high and deep < halvings:
                mark = signature(middle, source, depth, world)
                waiting[n, 0], waiting[n, 1], level[n] = middle, 0.5 * width, deep + 1
                marks[n, 0], marks[n, 1] = mark, mark_high
                waiting[n + 1, 0], waiting[n + 1, 1], level[n + 1] = low, 0.5 * width, deep + 1
                marks[n + 1, 0], marks[n + 1, 1] = mark_low, mark
                n += 2
                continue
            begin_branch(scratch, source[0], source[1], source[2], middle)
            physics = (field, pattern, middle, table, ground)
            follow(width, most, physics, altitudes, world, scratch, shape, corner_free, book, out)
            traced += 1
    return traced
