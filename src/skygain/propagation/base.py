"""What every propagation model shares: the result, the checks on what comes in, and Friis'
wavelength."""

from __future__ import annotations

__all__ = [
    "SPEED_OF_LIGHT_M_S",
    "check_altitudes",
    "check_frequency",
    "check_transmitters",
    "wavelength_m",
]

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.ground.errors import InputError
from skygain.scenario import check_transmitter

SPEED_OF_LIGHT_M_S = 299_792_458.0
"""speed of light in vacuum"""


def wavelength_m(frequency_hz: float) -> float:
    """Wavelength in vacuum."""
    return SPEED_OF_LIGHT_M_S / frequency_hz


def check_frequency(frequency_hz: float) -> float:
    """The frequency, if it is a positive number; `InputError` otherwise."""
    if not (np.isfinite(frequency_hz) and frequency_hz > 0):
        raise InputError(
            f"frequency_hz must be a positive number, got {frequency_hz}; give hertz, for example "
            "5e9"
        )
    return float(frequency_hz)


def check_transmitters(city: City, transmitters_m: ArrayLike) -> NDArray[np.float64]:
    """The transmitters as ``[transmitter, (x, y, z)]``; a single position is taken as one
    transmitter.

    Raises:
        InputError: not positions, not finite, below the ground or inside a building.
    """
    positions = np.atleast_2d(np.asarray(transmitters_m, dtype=float))
    if positions.ndim != 2 or positions.shape[1] != 3 or len(positions) == 0:
        raise InputError(
            "transmitters must be [transmitter, (x, y, z)] in metres, got the shape "
            f"{positions.shape}; give x, y and z"
        )
    for position in positions:
        check_transmitter(city, tuple(float(v) for v in position))  # type: ignore[arg-type]
        if position[2] <= 0:
            raise InputError(
                f"a transmitter must be above the street, got z = {position[2]:g} m; give its "
                "height, for example 1.5"
            )
    return positions


def check_altitudes(altitudes_m: Sequence[float] | float) -> NDArray[np.float64]:
    """The altitudes as ``[altitude]``, if each is a positive number; `InputError` otherwise."""
    altitudes = np.atleast_1d(np.asarray(altitudes_m, dtype=float))
    if (
        altitudes.ndim != 1
        or len(altitudes) == 0
        or not (np.isfinite(altitudes) & (altitudes > 0)).all()
    ):
        raise InputError(
            f"altitudes must be positive metres above the street, got {altitudes_m}; give for "
            "example 10,20,30"
        )
    return altitudes
