"""Building materials by the classes of ITU-R P.2040, and how a slab of one reflects.

A reflection coefficient depends on the angle of incidence alone once carrier and material are
chosen, so each is tabulated over its cosine.
"""

from __future__ import annotations

__all__ = ["GROUND_THICKNESS_M", "MATERIALS", "WALL_THICKNESS_M", "slab_table"]

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.propagation.base import wavelength_m

MATERIALS: dict[str, tuple[float, float, float, float]] = {
    "concrete": (5.24, 0.0, 0.0462, 0.7822),
    "brick": (3.91, 0.0, 0.0238, 0.16),
    "plasterboard": (2.73, 0.0, 0.0085, 0.9395),
    "wood": (1.99, 0.0, 0.0047, 1.0718),
    "glass": (6.31, 0.0, 0.0036, 1.3394),
    "marble": (7.074, 0.0, 0.0055, 0.9262),
    "metal": (1.0, 0.0, 1e7, 0.0),
    "asphalt": (4.83, 0.0, 0.0108, 1.3969),
    "very dry ground": (3.0, 0.0, 0.00015, 2.52),
    "medium dry ground": (15.0, -0.1, 0.035, 1.63),
    "wet ground": (30.0, -0.4, 0.15, 1.30),
}
"""class: a, b, c, d of the relative permittivity a f^b and the conductivity c f^d (f in GHz)"""

WALL_THICKNESS_M = 0.3
"""thickness of walls and roofs"""
GROUND_THICKNESS_M = 1.0
"""thickness of the ground's slab, so thick that nothing comes back from below"""

_EPSILON_0 = 8.8541878128e-12
_STEPS = 4096
"""steps of the table over the cosine of the angle of incidence"""


def slab_table(
    materials: Sequence[str], thickness_m: Sequence[float], frequency_hz: float
) -> NDArray[np.complex128]:
    """Reflection coefficients ``[material, step, (TE, TM)]`` of slabs, by ITU-R P.2040 (43).

    Step k of n belongs to the cosine k / (n - 1) of the angle of incidence.

    Raises:
        InputError: a material that is not in `MATERIALS`.
    """
    table = np.empty((len(materials), _STEPS + 1, 2), dtype=np.complex128)
    cosine = np.linspace(0.0, 1.0, _STEPS + 1)
    for i, (name, thickness) in enumerate(zip(materials, thickness_m, strict=True)):
        if name not in MATERIALS:
            known = ", ".join(MATERIALS)
            raise InputError(f"unknown material {name!r}; known: {known}")
        a, b, c, d = MATERIALS[name]
        ghz = frequency_hz / 1e9
        conductivity = c * ghz**d
        omega = 2 * np.pi * frequency_hz
        permittivity = a * ghz**b - 1j * conductivity / (omega * _EPSILON_0)
        root = np.sqrt(permittivity - (1 - cosine**2))
        there_and_back = np.exp(-2j * 2 * np.pi * thickness / wavelength_m(frequency_hz) * root)
        te = (cosine - root) / (cosine + root)
        tm = (permittivity * cosine - root) / (permittivity * cosine + root)
        for k, r in enumerate((te, tm)):
            table[i, :, k] = r * (1 - there_and_back) / (1 - r**2 * there_and_back)
    return table
