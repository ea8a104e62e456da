"""Paths over one diffracting edge: from the transmitter to the edge and on to each cell.

The point of diffraction is known in closed form (the incoming and the outgoing ray make the same
angle with the edge), so every edge and receiver point costs one look at what stands between.
"""

from __future__ import annotations

__all__ = ["WINDOWS", "diffract_edges", "edge_windows", "walled_cells"]

import math

import numba
import numpy as np

from skygain.propagation.launching.antenna import amplitude
from skygain.propagation.launching.walking import FAR, blocker
from skygain.propagation.launching.wedge import diffracted

WINDOWS = 8
"""most parts of an edge that are looked at separately"""
_SAMPLE_M = 0.75
"""parts of an edge shorter than this can be missed"""
_MOST_SAMPLES = 160
_SMOOTH = 2.0
"""cells, times ``points``, from a boundary of light beyond which the field is taken as even
within a cell"""
_STEEP = 1.5
"""cells from a boundary of light within which a cell is cut in four"""
_INDOORS = -2.0
"""marks a cell whose middle is indoors"""
_NEAREST_M = 1e-2
"""nearer to an edge than this the theory says nothing"""


@numba.njit(cache=True, nogil=True)
def _sees(edge, at, source, origin, along, walls, first, listed, tallest, frame, ground):
    x = origin[edge, 0] + at * along[edge, 0]
    y = origin[edge, 1] + at * along[edge, 1]
    z = origin[edge, 2] + at * along[edge, 2]
    wall = blocker(
        source[0], source[1], source[2], x, y, z, -1, walls, first, listed, tallest, frame, ground
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


@numba.njit(cache=True, nogil=True)
def _reached(
    e, x, y, z, hint, source, origin, along, normals, windows, found, walls, first, listed,
    tallest, frame, ground,
):  # fmt: skip
    """Place on edge ``e`` at which a ray diffracts to a point, or -1 if none gets there, and the
    wall that is in its way, or the ``hint`` where there is none."""
    ox, oy, oz = origin[e, 0], origin[e, 1], origin[e, 2]
    ux, uy, uz = along[e, 0], along[e, 1], along[e, 2]
    rx, ry, rz = x - ox, y - oy, z - oz
    out0 = rx * normals[e, 0, 0] + ry * normals[e, 0, 1] + rz * normals[e, 0, 2]
    out1 = rx * normals[e, 1, 0] + ry * normals[e, 1, 1] + rz * normals[e, 1, 2]
    if out0 <= 1e-9 and out1 <= 1e-9:
        return -1.0, hint
    sx, sy, sz = source[0] - ox, source[1] - oy, source[2] - oz
    a_t = sx * ux + sy * uy + sz * uz
    a_r = rx * ux + ry * uy + rz * uz
    rho_t = math.sqrt(max(sx * sx + sy * sy + sz * sz - a_t * a_t, 1e-12))
    rho_r = math.sqrt(max(rx * rx + ry * ry + rz * rz - a_r * a_r, 1e-12))
    at = a_t + (a_r - a_t) * rho_t / (rho_t + rho_r)
    seen = False
    for i in range(found[e]):
        seen |= windows[e, i, 0] <= at <= windows[e, i, 1]
    if not seen:
        return -1.0, hint
    wall = blocker(
        ox + at * ux, oy + at * uy, oz + at * uz, x, y, z, hint, walls, first, listed, tallest,
        frame, ground,
    )  # fmt: skip
    return (at, hint) if wall == -1 else (-1.0, wall)


@numba.njit(cache=True, nogil=True)
def _place(e, x, y, z, source, origin, along):
    """Place on the line of edge ``e`` at which a ray diffracts to a point."""
    a_t, a_r, t2, r2 = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        a_t += (source[i] - origin[e, i]) * along[e, i]
        t2 += (source[i] - origin[e, i]) ** 2
    for i, p in enumerate((x, y, z)):
        a_r += (p - origin[e, i]) * along[e, i]
        r2 += (p - origin[e, i]) ** 2
    rho_t, rho_r = math.sqrt(max(t2 - a_t * a_t, 1e-12)), math.sqrt(max(r2 - a_r * a_r, 1e-12))
    return a_t + (a_r - a_t) * rho_t / (rho_t + rho_r)


@numba.njit(cache=True, nogil=True)
def _power(
    e, at, x, y, z, source, origin, along, normals, materials, theory, field, pattern, slabs,
    e_in, e_out, incoming, outgoing,
):  # fmt: skip
    """Power at a point by way of edge ``e``, over that of free space at 1 m, and roughly how
    far the point is from a boundary of light."""
    qx, qy = origin[e, 0] + at * along[e, 0], origin[e, 1] + at * along[e, 1]
    qz = origin[e, 2] + at * along[e, 2]
    ix, iy, iz = qx - source[0], qy - source[1], qz - source[2]
    near = math.sqrt(ix * ix + iy * iy + iz * iz)
    wx, wy, wz = x - qx, y - qy, z - qz
    far = math.sqrt(wx * wx + wy * wy + wz * wz)
    if near < _NEAREST_M or far < _NEAREST_M:
        return 0.0, FAR
    incoming[0], incoming[1], incoming[2] = ix / near, iy / near, iz / near
    outgoing[0], outgoing[1], outgoing[2] = wx / far, wy / far, wz / far
    flat = math.hypot(incoming[0], incoming[1])
    if flat < 1e-9:
        cx, cy = 1.0, 0.0
    else:
        cx, cy = incoming[0] / flat, incoming[1] / flat
    e_in[0] = -field[0] * incoming[2] * cx - field[1] * cy
    e_in[1] = -field[0] * incoming[2] * cy + field[1] * cx
    e_in[2] = field[0] * flat
    apart = diffracted(
        incoming, outgoing, along[e], normals[e], near, far, theory, materials[e], e_in, slabs,
        e_out,
    )  # fmt: skip
    if apart < 0.0:
        return 0.0, FAR
    power = 0.0
    for i in range(3):
        power += e_out[i].real * e_out[i].real + e_out[i].imag * e_out[i].imag
    if len(pattern):
        power *= amplitude(pattern, math.atan2(iy, ix), incoming[2]) ** 2
    return power, apart * far


@numba.njit(cache=True, nogil=True)
def _part(e, west, south, z, side, points, source, edges, windows, found, physics, world, scratch):
    """Mean power of a cell of which a part is lit, 0 if no place of two lattices is."""
    origin, along, normals, materials = edges
    theory, field, pattern, slabs = physics
    walls, _owner, first, listed, tallest, frame, ground = world
    e_in, e_out, incoming, outgoing = scratch
    hint = -1
    lit = np.empty(4 * points * points)
    for half in (points, 2 * points):
        total, hits = 0.0, 0
        for part in range(4):
            mean_x, mean_y, count = 0.0, 0.0, 0
            for a in range(half):
                for b in range(half):
                    x = west + ((part % 2) * half + b + 0.5) / (2 * half) * side
                    y = south + ((part // 2) * half + a + 0.5) / (2 * half) * side
                    at, hint = _reached(
                        e, x, y, z, hint, source, origin, along, normals, windows, found, walls,
                        first, listed, tallest, frame, ground,
                    )  # fmt: skip
                    lit[a * half + b] = at
                    if at >= 0.0:
                        mean_x += x
                        mean_y += y
                        count += 1
            if count == 0:
                continue
            hits += count
            x, y = mean_x / count, mean_y / count
            at = _place(e, x, y, z, source, origin, along)
            power, apart = _power(
                e, at, x, y, z, source, origin, along, normals, materials, theory, field, pattern,
                slabs, e_in, e_out, incoming, outgoing,
            )  # fmt: skip
            if apart > _SMOOTH * points * side:
                total += power * count
                continue
            # so near to a boundary of light the mean place does not stand for the others
            for a in range(half):
                for b in range(half):
                    x = west + ((part % 2) * half + b + 0.5) / (2 * half) * side
                    y = south + ((part // 2) * half + a + 0.5) / (2 * half) * side
                    at = lit[a * half + b]
                    if at >= 0.0:
                        power, apart = _power(
                            e, at, x, y, z, source, origin, along, normals, materials, theory,
                            field, pattern, slabs, e_in, e_out, incoming, outgoing,
                        )  # fmt: skip
                        total += power
        if hits > 0:
            return total / (4 * half * half)
    return 0.0


@numba.njit(cache=True, nogil=True)
def diffract_edges(
    begin,
    end,
    step,
    source,
    edges,
    windows,
    found,
    physics,
    altitudes,
    indoors,
    walled,
    lattice,
    nodes,
    world,
    out,
):
    """Add the power diffracted by edges ``begin``, ``begin + step``, … to ``out``.

    ``out`` is ``[altitude, row, col]``. A cell whose middle and neighbours all see the edge is
    taken at its middle, or near a boundary of light at the ``nodes[0]`` with the weights
    ``nodes[1]`` of Gauss in both directions. Where some do and some do not, or ``walled`` says
    that a wall runs through it, a lattice of twice as many places finds its lit part; where that
    is found beside a dark middle the search goes on with the neighbours, along beams narrower
    than a cell. Cells that are ``indoors`` are left out.
    """
    # tuples of arrays are taken apart here: in the loops that would cost more than the work
    origin, along, normals, materials = edges
    theory, field, pattern, slabs = physics
    walls, _owner, first, listed, tallest, frame, ground = world
    e_in, e_out = np.empty(3, dtype=np.complex128), np.empty(3, dtype=np.complex128)
    incoming, outgoing = np.empty(3), np.empty(3)
    scratch = (e_in, e_out, incoming, outgoing)
    rows, cols = out.shape[1], out.shape[2]
    relief, off_r, off_c = len(ground) > 0, int(frame[3]), int(frame[4])
    corner_x, corner_y, side = lattice
    points = nodes.shape[1]
    sees = np.empty((rows, cols))
    visited = np.empty((rows, cols), dtype=np.bool_)
    queue = np.empty(rows * cols, dtype=np.int64)
    for e in range(begin, end, step):
        if found[e] == 0:
            continue
        for j in range(len(altitudes)):
            any_seen, hint = False, -1
            for row in range(rows):
                for col in range(cols):
                    sees[row, col] = _INDOORS
                    if not indoors[j, row, col]:
                        x, y = corner_x + (col + 0.5) * side, corner_y + (row + 0.5) * side
                        z = altitudes[j] + (ground[row + off_r, col + off_c] if relief else 0.0)
                        at, hint = _reached(
                            e, x, y, z, hint, source, origin, along, normals, windows, found, walls,
                            first, listed, tallest, frame, ground,
                        )  # fmt: skip
                        sees[row, col] = at
                        any_seen |= at >= 0.0
            if not any_seen:
                continue
            waiting = 0
            for row in range(rows):
                for col in range(cols):
                    visited[row, col] = indoors[j, row, col]
                    if indoors[j, row, col]:
                        continue
                    lit, dark = 0, 0
                    for a in range(max(row - 1, 0), min(row + 2, rows)):
                        for b in range(max(col - 1, 0), min(col + 2, cols)):
                            lit += sees[a, b] >= 0.0
                            dark += sees[a, b] == -1.0
                    if lit == 0:
                        continue
                    visited[row, col] = True
                    if dark > 0 or walled[j, row, col]:
                        queue[waiting] = row * cols + col
                        waiting += 1
                        continue
                    x, y = corner_x + (col + 0.5) * side, corner_y + (row + 0.5) * side
                    z = altitudes[j] + (ground[row + off_r, col + off_c] if relief else 0.0)
                    power, apart = _power(
                        e, sees[row, col], x, y, z, source, origin, along, normals, materials,
                        theory, field, pattern, slabs, e_in, e_out, incoming, outgoing,
                    )  # fmt: skip
                    if apart < _SMOOTH * points * side:
                        power = 0.0
                        parts = 2 if apart < _STEEP * side else 1
                        for a in range(points * parts):
                            py = (2 * (a // points) + 1 + nodes[0, a % points]) / parts - 1.0
                            for b in range(points * parts):
                                px = (2 * (b // points) + 1 + nodes[0, b % points]) / parts - 1.0
                                px, qy = x + 0.5 * px * side, y + 0.5 * py * side
                                at = _place(e, px, qy, z, source, origin, along)
                                more, apart = _power(
                                    e, at, px, qy, z, source, origin, along, normals, materials,
                                    theory, field, pattern, slabs, e_in, e_out, incoming,
                                    outgoing,
                                )  # fmt: skip
                                weight = nodes[1, a % points] * nodes[1, b % points]
                                power += 0.25 * weight / (parts * parts) * more
                    out[j, row, col] += power
            done = 0
            while done < waiting:
                row, col = queue[done] // cols, queue[done] % cols
                done += 1
                west, south = corner_x + col * side, corner_y + row * side
                z = altitudes[j] + (ground[row + off_r, col + off_c] if relief else 0.0)
                power = _part(
                    e, west, south, z, side, points, source, edges, windows, found, physics, world,
                    scratch,
                )  # fmt: skip
                out[j, row, col] += power
                if power > 0.0 and sees[row, col] < 0.0:
                    for a in range(max(row - 1, 0), min(row + 2, rows)):
                        for b in range(max(col - 1, 0), min(col + 2, cols)):
                            if not visited[a, b]:
                                visited[a, b] = True
                                queue[waiting] = a * cols + b
                                waiting += 1


@numba.njit(cache=True, nogil=True)
def walled_cells(altitudes, shape, world):
    """``[altitude, row, col]`` cells with a wall as high as the altitude in them."""
    walls, _owner, first, listed, tallest, frame, ground = world
    found = np.zeros(shape, dtype=np.bool_)
    cols = tallest.shape[1]
    for j in range(shape[0]):
        for row in range(shape[1]):
            for col in range(shape[2]):
                r, c = row + int(frame[3]), col + int(frame[4])
                cell = r * cols + c
                z = altitudes[j] + (ground[r, c] if len(ground) else 0.0)
                for k in range(first[cell], first[cell + 1]):
                    wall = walls[listed[k]]
                    found[j, row, col] |= wall[6] < z < wall[7]
    return found
