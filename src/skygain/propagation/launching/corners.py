"""Paths over one diffracting edge: from the transmitter to the edge and on to each cell.

The point of diffraction is known in closed form (the incoming and the outgoing ray make the same
angle with the edge), so every edge and receiver point costs one look at what stands between.
"""

from __future__ import annotations

__all__ = ["diffract_edges", "edge_windows", "walled_cells"]

import math

import numba
import numpy as np

from skygain.propagation.launching.antenna import amplitude
from skygain.propagation.launching.compiled import inner
from skygain.propagation.launching.sight import (
    MATERIAL,
    WINDOWS,
    WINDOWS_FOUND,
    in_sight,
    near_walls,
)
from skygain.propagation.launching.walking import FAR, blocker
from skygain.propagation.launching.wedge import angle_of, approached, coefficient, turned

_SAMPLE_M = 0.75
"""parts of an edge shorter than this can be missed"""
_MOST_SAMPLES = 160
_SMOOTH = 2.0
"""cells, times ``points``, from a boundary of light beyond which the field is taken as even
within a cell"""
_STEEP = 1.5
"""cells from a boundary of light within which a cell is cut in four"""
_NEAREST_M = 1e-2
"""nearer to an edge than this the theory says nothing"""


@numba.njit(cache=True, nogil=True)
def _sees(edge, at, source, origin, along, walls, first, listed, tallest, frame, ground):
    x = origin[edge, 0] + at * along[edge, 0]
    y = origin[edge, 1] + at * along[edge, 1]
    z = origin[edge, 2] + at * along[edge, 2]
    wall = blocker(
        source[0], source[1], source[2], x, y, z, walls, first, listed, tallest, frame, ground
    )
    return wall == -1


@numba.njit(cache=True, nogil=True)
def edge_windows(source, origin, along, length, normals, world):
    """The parts of every edge that ``source`` sees: ``[edge, window, (from, to)]`` and how many."""
    walls, _owner, first, listed, tallest, frame, ground = world
    count = len(length)
    windows = np.zeros((count, WINDOWS, 2))
    found = np.zeros(count, dtype=np.int64)
    for e in range(count):
        kx, ky, kz = source[0] - origin[e, 0], source[1] - origin[e, 1], source[2] - origin[e, 2]
        in_front = False
        for f in range(2):
            n = normals[e, f]
            in_front |= kx * n[0] + ky * n[1] + kz * n[2] > 1e-6
        if not in_front:
            continue
        samples = min(max(int(length[e] / _SAMPLE_M), 6), _MOST_SAMPLES)
        step = length[e] / samples
        before = False
        for j in range(samples + 1):
            at = min(max(j * step, 1e-4), length[e] - 1e-4)
            now = _sees(e, at, source, origin, along, walls, first, listed, tallest, frame, ground)
            if j == 0:
                if now:
                    windows[e, 0, 0] = 0.0
            elif now != before:
                low, high = (j - 1) * step, j * step
                for _ in range(10):
                    middle = 0.5 * (low + high)
                    now_here = _sees(
                        e,
                        middle,
                        source,
                        origin,
                        along,
                        walls,
                        first,
                        listed,
                        tallest,
                        frame,
                        ground,
                    )
                    if now_here == before:
                        low = middle
                    else:
                        high = middle
                if now:
                    if found[e] == WINDOWS:
                        before = False
                        break
                    windows[e, found[e], 0] = 0.5 * (low + high)
                else:
                    windows[e, found[e], 1] = 0.5 * (low + high)
                    found[e] += 1
            before = now
            if found[e] == WINDOWS:
                before = False
                break
        if before:
            windows[e, found[e], 1] = length[e]
            found[e] += 1
    return windows, found


@inner
def _powers(
    edge, approach, x, y, floor, wanted, altitudes, theory, field, pattern, slabs, power, away
):
    """Power at a place for each of the ``wanted`` altitudes, over that of free space at 1 m, and
    roughly how far the place is from a boundary of light."""
    rx, ry = x - edge[0], y - edge[1]
    a_t, rho_t, sign = edge[12], edge[13], edge[25]
    ux, uy, uz = sign * edge[3], sign * edge[4], sign * edge[5]
    begin = 0
    while not (wanted >> begin) & 1:
        begin += 1
    rz = altitudes[begin] + floor - edge[2]
    a_r = rx * ux + ry * uy + rz * uz
    px, py, pz = rx - a_r * ux, ry - a_r * uy, rz - a_r * uz
    rho = max(math.sqrt(px * px + py * py + pz * pz), 1e-6)
    phi = angle_of(
        px * edge[20] + py * edge[21] + pz * edge[22], px * edge[17] + py * edge[18] + pz * edge[19]
    )
    outside = phi <= approach[0] + 1e-9
    turns = turned(approach, phi)
    # across the edge as seen by the ray that arrives: (edge) × (transmitter)
    vx, vy, vz = edge[14], edge[15], edge[16]
    across = (uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
    upright, level = field[0].real, field[1].real
    material, wave_number = int(edge[MATERIAL]), theory[0]
    plan = rho_t + rho
    j, rest = begin, wanted >> begin
    while rest:
        now, rest = rest & 1, rest >> 1
        if now == 0:
            j += 1
            continue
        rz = altitudes[j] + floor - edge[2]
        climb = rx * ux + ry * uy + rz * uz - sign * a_t
        whole = math.sqrt(plan * plan + climb * climb)
        cosine, sine = climb / whole, max(plan / whole, 1e-6)
        near, far = rho_t / sine, rho / sine
        if near < _NEAREST_M or far < _NEAREST_M or not outside:
            power[j], away[j] = 0.0, FAR
            j += 1
            continue
        ix, iy, iz = cosine * ux - sine * vx, cosine * uy - sine * vy, cosine * uz - sine * vz
        flat = math.hypot(ix, iy)
        cx, cy = (ix / flat, iy / flat) if flat > 1e-9 else (1.0, 0.0)
        ex = -upright * iz * cx - level * cy
        ey = -upright * iz * cy + level * cx
        ez = upright * flat
        in_a = ex * across[0] + ey * across[1] + ez * across[2]
        in_b = -cosine * (ex * vx + ey * vy + ez * vz) - sine * (ex * ux + ey * uy + ez * uz)
        kl = wave_number * sine * sine * near * far / whole
        sum_a, sum_b = coefficient(
            turns, approach, theory, kl, cosine, sine, material, slabs, complex(in_a, 0.0),
            complex(in_b, 0.0),
        )  # fmt: skip
        total = (
            sum_a.real * sum_a.real + sum_a.imag * sum_a.imag
            + sum_b.real * sum_b.real + sum_b.imag * sum_b.imag
        )  # fmt: skip
        spread = 8.0 * wave_number / math.pi * approach[0] * approach[0] * sine * sine
        total /= spread * near * far * whole
        if len(pattern):
            total *= amplitude(pattern, math.atan2(iy, ix), iz) ** 2
        power[j], away[j] = total, turns[0] * far
        j += 1


@inner
def _parts(
    edge, approach, west, south, floor, side, points, wanted, lit, near, count, rooms, altitudes,
    theory, field, pattern, slabs, walls, first, listed, tallest, frame, ground,
):  # fmt: skip
    """Mean power, for each of the ``wanted`` altitudes, of a cell of which a part is lit; 0 if no
    place of two lattices is."""
    low, rise, power, away, total, hits = rooms
    hint = -1 if count < 0 else 0
    for j in range(len(altitudes)):
        total[j] = 0.0
    for half in (points, 2 * points):
        for j in range(len(altitudes)):
            hits[j] = 0
        for part in range(4):
            x0 = west + (part % 2) * 0.5 * side
            y0 = south + (part // 2) * 0.5 * side
            step = side / (2 * half)
            some = 0
            for a in range(half):
                for b in range(half):
                    lit[a * half + b], hint = in_sight(
                        edge, x0 + (b + 0.5) * step, y0 + (a + 0.5) * step, floor, wanted, hint,
                        near, count, low, rise, altitudes, walls, first, listed, tallest, frame,
                        ground,
                    )  # fmt: skip
                    some |= lit[a * half + b]
            while some:
                # the altitudes that see the same places are taken together
                j = 0
                while not (some >> j) & 1:
                    j += 1
                same, sum_a, sum_b, places = some, 0, 0, 0
                for a in range(half):
                    for b in range(half):
                        here = lit[a * half + b]
                        if (here >> j) & 1:
                            same &= here
                            sum_a, sum_b, places = sum_a + a, sum_b + b, places + 1
                        else:
                            same &= ~here
                some &= ~same
                _powers(
                    edge, approach, x0 + (sum_b / places + 0.5) * step,
                    y0 + (sum_a / places + 0.5) * step, floor, same, altitudes, theory, field,
                    pattern, slabs, power, away,
                )  # fmt: skip
                steep = 0
                for j in range(len(altitudes)):
                    if (same >> j) & 1:
                        hits[j] += places
                        if away[j] > _SMOOTH * points * side:
                            total[j] += power[j] * places
                        else:
                            steep |= 1 << j
                if steep == 0:
                    continue
                # so near to a boundary of light the mean place does not stand for the others
                for a in range(half):
                    for b in range(half):
                        if lit[a * half + b] & steep:
                            _powers(
                                edge, approach, x0 + (b + 0.5) * step, y0 + (a + 0.5) * step,
                                floor, steep, altitudes, theory, field, pattern, slabs, power, away,
                            )  # fmt: skip
                            for j in range(len(altitudes)):
                                if (steep >> j) & 1:
                                    total[j] += power[j]
        for j in range(len(altitudes)):
            if (wanted >> j) & 1 and hits[j] > 0:
                total[j] /= 4 * half * half
                wanted &= ~(1 << j)
        if wanted == 0:
            break


@numba.njit(cache=True, nogil=True)
def diffract_edges(
    begin,
    end,
    step,
    edges,
    physics,
    altitudes,
    outdoors,
    walled,
    lattice,
    nodes,
    world,
    out,
):
    """Add the power diffracted by edges ``begin``, ``begin + step``, … to ``out``.

    ``edges`` are `skygain.propagation.launching.sight.edge_rows`, ``out`` is ``[altitude, row,
    col]``, ``outdoors`` and ``walled`` have a bit for each altitude. A cell whose middle and
    neighbours all see the edge is taken at its middle, or near a boundary of light at the
    ``nodes[0]`` with the weights ``nodes[1]`` of Gauss in both directions. Where some do and some
    do not, or ``walled`` says that a wall runs through it, a lattice of twice as many places finds
    its lit part; where that is found beside a dark middle the search goes on with the neighbours,
    along beams narrower than a cell. Cells that are not ``outdoors`` are left out.
    """
    # tuples of arrays are taken apart here: in the loops that would cost more than the work
    theory, field, pattern, slabs = physics
    walls, _owner, first, listed, tallest, frame, ground = world
    rows, cols = out.shape[1], out.shape[2]
    relief, off_r, off_c = len(ground) > 0, int(frame[3]), int(frame[4])
    corner_x, corner_y, side = lattice
    points, count = nodes.shape[1], len(altitudes)
    lit = np.zeros((rows + 2, cols + 2), dtype=np.int64)
    dark = np.zeros((rows + 2, cols + 2), dtype=np.int64)
    visited = np.empty((rows, cols), dtype=np.int64)
    pending = np.zeros((rows, cols), dtype=np.int64)
    queue = np.empty(rows * cols, dtype=np.int64)
    cut = np.empty(4 * points * points, dtype=np.int64)
    near = np.empty(len(walls) + 1, dtype=np.int64)
    marked = np.full(len(walls), -1)
    mark = 0
    low, rise, power, away = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    total, hits = np.empty(count), np.empty(count, dtype=np.int64)
    rooms = (low, rise, power, away, total, hits)
    for e in range(begin, end, step):
        edge = edges[e]
        if edge[WINDOWS_FOUND] == 0.0:
            continue
        approach = approached(edge[24], edge[23], theory[2])
        upright = edge[5] == 1.0
        for group in range(1 if upright else count):
            group_bits = (1 << count) - 1 if upright else 1 << group
            any_seen, hint = 0, -1
            for row in range(rows):
                y = corner_y + (row + 0.5) * side
                for col in range(cols):
                    wanted = outdoors[row, col] & group_bits
                    seen = 0
                    if wanted:
                        floor = ground[row + off_r, col + off_c] if relief else 0.0
                        seen, hint = in_sight(
                            edge, corner_x + (col + 0.5) * side, y, floor, wanted, hint, near, -1,
                            low, rise, altitudes, walls, first, listed, tallest, frame, ground,
                        )  # fmt: skip
                    lit[row + 1, col + 1] = seen
                    dark[row + 1, col + 1] = wanted & ~seen
                    any_seen |= seen
            if any_seen == 0:
                continue
            head, waiting = 0, 0
            for row in range(rows):
                for col in range(cols):
                    wanted = outdoors[row, col] & any_seen
                    visited[row, col] = ~wanted
                    if wanted == 0:
                        continue
                    some, none = 0, 0
                    for a in range(row, row + 3):
                        for b in range(col, col + 3):
                            some |= lit[a, b]
                            none |= dark[a, b]
                    some &= wanted
                    if some == 0:
                        continue
                    visited[row, col] |= some
                    cutting = some & (none | walled[row, col])
                    if cutting:
                        pending[row, col] = cutting
                        queue[(head + waiting) % len(queue)] = row * cols + col
                        waiting += 1
                    smooth = some & ~cutting
                    if smooth == 0:
                        continue
                    x, y = corner_x + (col + 0.5) * side, corner_y + (row + 0.5) * side
                    floor = ground[row + off_r, col + off_c] if relief else 0.0
                    _powers(
                        edge, approach, x, y, floor, smooth, altitudes, theory, field, pattern,
                        slabs, power, away,
                    )  # fmt: skip
                    uneven, steep = 0, 0
                    for j in range(count):
                        if (smooth >> j) & 1:
                            if away[j] < _STEEP * side:
                                steep |= 1 << j
                            elif away[j] < _SMOOTH * points * side:
                                uneven |= 1 << j
                            else:
                                out[j, row, col] += power[j]
                    for parts, bits in ((1, uneven), (2, steep)):
                        if bits == 0:
                            continue
                        for j in range(count):
                            total[j] = 0.0
                        for a in range(points * parts):
                            py = (2 * (a // points) + 1 + nodes[0, a % points]) / parts - 1.0
                            for b in range(points * parts):
                                px = (2 * (b // points) + 1 + nodes[0, b % points]) / parts - 1.0
                                _powers(
                                    edge, approach, x + 0.5 * px * side, y + 0.5 * py * side, floor,
                                    bits, altitudes, theory, field, pattern, slabs, power, away,
                                )  # fmt: skip
                                weight = nodes[1, a % points] * nodes[1, b % points]
                                for j in range(count):
                                    if (bits >> j) & 1:
                                        total[j] += 0.25 * weight / (parts * parts) * power[j]
                        for j in range(count):
                            if (bits >> j) & 1:
                                out[j, row, col] += total[j]
            while waiting:
                row, col = queue[head] // cols, queue[head] % cols
                head, waiting = (head + 1) % len(queue), waiting - 1
                wanted, pending[row, col] = pending[row, col], 0
                west, south = corner_x + col * side, corner_y + row * side
                floor = ground[row + off_r, col + off_c] if relief else 0.0
                found = -1
                if upright and not relief:
                    lowest = FAR
                    for j in range(count):
                        if (wanted >> j) & 1:
                            lowest = min(lowest, altitudes[j])
                    mark += 1
                    found = near_walls(
                        edge, west, south, side, lowest, near, marked, mark, walls, first, listed,
                        tallest.shape, frame,
                    )  # fmt: skip
                _parts(
                    edge, approach, west, south, floor, side, points, wanted, cut, near, found,
                    rooms, altitudes, theory, field, pattern, slabs, walls, first, listed, tallest,
                    frame, ground,
                )  # fmt: skip
                spreading = 0
                for j in range(count):
                    if (wanted >> j) & 1:
                        out[j, row, col] += total[j]
                        if total[j] > 0.0:
                            spreading |= 1 << j
                spreading &= ~lit[row + 1, col + 1]
                if spreading == 0:
                    continue
                for a in range(max(row - 1, 0), min(row + 2, rows)):
                    for b in range(max(col - 1, 0), min(col + 2, cols)):
                        more = spreading & ~visited[a, b]
                        if more:
                            visited[a, b] |= more
                            if pending[a, b] == 0:
                                queue[(head + waiting) % len(queue)] = a * cols + b
                                waiting += 1
                            pending[a, b] |= more


@numba.njit(cache=True, nogil=True)
def walled_cells(altitudes, shape, world):
    """``[row, col]`` whether a wall as high as the altitude is in a cell, a bit for each."""
    walls, _owner, first, listed, tallest, frame, ground = world
    found = np.zeros(shape, dtype=np.int64)
    cols = tallest.shape[1]
    for row in range(shape[0]):
        for col in range(shape[1]):
            r, c = row + int(frame[3]), col + int(frame[4])
            cell = r * cols + c
            for j in range(len(altitudes)):
                z = altitudes[j] + (ground[r, c] if len(ground) else 0.0)
                for k in range(first[cell], first[cell + 1]):
                    if walls[listed[k], 6] < z < walls[listed[k], 7]:
                        found[row, col] |= 1 << j
    return found
