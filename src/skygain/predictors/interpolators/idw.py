"""Inverse distance weighting (Shepard 1968): the mean of all readings, weighted by distance to the
power −p."""

from __future__ import annotations

__all__ = ["IdwPredictor"]

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from skygain.fields.offset_sum import OffsetSum
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.predictors.interpolators.interpolation import Interpolator
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]


@cache
def inverse_distance_sum(grid: Grid, power: float) -> OffsetSum:
    """Sums weighted by d^(−power) at every cell of ``grid``; a cell has no weight in its own
    sum."""
    rows, cols = np.ogrid[: grid.shape[0], : grid.shape[1]]
    square = (rows**2 + cols**2).astype(float)
    square[0, 0] = np.inf
    return OffsetSum(square ** (-power / 2))


@dataclass(frozen=True)
class IdwPredictor(Interpolator):
    """μ(q) = Σᵢ d(q, qᵢ)^(−p) yᵢ / Σᵢ d(q, qᵢ)^(−p); exact at measured cells.

    Raises:
        InputError: a power outside (0, 4].
    """

    power: float = 2.0
    """p"""

    def __post_init__(self) -> None:
        if not 0 < self.power <= 4:
            raise InputError(
                f"the power of inverse distance weighting must lie in (0, 4], got {self.power:g}; "
                "2 is usual"
            )

    def estimate(self, scenario: Scenario, readings: Readings) -> Array:
        middle = readings.gain_db.mean()  # small numbers keep the rounding of the transforms small
        weights = np.stack([np.ones(len(readings)), readings.gain_db - middle])
        total, weighted = inverse_distance_sum(scenario.grid, self.power)(weights, readings.cells)
        # A map's only reading has no weight in its own cell; there the sum is rounding noise.
        return middle + np.divide(weighted, total, out=np.zeros_like(total), where=total > 1e-12)

    def left_out(self, distance_m: Array, xy_m: Array, target_xy_m: Array, gain_db: Array) -> Array:
        weight = distance_m**-self.power
        return weight @ gain_db / weight.sum(axis=1)
