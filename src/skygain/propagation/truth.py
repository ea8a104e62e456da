"""The truth that surveys are simulated on: the stronger of the ray-traced gain and the gain over
the rooftops.

With up to three reflections or one diffraction, rays reach only a part of a city's outdoor cells,
and a map with holes cannot be surveyed. The path over the rooftops is physical, exists everywhere
and fills them; where both exist the stronger one is what a receiver would hear. Both use the same
cells, altitudes and isotropic antennas.
"""

from __future__ import annotations

__all__ = ["Truth", "trace_truth"]

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.sionna import DEFAULT_SAMPLES, RayTracing, trace_gain_db


@dataclass(frozen=True)
class Truth:
    """Gain of every cell, and where it comes from."""

    gain_db: NDArray[np.float32]
    """``[transmitter, altitude, row, col]``, finite everywhere; inside buildings it means
    nothing"""
    ray_traced: NDArray[np.bool_]
    """``[transmitter, altitude, row, col]`` whether the ray-traced gain is the stronger one;
    elsewhere it is the rooftop gain"""
    guarded: int
    """outdoor cells whose ray-traced gain was cut (see `skygain.propagation.sionna.GUARD_DB`)"""
    settings: RayTracing
    """how the rays were traced"""


def trace_truth(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    samples: int = DEFAULT_SAMPLES,
    seed: int = 0,
    threads: int = 1,
) -> Truth:
    """truth = max(ray-traced gain, over-rooftop gain) for each transmitter, altitude and cell.

    Args:
        city: where.
        transmitters_m: ``[transmitter, (x, y, z)]`` in the city's metres, z above the street.
        altitudes_m: heights of the receiving cells above the street.
        frequency_hz: carrier frequency.
        samples: rays per transmitter.
        seed: seed of the ray tracer.
        threads: processor threads of the ray tracer; with 1 the same seed gives the same bytes.

    Raises:
        InputError: an argument that cannot be used, or no usable ray tracer; the message names the
            remedy.
    """
    roof = over_rooftop_gain_db(city, transmitters_m, altitudes_m, frequency_hz=frequency_hz)
    rays = trace_gain_db(
        city,
        transmitters_m,
        altitudes_m,
        frequency_hz=frequency_hz,
        samples=samples,
        seed=seed,
        threads=threads,
    )
    stronger = rays.ray_reached & (rays.gain_db >= roof)
    return Truth(np.where(stronger, rays.gain_db, roof), stronger, rays.guarded, rays.settings)
