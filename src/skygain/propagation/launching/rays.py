"""The launch: rays in vertical planes, with reflections at walls, the ground and roofs.

A ray of one azimuth stands for the whole vertical plane: its way in plan is walked once, and a
list of intervals of the initial slope m says which rays of the plane are still on it. At the
unfolded length s such a ray is at the height |z + m s| (the ground mirrors it). A cell at the
height h is met by m = (h - z)/s directly and by m = -(h + z)/s over the ground.
docs/propagation.md derives all of it.
"""

from __future__ import annotations

__all__ = ["MOST_REFLECTIONS", "launch_sector"]

import math

import numba
import numpy as np

from skygain.propagation.launching.antenna import amplitude
from skygain.propagation.launching.fields import at_ground, at_wall, coefficients
from skygain.propagation.launching.pieces import MOST, inside, outside
from skygain.propagation.launching.walking import FAR, entry, next_wall

MOST_REFLECTIONS = 6
"""most reflections on one path that the compiled code has room for"""
_BRANCHES = 256
"""branches of one azimuth that can wait at a time"""
_LANES = 2 * MOST
"""intervals of length for each altitude"""
_ENTRIES = 4
"""buildings entered above their roofs that a branch remembers"""
_NEAREST_M = 0.05
"""the spreading of a ray is cut off at this length"""


@numba.njit(cache=True, nogil=True)
def _lanes(pieces, n, z, altitudes, over_ground, lanes, numbers):
    """Where along a branch each altitude is met: lengths and rise, and (altitude, by ground)."""
    k = 0
    for i in range(n):
        low, high = pieces[i, 0], pieces[i, 1]
        for j in range(len(altitudes)):
            rise = altitudes[j] - z
            a, b = 1.0, 0.0
            if rise > 0.0:
                if high > 0.0:
                    a, b = rise / high, (rise / low if low > 0.0 else FAR)
            elif rise < 0.0:
                if low < 0.0:
                    a, b = rise / low, (rise / high if high < 0.0 else FAR)
            elif low <= 0.0 <= high:
                a, b = 0.0, FAR
            if a < b and k < len(lanes):
                lanes[k, 0], lanes[k, 1], lanes[k, 2] = a, b, rise
                numbers[k, 0], numbers[k, 1] = j, 0
                k += 1
            if over_ground and low < 0.0:
                rise = altitudes[j] + z
                a, b = rise / -low, (rise / -high if high < 0.0 else FAR)
                if a < b and k < len(lanes):
                    lanes[k, 0], lanes[k, 1], lanes[k, 2] = a, b, rise
                    numbers[k, 0], numbers[k, 1] = j, 1
                    k += 1
    return k


@numba.njit(cache=True, nogil=True)
def _power(s, rise, mirrored, turn, met, kinds, w, table, ground, field, pattern, azimuth):
    """|E|² of the ray of a branch that has the unfolded length ``s``.

    ``mirrored`` is 0 for no mirror beneath it, 1 for the ground and 2 for a roof; ``turn`` is
    the length at which it is met. ``met[k]`` has length, normal across and normal beside.
    """
    r = math.sqrt(s * s + rise * rise)
    sine = rise / r
    flat = s / r
    if mirrored == 0 and w == 0:
        e_v, e_h = field[0], field[1]
        power = (e_v * e_v.conjugate()).real + (e_h * e_h.conjugate()).real
    else:
        e_v, e_h = field[0], field[1]
        down = mirrored > 0
        for k in range(w):
            if down and met[k, 0] > turn:
                e_v, e_h = at_ground(e_v, e_h, sine, table, ground if mirrored == 1 else kinds[0])
                down = False
            te, tm = coefficients(table, kinds[k + 1], abs(met[k, 1]) * flat)
            now = -sine if down else sine
            e_v, e_h = at_wall(e_v, e_h, now, met[k, 1], met[k, 2], te, tm)
        if down:
            e_v, e_h = at_ground(e_v, e_h, sine, table, ground if mirrored == 1 else kinds[0])
        power = (e_v * e_v.conjugate()).real + (e_h * e_h.conjugate()).real
    if len(pattern):
        start = -sine if mirrored > 0 else sine
        power *= amplitude(pattern, azimuth, start) ** 2
    return power


@numba.njit(cache=True, nogil=True)
def _trace(
    azimuth,
    width,
    source,
    most,
    field,
    pattern,
    altitudes,
    table,
    ground,
    world,
    scratch,
    shape,
    out,
):
    """Follow the plane of one azimuth and add what its cells receive to ``out``."""
    walls, owner, first, listed, tallest, frame = world
    place, slopes, counts, met, kinds, entered, entered_s, lanes, numbers = scratch
    rows, cols = tallest.shape
    side = frame[2]
    off_r, off_c = int(frame[3]), int(frame[4])
    # place: x, y, dx, dy, s at (x, y), z of the source, u to begin at, height of the roof met
    place[0, 0], place[0, 1] = source[0], source[1]
    place[0, 2], place[0, 3] = math.cos(azimuth), math.sin(azimuth)
    place[0, 4], place[0, 5], place[0, 6], place[0, 7] = 0.0, source[2], 0.0, 0.0
    slopes[0, 0, 0], slopes[0, 0, 1] = -FAR, FAR
    # counts: pieces, walls met, mirrored by a roof, wall to skip
    counts[0, 0], counts[0, 1], counts[0, 2], counts[0, 3] = 1, 0, 0, -1
    for i in range(_ENTRIES):
        entered[0, i] = -1
    waiting = 1
    while waiting:
        waiting -= 1
        b = waiting
        x, y, dx, dy = place[b, 0], place[b, 1], place[b, 2], place[b, 3]
        s0, z, u = place[b, 4], place[b, 5], place[b, 6]
        n, w, roofed, skip = counts[b, 0], counts[b, 1], counts[b, 2], counts[b, 3]
        # a child may take the place b on the stack: what this branch needs moves to the top row
        t = len(place) - 1
        place[t, 7] = place[b, 7]
        for i in range(n):
            slopes[t, i, 0], slopes[t, i, 1] = slopes[b, i, 0], slopes[b, i, 1]
        for i in range(w):
            met[t, i, 0], met[t, i, 1], met[t, i, 2] = met[b, i, 0], met[b, i, 1], met[b, i, 2]
        for i in range(w + 1):
            kinds[t, i] = kinds[b, i]
        for i in range(_ENTRIES):
            entered[t, i], entered_s[t, i] = entered[b, i], entered_s[b, i]
        over_ground = roofed == 0 and w + 1 <= most
        k = _lanes(slopes[t], n, z, altitudes, over_ground, lanes, numbers)
        if k == 0:
            continue
        begin, end = entry(x, y, dx, dy, frame, rows, cols)
        u = max(u, begin)
        if u >= end:
            continue
        furthest = 0.0
        for i in range(k):
            furthest = max(furthest, lanes[i, 1])
        c = min(max(math.floor((x + u * dx - frame[0]) / side), 0), cols - 1)
        r = min(max(math.floor((y + u * dy - frame[1]) / side), 0), rows - 1)
        flat_x, flat_y = abs(dx) < 1e-15, abs(dy) < 1e-15
        pace_x = FAR if flat_x else side / abs(dx)
        pace_y = FAR if flat_y else side / abs(dy)
        next_x = FAR if flat_x else (frame[0] + (c + (1 if dx > 0 else 0)) * side - x) / dx
        next_y = FAR if flat_y else (frame[1] + (r + (1 if dy > 0 else 0)) * side - y) / dy
        after_u, after_wall = u, -1
        while True:
            leave = min(next_x, next_y)
            cell = r * cols + c
            hit_u, hit = leave, -1
            if first[cell] != first[cell + 1]:
                hit_u, hit = next_wall(
                    x, y, dx, dy, after_u, after_wall, skip, leave, cell, walls, first, listed
                )
            stop = hit_u if hit >= 0 else leave
            row, col = r - off_r, c - off_c
            if stop > u and 0 <= row < shape[0] and 0 <= col < shape[1]:
                a0, b0 = s0 + u, s0 + stop
                for i in range(k):
                    a, e = max(a0, lanes[i, 0], _NEAREST_M), min(b0, lanes[i, 1])
                    if a < e:
                        rise = lanes[i, 2]
                        s = 0.5 * (a + e)
                        mirrored = 2 if roofed else numbers[i, 1]
                        turn = 0.0
                        if mirrored == 1:
                            turn = s * z / rise
                        elif mirrored == 2:
                            turn = s * (place[t, 7] - z) / rise
                        power = _power(
                            s, rise, mirrored, turn, met[t], kinds[t], w, table, ground, field,
                            pattern, azimuth,
                        )  # fmt: skip
                        spread = 0.5 * math.log((e * e + rise * rise) / (a * a + rise * rise))
                        out[numbers[i, 0], row, col] += width * spread * power
            u = max(u, stop)
            if s0 + u >= furthest:
                break
            if hit < 0:
                if next_x < next_y:
                    next_x += pace_x
                    c += 1 if dx > 0 else -1
                else:
                    next_y += pace_y
                    r += 1 if dy > 0 else -1
                if c < 0 or c >= cols or r < 0 or r >= rows:
                    break
                continue
            after_u, after_wall = hit_u, hit
            base, top = walls[hit, 6], walls[hit, 7]
            house = owner[hit, 0]
            nx, ny = walls[hit, 4], walls[hit, 5]
            across = dx * nx + dy * ny
            s = max(s0 + u, 1e-9)
            if across < 0.0:
                # entering: rays between base and top meet the wall
                for i in range(_ENTRIES - 1, 0, -1):
                    entered[t, i], entered_s[t, i] = entered[t, i - 1], entered_s[t, i - 1]
                entered[t, 0], entered_s[t, 0] = house, s
                high, low = (top - z) / s, -(top + z) / s
                inner_high = (base - z) / s if base > 0.0 else 0.0
                inner_low = -(base + z) / s if base > 0.0 else 0.0
                if w + 1 + roofed <= most and waiting < len(place) - 2:
                    q = waiting
                    if base > 0.0:
                        m = inside(slopes[t], n, inner_high, high, slopes[q], 0)
                        m = inside(slopes[t], n, low, inner_low, slopes[q], m)
                    else:
                        m = inside(slopes[t], n, low, high, slopes[q], 0)
                    if m > 0:
                        place[q, 0], place[q, 1] = x + u * dx, y + u * dy
                        place[q, 2], place[q, 3] = dx - 2 * across * nx, dy - 2 * across * ny
                        place[q, 4], place[q, 5], place[q, 6], place[q, 7] = s, z, 0.0, place[t, 7]
                        counts[q, 0], counts[q, 1], counts[q, 2], counts[q, 3] = (
                            m,
                            w + 1,
                            roofed,
                            hit,
                        )
                        for i in range(w):
                            met[q, i, 0], met[q, i, 1], met[q, i, 2] = (
                                met[t, i, 0], met[t, i, 1], met[t, i, 2],
                            )  # fmt: skip
                        met[q, w, 0], met[q, w, 1], met[q, w, 2] = s, across, dx * ny - dy * nx
                        for i in range(w + 1):
                            kinds[q, i] = kinds[t, i]
                        kinds[q, w + 1] = owner[hit, 1]
                        for i in range(_ENTRIES):
                            entered[q, i], entered_s[q, i] = entered[t, i], entered_s[t, i]
                        waiting += 1
                if base > 0.0:
                    n = outside(slopes[t], n, inner_high, high)
                    n = outside(slopes[t], n, low, inner_low)
                else:
                    n = outside(slopes[t], n, low, high)
            else:
                came = 0.0
                for i in range(_ENTRIES):
                    if entered[t, i] == house:
                        came = entered_s[t, i]
                        entered[t, i] = -1
                        break
                if base > 0.0 and came > 0.0:
                    # up through the underside
                    n = outside(slopes[t], n, (base - z) / s, (base - z) / came)
                    n = outside(slopes[t], n, -(base + z) / came, -(base + z) / s)
                if z > top:
                    # down onto the roof, which mirrors what has met less than the most
                    low = -z / came if came > 0.0 else -FAR
                    high = (top - z) / s
                    if w + 1 <= most and not roofed and waiting < len(place) - 2:
                        q = waiting
                        m = inside(slopes[t], n, low, high, slopes[q], 0)
                        if m > 0:
                            for i in range(m):
                                slopes[q, i, 0], slopes[q, i, 1] = (
                                    -slopes[q, i, 1],
                                    -slopes[q, i, 0],
                                )
                            place[q, 0], place[q, 1], place[q, 2], place[q, 3] = x, y, dx, dy
                            place[q, 4], place[q, 5] = s0, 2 * top - z
                            place[q, 6] = max(came - s0, 0.0) + 1e-6
                            place[q, 7] = top
                            counts[q, 0], counts[q, 1], counts[q, 2], counts[q, 3] = m, w, 1, -1
                            for i in range(w):
                                met[q, i, 0], met[q, i, 1], met[q, i, 2] = (
                                    met[t, i, 0], met[t, i, 1], met[t, i, 2],
                                )  # fmt: skip
                                kinds[q, i + 1] = kinds[t, i + 1]
                            kinds[q, 0] = owner[hit, 1]
                            for i in range(_ENTRIES):
                                entered[q, i] = -1
                            waiting += 1
                    n = outside(slopes[t], n, low, high)
            if n == 0:
                break
            k = _lanes(slopes[t], n, z, altitudes, over_ground, lanes, numbers)
            if k == 0:
                break
            furthest = 0.0
            for i in range(k):
                furthest = max(furthest, lanes[i, 1])


@numba.njit(cache=True, nogil=True)
def _signature(azimuth, source, depth, world):
    """The walls that the ray of an azimuth meets in plan, one after the other, as one number."""
    walls, _owner, first, listed, tallest, frame = world
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
    out,
):
    """Launch the azimuths number ``begin`` to ``end`` of ``total``; returns how many were traced.

    An interval is halved, up to ``halvings`` times, while the rays at its two borders meet
    different walls (the first ``depth`` of their reflections are compared).
    """
    scratch = (
        np.empty((_BRANCHES, 8)),
        np.empty((_BRANCHES, MOST, 2)),
        np.empty((_BRANCHES, 4), dtype=np.int64),
        np.empty((_BRANCHES, MOST_REFLECTIONS, 3)),
        np.empty((_BRANCHES, MOST_REFLECTIONS + 1), dtype=np.int64),
        np.empty((_BRANCHES, _ENTRIES), dtype=np.int64),
        np.empty((_BRANCHES, _ENTRIES)),
        np.empty((_LANES * len(altitudes), 3)),
        np.empty((_LANES * len(altitudes), 2), dtype=np.int64),
    )
    step = 2.0 * math.pi / total
    # a border that hits walls of a square lattice end-on would be ambiguous
    offset = 0.1234567 * step
    todo = np.empty((halvings + 2, 2))
    marks = np.empty((halvings + 2, 2), dtype=np.int64)
    level = np.empty(halvings + 2, dtype=np.int64)
    traced = 0
    right = _signature(offset + begin * step, source, depth, world)
    for number in range(begin, end):
        left = right
        right = _signature(offset + (number + 1) * step, source, depth, world)
        todo[0, 0], todo[0, 1] = offset + number * step, step
        marks[0, 0], marks[0, 1], level[0] = left, right, 0
        n = 1
        while n:
            n -= 1
            low, width, deep = todo[n, 0], todo[n, 1], level[n]
            mark_low, mark_high = marks[n, 0], marks[n, 1]
            middle = low + 0.5 * width
            if mark_low != mark_high and deep < halvings:
                mark = _signature(middle, source, depth, world)
                todo[n, 0], todo[n, 1], level[n] = middle, 0.5 * width, deep + 1
                marks[n, 0], marks[n, 1] = mark, mark_high
                todo[n + 1, 0], todo[n + 1, 1], level[n + 1] = low, 0.5 * width, deep + 1
                marks[n + 1, 0], marks[n + 1, 1] = mark_low, mark
                n += 2
                continue
            _trace(
                middle,
                width,
                source,
                most,
                field,
                pattern,
                altitudes,
                table,
                ground,
                world,
                scratch,
                shape,
                out,
            )
            traced += 1
    return traced
