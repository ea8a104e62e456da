"""The field along a ray: reflection at walls and at the ground, in the ray's vertical plane.

A field is (E_v, E_h): E_v in the vertical plane of the ray, E_h across it. docs/propagation.md
has the equations.
"""

from __future__ import annotations

__all__ = ["at_ground", "at_wall", "coefficients"]

import numpy as np
from numpy.typing import NDArray

from skygain.propagation.launching.compiled import inner


@inner
def coefficients(
    table: NDArray[np.complex128], material: int, cosine: float
) -> tuple[complex, complex]:
    """(R_te, R_tm) of a material at the cosine of the angle of incidence, by interpolation."""
    steps = table.shape[1] - 1
    place = min(max(cosine, 0.0), 1.0) * steps
    k = min(int(place), steps - 1)
    share = place - k
    te = table[material, k, 0] * (1.0 - share) + table[material, k + 1, 0] * share
    tm = table[material, k, 1] * (1.0 - share) + table[material, k + 1, 1] * share
    return te, tm


@inner
def at_wall(
    e_v: complex,
    e_h: complex,
    sine: float,
    across: float,
    beside: float,
    te: complex,
    tm: complex,
) -> tuple[complex, complex]:
    """The field after a wall.

    ``sine`` is that of the ray's elevation, ``across`` the wall's normal along the ray's plan
    direction d, ``beside`` the normal along z × d.
    """
    a = beside * beside
    b = sine * sine * across * across
    q = a + b
    if q < 1e-14:
        return te * e_v, tm * e_h
    mixed = sine * across * beside * (te + tm)
    return (
        ((te * a - tm * b) * e_v + mixed * e_h) / q,
        ((tm * a - te * b) * e_h - mixed * e_v) / q,
    )


@inner
def at_ground(
    e_v: complex, e_h: complex, sine: float, table: NDArray[np.complex128], material: int
) -> tuple[complex, complex]:
    """The field after the ground or a roof."""
    te, tm = coefficients(table, material, abs(sine))
    return tm * e_v, te * e_h
