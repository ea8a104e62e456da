"""The propagation models behind one signature, for `skygain.propagation.PROPAGATION`.

Each takes ``(city, transmitters_m, altitudes_m, *, frequency_hz, seed)`` and returns the gain in
dB, ``[transmitter, altitude, row, col]``; the two that trace rays also take the number of
``samples``. Whoever needs more than the gain (which cells a ray reached, what the guard cut) calls
the model's own module.
"""

from __future__ import annotations

__all__ = ["gudmundson", "over_rooftop", "raytrace", "union"]

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City


def raytrace(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
    samples: int | None = None,
) -> NDArray[np.float32]:
    """Rays only (`skygain.propagation.sionna`); -inf where none reached."""
    from skygain.propagation.sionna import DEFAULT_SAMPLES, trace_gain_db

    rays = DEFAULT_SAMPLES if samples is None else samples
    return trace_gain_db(
        city, transmitters_m, altitudes_m, frequency_hz=frequency_hz, seed=seed, samples=rays
    ).gain_db


def over_rooftop(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """Diffraction over the rooftops (`skygain.propagation.diffraction`); deterministic, whatever
    the seed."""
    from skygain.propagation.diffraction import over_rooftop_gain_db

    return over_rooftop_gain_db(city, transmitters_m, altitudes_m, frequency_hz=frequency_hz)


def union(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
    samples: int | None = None,
) -> NDArray[np.float32]:
    """The stronger of the two (`skygain.propagation.truth`)."""
    from skygain.propagation.sionna import DEFAULT_SAMPLES
    from skygain.propagation.truth import trace_truth

    rays = DEFAULT_SAMPLES if samples is None else samples
    return trace_truth(
        city, transmitters_m, altitudes_m, frequency_hz=frequency_hz, seed=seed, samples=rays
    ).gain_db


def gudmundson(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """Log-distance mean plus correlated log-normal shadowing (`skygain.propagation.gudmundson`).

    The mean is fitted to 5 GHz and moved to other frequencies as free space is. Shadowing is drawn
    anew for each transmitter and altitude.
    """
    from skygain.propagation.base import check_altitudes, check_frequency, check_transmitters
    from skygain.propagation.gudmundson import gudmundson_gain_db

    shift_db = -20 * np.log10(check_frequency(frequency_hz) / 5e9)
    rng = np.random.default_rng(seed)
    transmitters, altitudes = check_transmitters(city, transmitters_m), check_altitudes(altitudes_m)
    maps = [
        [gudmundson_gain_db(city.grid, tx, float(h), rng) + shift_db for h in altitudes]
        for tx in transmitters
    ]
    return np.array(maps, dtype=np.float32)
