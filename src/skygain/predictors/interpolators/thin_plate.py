"""Thin plate splines (Duchon 1977): the smoothest surface through the readings, with the error that
this notion implies.

The spline is Kriging with the generalised covariance s²(K(d) + λ·1[d = 0]), K(d) = d² log d, around
a plane of unknown coefficients. With [W, c] the solution of

    | K + λI + N/s²   P | |W|   |y|
    | Pᵀ              0 | |c| = |0|,    P = (1, x, y),

the mean is Σᵢ Wᵢ K(q − qᵢ) + cᵀ(1, x, y), and the variance is that of universal Kriging. The
roughness λ and the scale s² have the
largest restricted likelihood. λ belongs to the field, as the nugget of the Kriging predictors does:
measured cells keep their readings. Far outside the measured area plane and variance grow without
limit; that is the method's nature and is left as it is. Before three readings lie off one line
there is no plane, and inverse distance weighting stands in.
"""

from __future__ import annotations

__all__ = ["ThinPlatePredictor"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve, null_space
from scipy.optimize import minimize_scalar

from skygain.predictors.interpolators.idw import IdwPredictor
from skygain.predictors.interpolators.interpolation import ReadingsPredictor
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]

CHUNK = 2048
"""cells predicted at a time, which bounds the memory"""
ROUGHNESS = (1e-8, 1e2)
"""between which λ is sought, in units of the squared extent of the readings"""
ON_A_LINE = 1e-3
"""width over length below which readings count as lying on a line"""


def kernel(first: Array, second: Array) -> Array:
    """d² log d, 0 at d = 0."""
    square = ((first[:, None] - second[None]) ** 2).sum(axis=-1)
    return 0.5 * square * np.log(np.where(square > 0, square, 1.0))


def plane(xy: Array) -> Array:
    return np.column_stack([np.ones(len(xy)), xy])


def roughness_and_scale(K: Array, P: Array, y: Array) -> tuple[float, float]:
    """λ and s² of largest restricted likelihood: that of the contrasts Zᵀy ~ N(0, s²(ZᵀKZ + λI)),
    which no plane changes."""
    Z = null_space(P.T)
    values, vectors = np.linalg.eigh(Z.T @ K @ Z)
    square = (vectors.T @ (Z.T @ y)) ** 2
    values = np.maximum(values, 0.0)

    def loss(log_roughness: float) -> float:
        spectrum = values + np.exp(log_roughness)
        return float(
            len(square) * np.log((square / spectrum).sum() + 1e-300) + np.log(spectrum).sum()
        )

    found = minimize_scalar(loss, bounds=np.log(ROUGHNESS), method="bounded")
    roughness = float(np.exp(found.x))
    return roughness, float((square / (values + roughness)).mean())


@dataclass(frozen=True)
class ThinPlatePredictor(ReadingsPredictor):
    """Thin plate spline with restricted-likelihood smoothing; exact at measured cells."""

    def memory_bytes(self, cells: int, readings: int) -> float:
        """A chunk's kernels and their solutions."""
        return super().memory_bytes(cells, readings) + 64.0 * CHUNK * readings

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        grid = scenario.grid
        everywhere = grid.xy_m(grid.cells)
        xy = everywhere[readings.cells]
        spread = (
            np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False) if len(xy) > 3 else np.zeros(2)
        )
        if len(xy) <= 3 or spread[1] < ON_A_LINE * spread[0]:
            return IdwPredictor().predict(scenario, readings)
        # Lengths in units of the readings' extent and gains about their mean keep the equations
        # well scaled.
        extent, middle, level = (
            spread[0] / np.sqrt(len(xy)),
            xy.mean(axis=0),
            readings.gain_db.mean(),
        )
        xy, everywhere = (xy - middle) / extent, (everywhere - middle) / extent
        y, K, P = readings.gain_db - level, kernel(xy, xy), plane(xy)
        roughness, scale = roughness_and_scale(K, P, y)
        scale = max(scale, 1e-12)

        v = len(xy)
        system = np.zeros((v + 3, v + 3))
        system[:v, :v] = K + np.diag(roughness + readings.noise_db2 / scale)
        system[:v, v:], system[v:, :v] = P, P.T
        factor = lu_factor(system, overwrite_a=True, check_finite=False)
        weights = lu_solve(factor, np.append(y, np.zeros(3)), check_finite=False)
        mean, variance = np.empty(grid.size), np.empty(grid.size)
        for first in range(0, grid.size, CHUNK):
            part = slice(first, first + CHUNK)
            right = np.concatenate([kernel(xy, everywhere[part]), plane(everywhere[part]).T])
            mean[part] = weights @ right
            variance[part] = roughness - np.einsum(
                "vp,vp->p", right, lu_solve(factor, right, check_finite=False)
            )
        return level + mean, scale * np.maximum(variance, 0.0)
