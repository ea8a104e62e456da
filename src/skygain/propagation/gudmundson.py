"""Log-normal shadowing after Gudmundson, for tests and for users without the ray tracer.

    gain(s) = α − β log10(d) + v(s),   v ~ N(0, φ exp(−|s − s'| / δ))

with d the distance to the transmitter in three dimensions (Gudmundson, "Correlation model for
shadow fading in mobile radio systems", 1991; the paper's Kriging kernel). The field v is drawn
exactly, not approximately, by circulant embedding: the covariance is continued periodically on a
larger torus, whose eigenvalues are one FFT away. An exponential covariance becomes a valid one on
the torus if that is large enough against δ; the torus is enlarged until no eigenvalue is negative.
"""

from __future__ import annotations

__all__ = ["gudmundson", "gudmundson_gain_db", "shadowing_db"]

from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.propagation.base import check_altitudes, check_frequency, check_transmitters

ALPHA_DB = 27.0
BETA_DB_PER_DECADE = 72.0
PHI_DB2 = 380.0
DELTA_M = 57.0
# The four are those of ray-traced Manhattan cities at 5 GHz and 10 m.

LARGEST_TORUS = 2**24
"""most cells of the torus"""


def gudmundson(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """The model ``gudmundson``: log-distance mean plus correlated log-normal shadowing.

    The mean is fitted to 5 GHz and moved to other frequencies as free space is. Shadowing is drawn
    anew for each transmitter and altitude.
    """
    shift_db = -20 * np.log10(check_frequency(frequency_hz) / 5e9)
    rng = np.random.default_rng(seed)
    transmitters, altitudes = check_transmitters(city, transmitters_m), check_altitudes(altitudes_m)
    maps = [
        [gudmundson_gain_db(city.grid, tx, float(h), rng) + shift_db for h in altitudes]
        for tx in transmitters
    ]
    return np.array(maps, dtype=np.float32)


def gudmundson_gain_db(
    where: City | Grid,
    transmitter_m: ArrayLike,
    altitude_m: float,
    rng: np.random.Generator,
    *,
    alpha_db: float = ALPHA_DB,
    beta_db_per_decade: float = BETA_DB_PER_DECADE,
    phi_db2: float = PHI_DB2,
    delta_m: float = DELTA_M,
) -> NDArray[np.float64]:
    """One random channel-gain map, ``[row, col]`` in dB.

    Args:
        where: the grid, or the city whose grid is meant; buildings have no influence.
        transmitter_m: (x, y, z).
        altitude_m: altitude of the cells, above the street as z is.
        rng: source of the shadowing.
        alpha_db: mean gain at 1 m.
        beta_db_per_decade: loss of the mean per decade of distance.
        phi_db2: variance of the shadowing.
        delta_m: distance at which its correlation has fallen to 1/e.

    Raises:
        InputError: a variance or correlation distance that is not positive, or a field that cannot
            be embedded.
    """
    grid = where.grid if isinstance(where, City) else where
    x, y, z = np.asarray(transmitter_m, dtype=float)
    across2 = (grid.x_m[None, :] - x) ** 2 + (grid.y_m[:, None] - y) ** 2
    # Closer than a metre the logarithm is no model any more.
    distance = np.maximum(np.sqrt(across2 + (altitude_m - z) ** 2), 1.0)
    return (
        alpha_db
        - beta_db_per_decade * np.log10(distance)
        + shadowing_db(grid, rng, phi_db2=phi_db2, delta_m=delta_m)
    )


def shadowing_db(
    grid: Grid, rng: np.random.Generator, *, phi_db2: float = PHI_DB2, delta_m: float = DELTA_M
) -> NDArray[np.float64]:
    """One Gaussian field ``[row, col]`` with mean 0 and covariance φ exp(−distance / δ) between
    cells.

    Raises:
        InputError: φ is negative, δ is not positive, or δ needs a torus of more than
            `LARGEST_TORUS` cells.
    """
    if not (np.isfinite(phi_db2) and phi_db2 >= 0):
        raise InputError(
            f"phi_db2 is a variance and must not be negative, got {phi_db2}; give dB², for example "
            f"{PHI_DB2:g}"
        )
    if not (np.isfinite(delta_m) and delta_m > 0):
        raise InputError(
            f"delta_m is a distance and must be positive, got {delta_m}; give metres, for example "
            f"{DELTA_M:g}"
        )
    eigenvalues = _torus_eigenvalues(grid, delta_m)
    # White complex noise filtered with the root of the spectrum: its real part is one exact draw.
    noise = rng.standard_normal((2, *eigenvalues.shape))
    spectrum = np.sqrt(eigenvalues * (phi_db2 / eigenvalues.size)) * (noise[0] + 1j * noise[1])
    field = scipy.fft.fft2(spectrum).real
    return np.ascontiguousarray(field[: grid.shape[0], : grid.shape[1]])


def _torus_eigenvalues(grid: Grid, delta_m: float) -> NDArray[np.float64]:
    """Spectrum of the covariance on the smallest torus tried that is valid; its corner of the map's
    size is exact."""
    reach = 4.0
    while True:
        # Twice the map, so that no two of its cells are nearer around the torus than across the
        # map.
        rows, cols = (
            scipy.fft.next_fast_len(max(2 * n, int(reach * delta_m / grid.spacing_m)))
            for n in grid.shape
        )
        if rows * cols > LARGEST_TORUS:
            raise InputError(
                f"a correlation distance of {delta_m:g} m is too large for cells of "
                f"{grid.spacing_m:g} m on a map of {grid.shape}; "
                "choose a smaller one or larger cells"
            )
        dy = grid.spacing_m * np.minimum(np.arange(rows), rows - np.arange(rows))
        dx = grid.spacing_m * np.minimum(np.arange(cols), cols - np.arange(cols))
        eigenvalues = scipy.fft.fft2(np.exp(-np.hypot(dy[:, None], dx[None, :]) / delta_m)).real
        if eigenvalues.min() >= -1e-9 * eigenvalues.max():
            return np.maximum(eigenvalues, 0.0)
        reach *= 1.5
