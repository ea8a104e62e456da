"""The truth that surveys are simulated on: the stronger of the launched gain and the gain over
the rooftops.

With up to three reflections or one diffraction, rays reach only a part of a city's outdoor cells,
and a map with holes cannot be surveyed. The path over the rooftops is physical, exists everywhere
and fills them; where both exist the stronger one is what a receiver would hear. Both use the same
cells, altitudes and antennas.
"""

from __future__ import annotations

__all__ = ["RELIEF", "Truth", "trace_truth", "union"]

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.launching.launch import Launching, launch_gain_db

RELIEF = "over relief rays pass hills, walls, roofs and edges, but do not reflect at the ground"
"""what a truth over relief leaves out"""


@dataclass(frozen=True)
class Truth:
    """Gain of every cell, and where it comes from."""

    gain_db: NDArray[np.float32]
    """``[transmitter, altitude, row, col]``, finite everywhere; inside buildings it means
    nothing"""
    ray_traced: NDArray[np.bool_]
    """``[transmitter, altitude, row, col]`` whether the gain by rays is the stronger one;
    elsewhere it is the rooftop gain"""
    settings: Launching
    """how the rays were launched"""


def trace_truth(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    settings: Launching | None = None,
) -> Truth:
    """truth = max(gain by rays, over-rooftop gain) for each transmitter, altitude and cell.

    Args:
        city: where.
        transmitters_m: ``[transmitter, (x, y, z)]`` in the city's metres, z above the street.
        altitudes_m: heights of the receiving cells above the street.
        frequency_hz: carrier frequency.
        settings: how to launch the rays; their carrier is ``frequency_hz`` whatever they say.

    Raises:
        InputError: an argument that cannot be used; the message names the remedy.
    """
    settings = replace(settings or Launching(), frequency_hz=float(frequency_hz))
    rays = launch_gain_db(city, transmitters_m, altitudes_m, settings=settings)
    roof = over_rooftop_gain_db(city, transmitters_m, altitudes_m, frequency_hz=frequency_hz)
    stronger = rays.ray_reached & (rays.gain_db >= roof)
    return Truth(np.where(stronger, rays.gain_db, roof), stronger, settings)


def union(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """The model ``union``: the gain of `trace_truth`, whatever the seed."""
    return trace_truth(city, transmitters_m, altitudes_m, frequency_hz=frequency_hz).gain_db
