"""Following one branch: a vertical plane of rays along its way in plan.

A ray of one azimuth stands for the whole vertical plane: its way in plan is walked once, and a
list of intervals of the initial slope m says which rays of the plane are still on it. At the
unfolded length s such a ray is at the height |z + m s| (the ground mirrors it). A cell at the
height h is met by m = (h - z)/s directly and by m = -(h + z)/s over the ground.
docs/propagation.md derives all of it.
"""

from __future__ import annotations

__all__ = ["MOST_REFLECTIONS", "begin", "bend_of", "follow", "new_scratch", "strength"]

import math

import numba
import numpy as np

from skygain.propagation.launching.antenna import amplitude
from skygain.propagation.launching.compiled import inner
from skygain.propagation.launching.fields import at_ground, at_wall, coefficients
from skygain.propagation.launching.pieces import MOST, inside, outside
from skygain.propagation.launching.walking import FAR, entry, next_wall
from skygain.propagation.launching.wedge import diffracted

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


@inner
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


@inner
def _power(s, rise, mirrored, turn, met, kinds, w, field, pattern, azimuth, table, ground):
    """|E|² of the ray of a branch that has the unfolded length ``s``.

    ``mirrored`` is 0 for no mirror beneath it, 1 for the ground and 2 for a roof; ``turn`` is
    the length at which it is met. ``met[k]`` has length, normal across and normal beside.
    Arrays are passed one by one: a tuple of them costs more than the field.
    """
    r = math.sqrt(s * s + rise * rise)
    sine = rise / r
    flat = s / r
    e_v, e_h = field[0], field[1]
    down = mirrored > 0
    for k in range(w):
        if down and met[k, 0] > turn:
            e_v, e_h = at_ground(e_v, e_h, sine, table, ground if mirrored == 1 else kinds[0])
            down = False
        te, tm = coefficients(table, kinds[k + 1], abs(met[k, 1]) * flat)
        e_v, e_h = at_wall(e_v, e_h, -sine if down else sine, met[k, 1], met[k, 2], te, tm)
    if down:
        e_v, e_h = at_ground(e_v, e_h, sine, table, ground if mirrored == 1 else kinds[0])
    power = e_v.real * e_v.real + e_v.imag * e_v.imag + e_h.real * e_h.real + e_h.imag * e_h.imag
    if len(pattern):
        power *= amplitude(pattern, azimuth, -sine if mirrored > 0 else sine) ** 2
    return power


@inner
def _bent_power(s, rise, mirrored, turn, met, kinds, w, physics, bend):
    """`_power` of a branch that has come round the corner of a ``bend``; of the corner ``met`` has
    the length alone."""
    field, pattern, azimuth, table, ground = physics
    at = bend[0]
    r = math.sqrt(s * s + rise * rise)
    sine = rise / r
    flat = s / r
    e_v, e_h = field[0], field[1]
    down = mirrored > 0
    for k in range(w):
        if down and met[k, 0] > turn:
            e_v, e_h = at_ground(e_v, e_h, sine, table, ground if mirrored == 1 else kinds[0])
            down = False
        now = -sine if down else sine
        if k == at:
            e_v, e_h = _round_corner(e_v, e_h, now, flat, met[k, 0], s, kinds[k + 1], table, bend)
        else:
            te, tm = coefficients(table, kinds[k + 1], abs(met[k, 1]) * flat)
            e_v, e_h = at_wall(e_v, e_h, now, met[k, 1], met[k, 2], te, tm)
    if down:
        e_v, e_h = at_ground(e_v, e_h, sine, table, ground if mirrored == 1 else kinds[0])
    power = e_v.real * e_v.real + e_v.imag * e_v.imag + e_h.real * e_h.real + e_h.imag * e_h.imag
    if len(pattern):
        power *= amplitude(pattern, azimuth, -sine if mirrored > 0 else sine) ** 2
    return power


@inner
def strength(s, rise, met, kinds, w, field, pattern, azimuth, table, ground):
    """|E|² of a branch at the length ``s``, its spreading included."""
    power = _power(s, rise, 0, 0.0, met, kinds, w, field, pattern, azimuth, table, ground)
    return power / (s * s + rise * rise)


@inner
def _round_corner(e_v, e_h, sine, flat, near, s, material, table, bend):
    """The field behind a vertical corner, its spreading included."""
    _at, faces, plan, theory, e_in, e_out, incoming, outgoing, edge = bend
    incoming[0], incoming[1], incoming[2] = flat * plan[0], flat * plan[1], sine
    outgoing[0], outgoing[1], outgoing[2] = flat * plan[2], flat * plan[3], sine
    e_in[0] = -e_v * sine * plan[0] - e_h * plan[1]
    e_in[1] = -e_v * sine * plan[1] + e_h * plan[0]
    e_in[2] = e_v * flat
    apart = diffracted(
        incoming, outgoing, edge, faces, near / flat, (s - near) / flat, theory, material, e_in,
        table, e_out,
    )  # fmt: skip
    if apart < 0.0:
        return 0j, 0j
    return (
        -sine * (e_out[0] * plan[2] + e_out[1] * plan[3]) + flat * e_out[2],
        -e_out[0] * plan[3] + e_out[1] * plan[2],
    )


@numba.njit(cache=True, nogil=True)
def new_scratch(altitudes):
    """Room for the branches of one azimuth."""
    return (
        np.empty((_BRANCHES, 8)),
        np.empty((_BRANCHES, MOST, 2)),
        np.empty((_BRANCHES, 4), dtype=np.int64),
        np.empty((_BRANCHES, MOST_REFLECTIONS + 1, 3)),
        np.empty((_BRANCHES, MOST_REFLECTIONS + 2), dtype=np.int64),
        np.empty((_BRANCHES, _ENTRIES), dtype=np.int64),
        np.empty((_BRANCHES, _ENTRIES)),
        np.empty((_LANES * altitudes, 3)),
        np.empty((_LANES * altitudes, 2), dtype=np.int64),
    )


@numba.njit(cache=True, nogil=True)
def begin(scratch, x, y, z, azimuth):
    """Put a branch that starts at a source into row 0: all slopes, nothing met."""
    place, slopes, counts, _met, kinds, entered, _entered_s, _lanes_of, _numbers = scratch
    # place: x, y, dx, dy, s at (x, y), z of the source, u to begin at, height of the roof met
    place[0, 0], place[0, 1] = x, y
    place[0, 2], place[0, 3] = math.cos(azimuth), math.sin(azimuth)
    place[0, 4], place[0, 5], place[0, 6], place[0, 7] = 0.0, z, 0.0, 0.0
    slopes[0, 0, 0], slopes[0, 0, 1] = -FAR, FAR
    # counts: pieces, walls met, mirrored by a roof, wall to skip
    counts[0, 0], counts[0, 1], counts[0, 2], counts[0, 3] = 1, 0, 0, -1
    kinds[0, 0] = 0
    for i in range(_ENTRIES):
        entered[0, i] = -1


@numba.njit(cache=True, nogil=True)
def bend_of(at, faces, plan, theory):
    """What `follow` takes for a corner: its place among what is met (-1 for none), the normals of
    its faces, the directions in plan before and after it, the `theory` of `diffracted`, and room
    to work in."""
    return (
        at,
        faces,
        plan,
        theory,
        np.empty(3, dtype=np.complex128),
        np.empty(3, dtype=np.complex128),
        np.empty(3),
        np.empty(3),
        np.array([0.0, 0.0, 1.0]),
    )


@inner
def _note(book, corner, s, z, dx, dy, roofed, w, n, t, azimuth, scratch):
    """Write down that the branch in row ``t`` of ``scratch`` reaches a corner."""
    place, slopes, _counts, met, kinds, _entered, _entered_s, _lanes_of, _numbers = scratch
    count, numbers_of, lengths_of, met_of, kinds_of, slopes_of = book[5:]
    k = count[0]
    if k == len(numbers_of):
        return
    count[0] = k + 1
    numbers_of[k, 0], numbers_of[k, 1], numbers_of[k, 2], numbers_of[k, 3] = corner, w, n, roofed
    lengths_of[k, 0], lengths_of[k, 1], lengths_of[k, 2] = s, z, place[t, 7]
    lengths_of[k, 3], lengths_of[k, 4], lengths_of[k, 5] = dx, dy, azimuth
    for i in range(n):
        slopes_of[k, i, 0], slopes_of[k, i, 1] = slopes[t, i, 0], slopes[t, i, 1]
    for i in range(w):
        met_of[k, i, 0], met_of[k, i, 1], met_of[k, i, 2] = met[t, i, 0], met[t, i, 1], met[t, i, 2]
    for i in range(w + 1):
        kinds_of[k, i] = kinds[t, i]


@numba.njit(cache=True, nogil=True)
def follow(width, most, physics, altitudes, world, scratch, shape, bend, book, out):
    """Follow the branch in row 0 of ``scratch`` and add what its cells receive to ``out``.

    With a ``bend`` (see `bend_of`) the branch has come round a corner. With a ``book`` (see
    `skygain.propagation.launching.fans`) the corners within the width of the beam are noted.
    """
    walls, owner, first, listed, tallest, frame, ground_m = world
    relief, heights = len(ground_m) > 0, altitudes.copy()
    place, slopes, counts, met, kinds, entered, entered_s, lanes, numbers = scratch
    rows, cols = tallest.shape
    side = frame[2]
    off_r, off_c = int(frame[3]), int(frame[4])
    keep, corner_first, corner_listed, corner_xy, wall_ends = (
        book[0],
        book[1],
        book[2],
        book[3],
        book[4],
    )
    field, pattern, azimuth, table, ground = physics
    bent = bend[0]
    # a child may take the place of its parent on the stack: what a branch needs moves to the top
    t = len(place) - 1
    met_here, kinds_here = met[t], kinds[t]
    waiting = 1
    while waiting:
        waiting -= 1
        b = waiting
        x, y, dx, dy = place[b, 0], place[b, 1], place[b, 2], place[b, 3]
        s0, z, u = place[b, 4], place[b, 5], place[b, 6]
        n, w, roofed, skip = counts[b, 0], counts[b, 1], counts[b, 2], counts[b, 3]
        place[t, 7] = place[b, 7]
        for i in range(n):
            slopes[t, i, 0], slopes[t, i, 1] = slopes[b, i, 0], slopes[b, i, 1]
        for i in range(w):
            met[t, i, 0], met[t, i, 1], met[t, i, 2] = met[b, i, 0], met[b, i, 1], met[b, i, 2]
        for i in range(w + 1):
            kinds[t, i] = kinds[b, i]
        for i in range(_ENTRIES):
            entered[t, i], entered_s[t, i] = entered[b, i], entered_s[b, i]
        # over relief the lanes are those of one cell, and the ground stops rays
        over_ground = roofed == 0 and w + 1 <= most and not relief
        k = _lanes(slopes[t], n, z, altitudes, over_ground, lanes, numbers)
        if k == 0 and not relief:
            continue
        begin, end = entry(x, y, dx, dy, frame, rows, cols)
        u = max(u, begin)
        if u >= end:
            continue
        furthest = FAR if relief else 0.0
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
            if relief:
                floor = ground_m[r, c]
                away = max(s0 + 0.5 * (u + stop), _NEAREST_M)
                n = outside(slopes[t], n, -FAR, (floor - z) / away)
                if n == 0:
                    break
                for j in range(len(altitudes)):
                    heights[j] = altitudes[j] + floor
                k = _lanes(slopes[t], n, z, heights, False, lanes, numbers)
            if stop > u and 0 <= row < shape[0] and 0 <= col < shape[1]:
                a0, b0 = s0 + u, s0 + stop
                for i in range(k):
                    a, e = max(a0, lanes[i, 0], _NEAREST_M), min(b0, lanes[i, 1])
                    if a < e:
                        rise = lanes[i, 2]
                        s = 0.5 * (a + e)
                        mirrored = 2 if roofed else numbers[i, 1]
                        if bent == 0 and w == 1 and mirrored == 0:
                            continue  # a corner and nothing else is left to `corners`
                        turn = 0.0
                        if mirrored == 1:
                            turn = s * z / rise
                        elif mirrored == 2:
                            turn = s * (place[t, 7] - z) / rise
                        if bent >= 0:
                            power = _bent_power(
                                s, rise, mirrored, turn, met_here, kinds_here, w, physics, bend
                            )
                            spread = (s - met_here[bent, 0]) * (e - a)
                        else:
                            power = _power(
                                s, rise, mirrored, turn, met_here, kinds_here, w, field, pattern,
                                azimuth, table, ground,
                            )  # fmt: skip
                            spread = 0.5 * math.log((e * e + rise * rise) / (a * a + rise * rise))
                        out[numbers[i, 0], row, col] += width * spread * power
            if keep and corner_first[cell] != corner_first[cell + 1]:
                for i in range(corner_first[cell], corner_first[cell + 1]):
                    q = corner_listed[i]
                    cx, cy = corner_xy[q, 0] - x, corner_xy[q, 1] - y
                    ahead = cx * dx + cy * dy
                    if u - 1e-6 < ahead <= stop + 1e-6 and abs(cy * dx - cx * dy) <= (
                        0.5 * width * (s0 + ahead)
                    ):
                        _note(book, q, s0 + ahead, z, dx, dy, roofed, w, n, t, azimuth, scratch)
            if keep and hit >= 0 and dx * walls[hit, 4] + dy * walls[hit, 5] < 0.0:
                for i in range(2):
                    q = wall_ends[hit, i]
                    if q >= 0:
                        cx, cy = corner_xy[q, 0] - x, corner_xy[q, 1] - y
                        ahead = cx * dx + cy * dy
                        if ahead > stop + 1e-6 and abs(cy * dx - cx * dy) <= (
                            0.5 * width * (s0 + ahead)
                        ):
                            _note(book, q, s0 + ahead, z, dx, dy, roofed, w, n, t, azimuth, scratch)
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
            if relief:
                continue
            k = _lanes(slopes[t], n, z, altitudes, over_ground, lanes, numbers)
            if k == 0:
                break
            furthest = 0.0
            for i in range(k):
                furthest = max(furthest, lanes[i, 1])
