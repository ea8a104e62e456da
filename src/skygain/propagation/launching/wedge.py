"""Diffraction at a wedge of finite conductivity by the uniform theory of diffraction.

The four terms of Kouyoumjian and Pathak, weighted by the reflections at the two faces as Holm
does, with angles chosen so that both directions of a path give the same; docs/propagation.md has
the equations.
"""

from __future__ import annotations

__all__ = [
    "angle_of",
    "approached",
    "coefficient",
    "diffracted",
    "no_theory",
    "transition_table",
    "turned",
]

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import modfresnelp

from skygain.propagation.launching.compiled import inner
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


@inner
def _quotient(root: float, table: NDArray[np.complex128]) -> complex:
    """F(x)/√x at the given √x."""
    if root >= _UP_TO:
        x = root * root
        y = 1.0 / x
        return _scaled(complex(1.0 - 0.75 * y * y, 0.5 * y - 1.875 * y * y * y), 1.0 / root)
    place = root / _UP_TO * _STEPS
    k = min(int(place), _STEPS - 1)
    share = place - k
    return _scaled(table[k], 1.0 - share) + _scaled(table[k + 1], share)


@inner
def approached(phi_in: float, exterior: float, as_sionna: bool) -> tuple[float, ...]:
    """What `turned` needs of the ray that arrives: its angle, that of the wedge, and their sines
    and cosines."""
    n = exterior / math.pi
    return (
        exterior,
        phi_in,
        math.cos(phi_in / (2.0 * n)),
        math.sin(phi_in / (2.0 * n)),
        math.cos(0.5 * phi_in),
        math.sin(0.5 * phi_in),
        math.cos(math.pi / (2.0 * n)),
        math.sin(math.pi / (2.0 * n)),
        math.cos(exterior),
        math.sin(exterior),
        1.0 if as_sionna else 0.0,
    )


@inner
def _cot(cosine: float, sine: float, distance: float, n: float) -> float:
    """cot ψ · distance, which stays finite where the sine vanishes, for so does the distance."""
    if abs(sine) < 1e-8:
        return cosine * math.copysign(n, sine)
    return cosine * distance / sine


@inner
def turned(approach: tuple[float, ...], phi_out: float) -> tuple[float, ...]:
    """What the coefficient of a wedge needs of the angles round its edge.

    Returns how far the outgoing ray is from the nearest boundary of light or face, whether it
    goes on round the edge (1) or back (0), cot ψ √(a/2) and √(a/2) of the four terms, and the
    sines and cosines of the angles at which the two faces reflect.
    """
    exterior, phi_in, cg, sg, ch, sh, cd, sd, ce, se, as_sionna = approach
    n = exterior / math.pi
    ca, sa = math.cos(phi_out / (2.0 * n)), math.sin(phi_out / (2.0 * n))
    cb, sb = math.cos(0.5 * phi_out), math.sin(0.5 * phi_out)
    # of (φ - φ')/2n and of (φ + φ')/2n, then of half their numerators
    cm, sm, cp, sp = ca * cg + sa * sg, sa * cg - ca * sg, ca * cg - sa * sg, sa * cg + ca * sg
    hm, km, hp, kp = cb * ch + sb * sh, sb * ch - cb * sh, cb * ch - sb * sh, sb * ch + cb * sh
    minus, plus = phi_out - phi_in, phi_out + phi_in
    a1 = _distance(minus, 1.0, exterior, hm, km, ce, se)
    a2 = _distance(minus, -1.0, exterior, hm, km, ce, se)
    a3 = _distance(plus, 1.0, exterior, hp, kp, ce, se)
    a4 = _distance(plus, -1.0, exterior, hp, kp, ce, se)
    g1 = _cot(cd * cm - sd * sm, sd * cm + cd * sm, a1, n)
    g2 = _cot(cd * cm + sd * sm, sd * cm - cd * sm, a2, n)
    g3 = _cot(cd * cp - sd * sp, sd * cp + cd * sp, a3, n)
    g4 = _cot(cd * cp + sd * sp, sd * cp - cd * sp, a4, n)
    # the end nearer to a face decides the angle at which that face reflects
    forward = phi_in < phi_out
    up_in, level_in = 2.0 * sh * ch, ch * ch - sh * sh
    up_out, level_out = 2.0 * sb * cb, cb * cb - sb * sb
    # of the exterior angle less φ' and φ
    beyond_in, along_in = se * level_in - ce * up_in, ce * level_in + se * up_in
    beyond_out, along_out = se * level_out - ce * up_out, ce * level_out + se * up_out
    up_0, level_0, up_n, level_n = up_in, level_in, beyond_in, along_in
    if as_sionna == 0.0 and forward:
        up_n, level_n = beyond_out, -along_out
    elif as_sionna == 0.0:
        up_0, level_0 = up_out, -level_out
    apart = min(2.0 * min(a1, a2, a3, a4), phi_out, exterior - phi_out)
    way = 1.0 if forward else 0.0
    return (apart, way, g1, a1, g2, a2, g3, a3, g4, a4, up_0, level_0, up_n, level_n)


@inner
def _distance(
    beta: float, sign: float, exterior: float, half: float, other: float, ce: float, se: float
) -> float:
    """|cos(π n N - β/2)| with the cosine and sine of β/2, N the whole turns nearest."""
    turns = math.floor((beta + sign * math.pi) / (2.0 * exterior) + 0.5)
    if turns == 0.0:
        return abs(half)
    if turns == 1.0:
        return abs(ce * half + se * other)
    return abs(ce * half - se * other)


@inner
def coefficient(turns, approach, theory, kl, cosine, sine, material, slabs, in_a, in_b):
    """D of a field across the edge and along it, but for -1/(2 n √(2 π k) sin β)."""
    _apart, way, g1, a1, g2, a2, g3, a3, g4, a4, up_0, level_0, up_n, level_n = turns
    root = math.sqrt(2.0 * kl)
    table = theory[1]
    d1 = _scaled(_quotient(root * a1, table), root * g1)
    d2 = _scaled(_quotient(root * a2, table), root * g2)
    d3 = _scaled(_quotient(root * a3, table), root * g3)
    d4 = _scaled(_quotient(root * a4, table), root * g4)
    a0, b0 = _mirrored(up_0, level_0, cosine, sine, material, slabs, in_a, in_b)
    if theory[2]:
        # the second face reflects where it is lit, and is perfect where it is not
        an, bn = in_a, in_b
        if approach[0] <= math.pi + approach[1]:
            an, bn = _mirrored(up_n, level_n, -cosine, sine, material, slabs, in_a, in_b)
        return (d1 - d4) * a0 + (d2 - d3) * an, (d1 - d4) * b0 + (d2 - d3) * bn
    an, bn = _mirrored(up_n, level_n, -cosine, sine, material, slabs, in_a, in_b)
    if way == 1.0:
        a, b = _mirrored(up_n, level_n, -cosine, sine, material, slabs, a0, b0)
        sum_a, sum_b = d1 * a + d2 * in_a, d1 * b + d2 * in_b
    else:
        a, b = _mirrored(up_0, level_0, cosine, sine, material, slabs, an, bn)
        sum_a, sum_b = d1 * in_a + d2 * a, d1 * in_b + d2 * b
    return sum_a + d4 * a0 + d3 * an, sum_b + d4 * b0 + d3 * bn


@inner
def _scaled(z: complex, factor: float) -> complex:
    """z times a real number, in two products instead of four."""
    return complex(z.real * factor, z.imag * factor)


@inner
def angle_of(x: float, y: float) -> float:
    angle = math.atan2(y, x)
    return angle if angle >= 0.0 else angle + 2.0 * math.pi


@inner
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
    wave_number, _table, as_sionna = theory
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
    cosine = incoming[0] * ex + incoming[1] * ey + incoming[2] * ez
    sine2 = max(1.0 - cosine * cosine, 1e-12)
    sine = math.sqrt(sine2)
    phi_in = angle_of(
        -(incoming[0] * tx + incoming[1] * ty + incoming[2] * tz),
        -(incoming[0] * n0[0] + incoming[1] * n0[1] + incoming[2] * n0[2]),
    )
    phi_out = angle_of(
        outgoing[0] * tx + outgoing[1] * ty + outgoing[2] * tz,
        outgoing[0] * n0[0] + outgoing[1] * n0[1] + outgoing[2] * n0[2],
    )
    if phi_out > exterior + 1e-9:
        return -1.0
    kl = wave_number * sine2 * near * far / (near + far)
    approach = approached(phi_in, exterior, as_sionna)
    turns = turned(approach, phi_out)
    scale = -0.5 * math.pi / (exterior * math.sqrt(2.0 * math.pi * wave_number) * sine)
    scale /= math.sqrt(near * far * (near + far))

    # the field across the edge and along it, in a basis that a straight ray keeps
    ax, ay, az = _cross(incoming[0], incoming[1], incoming[2], ex, ey, ez)
    ax, ay, az = ax / sine, ay / sine, az / sine
    bx, by, bz = _cross(incoming[0], incoming[1], incoming[2], ax, ay, az)
    in_a = e_in[0] * ax + e_in[1] * ay + e_in[2] * az
    in_b = e_in[0] * bx + e_in[1] * by + e_in[2] * bz
    sum_a, sum_b = coefficient(
        turns, approach, theory, kl, cosine, sine, material, slabs, in_a, in_b
    )
    # the same components across the outgoing ray
    ax, ay, az = _cross(outgoing[0], outgoing[1], outgoing[2], ex, ey, ez)
    size = math.sqrt(max(ax * ax + ay * ay + az * az, 1e-18))
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = _cross(outgoing[0], outgoing[1], outgoing[2], ax, ay, az)
    e_out[0] = scale * (sum_a * ax + sum_b * bx)
    e_out[1] = scale * (sum_a * ay + sum_b * by)
    e_out[2] = scale * (sum_a * az + sum_b * bz)
    return turns[0]


@inner
def _cross(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inner
def _mirrored(up, level, cosine, sine, material, slabs, in_a, in_b):
    """The field that a face reflects: its components across the edge and along it.

    ``up`` and ``level`` are the sine and the cosine of the angle round the edge from the face to
    where the ray comes from, ``cosine`` and ``sine`` belong to the angle between ray and edge. A
    face that is not lit (``up`` of 0 or less) reflects as at grazing incidence.
    """
    up = max(up, 0.0)
    te, tm = coefficients(slabs, material, sine * up)
    c, s = 0.0, 1.0
    if up > 0.0:
        # the plane of incidence, turned about the ray
        size = 1.0 / math.sqrt(max(1.0 - sine * sine * up * up, 1e-18))
        c, s = up * cosine * size, -level * size
    mixed = _scaled(te + tm, c * s)
    return (
        (_scaled(tm, s * s) - _scaled(te, c * c)) * in_a + mixed * in_b,
        (_scaled(te, s * s) - _scaled(tm, c * c)) * in_b - mixed * in_a,
    )
