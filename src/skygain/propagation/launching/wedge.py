"""Diffraction at a wedge of finite conductivity by the uniform theory of diffraction.

The four terms of Kouyoumjian and Pathak, weighted by the reflections at the two faces as Holm
does, with angles chosen so that both directions of a path give the same; docs/propagation.md has
the equations.
"""

from __future__ import annotations

__all__ = ["diffracted", "no_theory", "transition_table"]

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import modfresnelp

from skygain.propagation.launching.fields import coefficients

_UP_TO = 6.0
"""the table reaches this far in the root of the argument; beyond it a series is exact enough"""
_STEPS = 3072


def transition_table() -> NDArray[np.complex128]:
    """F(x)/√x over √x in equal steps, F the transition function of the theory.

    The quotient stays finite at 0, where F vanishes as fast as the cotangent beside it grows.
    """
    root = np.linspace(0.0, _UP_TO, _STEPS + 1)
    tail = modfresnelp(root)[0]  # integral of exp(i t²) from the root to infinity
    return 2j * np.exp(1j * root**2) * np.conj(tail)


@numba.njit(cache=True, nogil=True)
def no_theory():
    """Stands for the ``theory`` of `diffracted` where nothing diffracts."""
    return 0.0, np.zeros(2, dtype=np.complex128), False


@numba.njit(cache=True, nogil=True)
def _quotient(root: float, table: NDArray[np.complex128]) -> complex:
    """F(x)/√x at the given √x."""
    if root >= _UP_TO:
        x = root * root
        series = complex(1.0 - 0.75 / (x * x), 0.5 / x - 1.875 / (x * x * x))
        return series / root
    place = root / _UP_TO * _STEPS
    k = min(int(place), _STEPS - 1)
    share = place - k
    return table[k] * (1.0 - share) + table[k + 1] * share


@numba.njit(cache=True, nogil=True)
def _term(
    beta: float, sign: float, n: float, kl: float, table: NDArray[np.complex128]
) -> tuple[complex, float]:
    """cot((π ± β)/2n) F(k L a±(β)), finite where the cotangent is not, and √(a/2)."""
    psi = (math.pi + sign * beta) / (2.0 * n)
    turns = math.floor((beta + sign * math.pi) / (2.0 * math.pi * n) + 0.5)
    distance = abs(math.cos(math.pi * n * turns - 0.5 * beta))
    root = math.sqrt(2.0 * kl) * distance
    sine = math.sin(psi)
    if abs(sine) < 1e-8:
        ratio = math.copysign(n * math.sqrt(2.0 * kl), sine)
    else:
        ratio = root / sine
    return math.cos(psi) * ratio * _quotient(root, table), distance


@numba.njit(cache=True, nogil=True)
def _angle(x: float, y: float) -> float:
    angle = math.atan2(y, x)
    return angle if angle >= 0.0 else angle + 2.0 * math.pi


@numba.njit(cache=True, nogil=True)
def diffracted(incoming, outgoing, edge, faces, near, far, theory, material, e_in, slabs, e_out):
    """Write the diffracted field into ``e_out``.

    Returns how far the outgoing ray is from the nearest boundary of light or face (an angle where
    it is small), or -1 if a direction lies inside the wedge.

    Args:
        incoming: unit direction of the ray that arrives.
        outgoing: unit direction of the ray that leaves, on the cone of the edge.
        edge: unit vector along the edge.
        faces: ``[2, 3]`` outward normals of the faces.
        near: length of the path to the edge.
        far: length of the path from the edge.
        theory: the wave number 2π/λ, `transition_table`, and whether to weight the terms as Sionna
            RT does.
        material: number of the material of both faces.
        e_in: incident field, three complex components.
        slabs: reflection coefficients (`skygain.propagation.launching.materials.slab_table`).
        e_out: the field is E_in D √(1/(near far (near + far))) without its phase, for a unit
            incident field at unit length; three complex components.
    """
    wave_number, table, as_sionna = theory
    i0 = incoming[0] * faces[0, 0] + incoming[1] * faces[0, 1] + incoming[2] * faces[0, 2]
    i1 = incoming[0] * faces[1, 0] + incoming[1] * faces[1, 1] + incoming[2] * faces[1, 2]
    o0 = outgoing[0] * faces[0, 0] + outgoing[1] * faces[0, 1] + outgoing[2] * faces[0, 2]
    o1 = outgoing[0] * faces[1, 0] + outgoing[1] * faces[1, 1] + outgoing[2] * faces[1, 2]
    tiny = 1e-9
    if (i0 >= -tiny and i1 >= -tiny) or (o0 <= tiny and o1 <= tiny):
        return -1.0
    # face 0 is one that the incoming ray lights
    f0, fn = (0, 1) if i0 < 0.0 else (1, 0)
    n0, nn = faces[f0], faces[fn]
    # the edge turned so that n0 × e points into face 0
    ex, ey, ez = edge[0], edge[1], edge[2]
    tx, ty, tz = _cross(n0[0], n0[1], n0[2], ex, ey, ez)
    if tx * nn[0] + ty * nn[1] + tz * nn[2] > 0.0:
        ex, ey, ez, tx, ty, tz = -ex, -ey, -ez, -tx, -ty, -tz
    inner = math.acos(min(max(-(n0[0] * nn[0] + n0[1] * nn[1] + n0[2] * nn[2]), -1.0), 1.0))
    exterior = 2.0 * math.pi - inner
    n = exterior / math.pi
    cosine = incoming[0] * ex + incoming[1] * ey + incoming[2] * ez
    sine2 = max(1.0 - cosine * cosine, 1e-12)
    sine = math.sqrt(sine2)
    phi_in = _angle(
        -(incoming[0] * tx + incoming[1] * ty + incoming[2] * tz),
        -(incoming[0] * n0[0] + incoming[1] * n0[1] + incoming[2] * n0[2]),
    )
    phi_out = _angle(
        outgoing[0] * tx + outgoing[1] * ty + outgoing[2] * tz,
        outgoing[0] * n0[0] + outgoing[1] * n0[1] + outgoing[2] * n0[2],
    )
    if phi_out > exterior + 1e-9:
        return -1.0
    kl = wave_number * sine2 * near * far / (near + far)
    minus, plus = phi_out - phi_in, phi_out + phi_in
    scale = -1.0 / (2.0 * n * math.sqrt(2.0 * math.pi * wave_number) * sine)
    scale /= math.sqrt(near * far * (near + far))
    d1, c1 = _term(minus, 1.0, n, kl, table)
    d2, c2 = _term(minus, -1.0, n, kl, table)
    d3, c3 = _term(plus, 1.0, n, kl, table)
    d4, c4 = _term(plus, -1.0, n, kl, table)

    # the field across the edge and along it, in a basis that a straight ray keeps
    ax, ay, az = _cross(incoming[0], incoming[1], incoming[2], ex, ey, ez)
    ax, ay, az = ax / sine, ay / sine, az / sine
    bx, by, bz = _cross(incoming[0], incoming[1], incoming[2], ax, ay, az)
    in_a = e_in[0] * ax + e_in[1] * ay + e_in[2] * az
    in_b = e_in[0] * bx + e_in[1] * by + e_in[2] * bz
    if as_sionna:
        a, b = _mirrored(phi_in, cosine, sine, material, slabs, in_a, in_b)
        sum_a, sum_b = (d1 - d4) * a, (d1 - d4) * b
        a, b = in_a, in_b
        if exterior <= math.pi + phi_in:
            a, b = _mirrored(exterior - phi_in, -cosine, sine, material, slabs, in_a, in_b)
        sum_a += (d2 - d3) * a
        sum_b += (d2 - d3) * b
    else:
        # the end nearer to a face decides the angle at which that face reflects
        forward = phi_in < phi_out
        at_0 = phi_in if forward else math.pi - phi_out
        at_n = exterior - phi_in if not forward else math.pi - exterior + phi_out
        a0, b0 = _mirrored(at_0, cosine, sine, material, slabs, in_a, in_b)
        an, bn = _mirrored(at_n, -cosine, sine, material, slabs, in_a, in_b)
        if forward:
            a, b = _mirrored(at_n, -cosine, sine, material, slabs, a0, b0)
            sum_a, sum_b = d1 * a + d2 * in_a, d1 * b + d2 * in_b
        else:
            a, b = _mirrored(at_0, cosine, sine, material, slabs, an, bn)
            sum_a, sum_b = d1 * in_a + d2 * a, d1 * in_b + d2 * b
        sum_a += d4 * a0 + d3 * an
        sum_b += d4 * b0 + d3 * bn
    # the same components across the outgoing ray
    ax, ay, az = _cross(outgoing[0], outgoing[1], outgoing[2], ex, ey, ez)
    size = math.sqrt(max(ax * ax + ay * ay + az * az, 1e-18))
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = _cross(outgoing[0], outgoing[1], outgoing[2], ax, ay, az)
    e_out[0] = scale * (sum_a * ax + sum_b * bx)
    e_out[1] = scale * (sum_a * ay + sum_b * by)
    e_out[2] = scale * (sum_a * az + sum_b * bz)
    return min(2.0 * min(c1, c2, c3, c4), phi_out, exterior - phi_out)


@numba.njit(cache=True, nogil=True)
def _cross(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@numba.njit(cache=True, nogil=True)
def _mirrored(angle, cosine, sine, material, slabs, in_a, in_b):
    """The field that a face reflects: its components across the edge and along it.

    ``angle`` goes round the edge from the face to where the ray comes from, ``cosine`` and
    ``sine`` belong to the angle between ray and edge. A face that is not lit reflects as at
    grazing incidence.
    """
    up = math.sin(angle) if 0.0 < angle < math.pi else 0.0
    te, tm = coefficients(slabs, material, sine * up)
    size = math.sqrt(max(1.0 - sine * sine * up * up, 1e-18))
    # the plane of incidence, turned about the ray
    c, s = up * cosine / size, -math.cos(angle) / size
    if up == 0.0:
        c, s = 0.0, 1.0
    mixed = c * s * (te + tm)
    return (
        (s * s * tm - c * c * te) * in_a + mixed * in_b,
        (s * s * te - c * c * tm) * in_b - mixed * in_a,
    )
