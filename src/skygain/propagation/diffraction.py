"""Over-rooftop diffraction: the gain of the path that climbs over the buildings, for every cell of
the map.

Rays with three reflections and one diffraction leave most of a city dark, while a real receiver
there still hears what passes over the roofs. This module computes that term from the vertical
profile between transmitter and cell, with the Bullington construction of Recommendation ITU-R
P.526-15, section 4.5.1: all obstacles are replaced by one knife edge where the horizon rays of the
two ends meet. With profile heights h_i at distance d_i of d (curved by the effective Earth radius),
slopes S_tim and S_rim of those rays and the diffraction parameter ν of the edge, the loss beyond
free space is

    L_uc = J(ν),   J(ν) = 6.9 + 20 log10(sqrt((ν − 0.1)² + 1) + ν − 0.1) for ν > −0.78, else 0
    L_b  = L_uc + (1 − exp(−L_uc / 6)) (10 + 0.02 d),   d in kilometres

and the gain is −(free-space loss + L_b), with the slant distance in the free-space loss. The
profile is the city's roofs over its ground, sampled at half a cell's spacing; outside the map the
ground is empty and as high as at the nearest cell. Altitudes of both ends are above the ground
beneath them.
"""

from __future__ import annotations

__all__ = [
    "EFFECTIVE_EARTH_RADIUS_M",
    "bullington_loss_db",
    "free_space_gain_db",
    "knife_edge_loss_db",
    "over_rooftop",
    "over_rooftop_gain_db",
]

import math
from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.propagation.base import (
    check_altitudes,
    check_frequency,
    check_transmitters,
    wavelength_m,
)

EFFECTIVE_EARTH_RADIUS_M = 6_371_000.0 * 4 / 3
"""the usual 4/3 of the Earth's radius, for the median refraction of the atmosphere"""


def over_rooftop_gain_db(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    earth_radius_m: float = EFFECTIVE_EARTH_RADIUS_M,
) -> NDArray[np.float32]:
    """Gain in dB over the rooftops, ``[transmitter, altitude, row, col]``, finite everywhere.

    Inside a building the value is that of a receiver at the altitude, as if the building at the
    cell itself were not there; it means nothing.

    Args:
        city: the heights and the ground.
        transmitters_m: ``[transmitter, (x, y, z)]``, z above the ground; may lie outside the map.
        altitudes_m: heights of the receiving cells above the ground.
        frequency_hz: carrier frequency.
        earth_radius_m: effective Earth radius.

    Raises:
        InputError: a position, altitude or frequency that cannot be used.
    """
    transmitters = check_transmitters(city, transmitters_m)
    altitudes = check_altitudes(altitudes_m)
    wavelength = wavelength_m(check_frequency(frequency_hz))
    gain = np.empty((len(transmitters), len(altitudes), *city.grid.shape), dtype=np.float32)
    grid = city.grid
    # Only differences of the ground matter; level ground costs one number.
    relative = city.ground_m - city.ground_m.min()
    ground_m = np.zeros((1, 1), dtype=np.float32) if city.is_level else relative
    for i, transmitter in enumerate(transmitters):
        for j, altitude in enumerate(altitudes):
            _over_rooftop(
                city.height_m,
                ground_m,
                grid.origin_m[0],
                grid.origin_m[1],
                grid.spacing_m,
                transmitter,
                altitude,
                wavelength,
                earth_radius_m,
                gain[i, j],
            )
    return gain


def over_rooftop(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """The model ``over-rooftop``: `over_rooftop_gain_db`, whatever the seed."""
    return over_rooftop_gain_db(city, transmitters_m, altitudes_m, frequency_hz=frequency_hz)


def free_space_gain_db(distance_m: ArrayLike, frequency_hz: float = 5e9) -> NDArray[np.float64]:
    """Friis between isotropic antennas: 20 log10(λ / (4 π d)), negative in the far field."""
    return 20 * np.log10(
        wavelength_m(frequency_hz) / (4 * np.pi * np.asarray(distance_m, dtype=float))
    )


@numba.njit(cache=True)
def knife_edge_loss_db(nu: float) -> float:
    """J(ν): the loss of a single knife edge (P.526-15, equation 31), the usual approximation to the
    Fresnel integral."""
    if nu <= -0.78:
        return 0.0
    return 6.9 + 20.0 * math.log10(math.sqrt((nu - 0.1) ** 2 + 1.0) + nu - 0.1)


@numba.njit(cache=True)
def bullington_loss_db(
    heights_m: NDArray[np.float64],
    distance_m: float,
    transmitter_height_m: float,
    receiver_height_m: float,
    wavelength_m: float,
    earth_radius_m: float,
) -> float:
    """Bullington loss over free space of one profile (P.526-15, section 4.5.1).

    Args:
        heights_m: ``[point]`` heights at equal steps strictly between the ends: point i lies at (i
            + 1) d / (points + 1).
        distance_m: horizontal distance d between the ends.
        transmitter_height_m: height of one antenna above the same zero as ``heights_m``.
        receiver_height_m: height of the other.
        wavelength_m: wavelength.
        earth_radius_m: effective Earth radius; ``inf`` for a flat Earth.
    """
    points = len(heights_m)
    if points == 0 or distance_m <= 0.0:
        return 0.0
    d = distance_m
    step = d / (points + 1)
    line = (receiver_height_m - transmitter_height_m) / d
    steepest_t = -math.inf
    steepest_r = -math.inf
    nu = -math.inf
    for i in range(points):
        near = (i + 1) * step
        far = d - near
        height = heights_m[i] + near * far / (2.0 * earth_radius_m)
        steepest_t = max(steepest_t, (height - transmitter_height_m) / near)
        steepest_r = max(steepest_r, (height - receiver_height_m) / far)
        clearance = height - (transmitter_height_m * far + receiver_height_m * near) / d
        nu = max(nu, clearance * math.sqrt(2.0 * d / (wavelength_m * near * far)))
    if steepest_t >= line:
        # Beyond the horizon: one edge where the two horizon rays meet.
        near = (receiver_height_m - transmitter_height_m + steepest_r * d) / (
            steepest_t + steepest_r
        )
        far = d - near
        clearance = (
            transmitter_height_m
            + steepest_t * near
            - (transmitter_height_m * far + receiver_height_m * near) / d
        )
        nu = (
            clearance * math.sqrt(2.0 * d / (wavelength_m * near * far))
            if near > 0.0 and far > 0.0
            else 0.0
        )
    loss = knife_edge_loss_db(nu)
    return loss + (1.0 - math.exp(-loss / 6.0)) * (10.0 + 0.02 * d / 1000.0)


@numba.njit(cache=True, parallel=False)
def _over_rooftop(
    height_m: NDArray[np.float32],
    ground_m: NDArray[np.float32],
    x0_m: float,
    y0_m: float,
    spacing_m: float,
    transmitter_m: NDArray[np.float64],
    altitude_m: float,
    wavelength_m: float,
    earth_radius_m: float,
    gain_db: NDArray[np.float32],
) -> None:
    rows, cols = height_m.shape
    longest = (
        int(
            2.0
            * math.hypot(
                rows + abs(transmitter_m[1] - y0_m) / spacing_m,
                cols + abs(transmitter_m[0] - x0_m) / spacing_m,
            )
        )
        + 4
    )
    profile = np.empty(longest)
    # In units of cells, so that rounding to the nearest gives the cell.
    tx_col = (transmitter_m[0] - x0_m) / spacing_m
    tx_row = (transmitter_m[1] - y0_m) / spacing_m
    last_row, last_col = ground_m.shape[0] - 1, ground_m.shape[1] - 1
    tx_z = (
        transmitter_m[2]
        + (
            ground_m[
                min(max(math.floor(tx_row + 0.5), 0), last_row),
                min(max(math.floor(tx_col + 0.5), 0), last_col),
            ]
        )
    )
    for row in range(rows):
        for col in range(cols):
            # A roof below the receiver is an obstacle like any other; walls around a receiver
            # indoors are left out.
            own = height_m[row, col] if height_m[row, col] < altitude_m else 0.0
            street = ground_m[min(row, last_row), min(col, last_col)]
            rx_z = street + altitude_m
            across = math.hypot(row - tx_row, col - tx_col)
            distance = across * spacing_m
            points = max(math.ceil(2.0 * across) - 1, 0)
            for i in range(points):
                share = (i + 1) / (points + 1)
                r = math.floor(tx_row + share * (row - tx_row) + 0.5)
                c = math.floor(tx_col + share * (col - tx_col) + 0.5)
                inside = 0 <= r < rows and 0 <= c < cols
                if r == row and c == col:
                    profile[i] = street + own
                else:
                    beneath = ground_m[min(max(r, 0), last_row), min(max(c, 0), last_col)]
                    profile[i] = beneath + (height_m[r, c] if inside else 0.0)
            loss = bullington_loss_db(
                profile[:points],
                distance,
                tx_z,
                rx_z,
                wavelength_m,
                earth_radius_m,
            )
            slant = max(math.hypot(distance, rx_z - tx_z), wavelength_m)
            gain_db[row, col] = 20.0 * math.log10(wavelength_m / (4.0 * math.pi * slant)) - loss
