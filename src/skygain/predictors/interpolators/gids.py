"""Gradient plus inverse distance squared (Nalder & Wein 1998), one of the interpolators the paper
names as common.

Each reading is moved along a plane fitted to all readings before the weighted mean is taken:

    μ(q) = Σᵢ wᵢ [yᵢ + C·(q − qᵢ)] / Σᵢ wᵢ,   wᵢ = d(q, qᵢ)⁻²,

with C the slope of the plane by least squares. The plane helps inside the measured area and
misleads far outside it, where it goes on rising or falling; that is the method's nature and is left
as it is. Readings on one line give the slope along it alone.
"""

from __future__ import annotations

__all__ = ["GidsPredictor"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.predictors.interpolators.idw import inverse_distance_sum
from skygain.predictors.interpolators.interpolation import Interpolator
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]

FLAT = 1e-9
"""share of the largest spread of positions below which a direction counts as not measured"""


def slopes(xy_m: Array, gain_db: Array, use: Array) -> Array:
    """``[m, (x, y)]`` slope in dB/m of the plane through the readings that ``use[m, v]`` counts (1)
    or leaves out (0)."""
    total = use.sum(axis=1)
    mean_xy, mean_gain = use @ xy_m / total[:, None], use @ gain_db / total
    square = np.einsum("mv,vi,vj->mij", use, xy_m, xy_m) - np.einsum(
        "m,mi,mj->mij", total, mean_xy, mean_xy
    )
    cross = np.einsum("mv,vi,v->mi", use, xy_m, gain_db) - (total * mean_gain)[:, None] * mean_xy
    return np.einsum("mij,mj->mi", np.linalg.pinv(square, rcond=FLAT, hermitian=True), cross)


@dataclass(frozen=True)
class GidsPredictor(Interpolator):
    """IDW of power 2 along the plane that fits the readings; exact at measured cells."""

    def estimate(self, scenario: Scenario, readings: Readings) -> Array:
        grid = scenario.grid
        xy = grid.xy_m(grid.cells)
        middle = xy[readings.cells].mean(axis=0)  # numbers about zero keep the rounding small
        here, gain = xy[readings.cells] - middle, readings.gain_db - readings.gain_db.mean()
        slope = slopes(here, gain, np.ones((1, len(readings))))[0]
        # What the plane leaves is averaged, and the plane added back: the same sum as in the
        # definition.
        weights = np.stack([np.ones(len(readings)), gain - here @ slope])
        total, weighted = inverse_distance_sum(grid, 2.0)(weights, readings.cells)
        left = np.divide(weighted, total, out=np.zeros_like(total), where=total > 1e-12)
        return readings.gain_db.mean() + left + (xy - middle) @ slope

    def left_out(self, distance_m: Array, xy_m: Array, target_xy_m: Array, gain_db: Array) -> Array:
        middle, level = xy_m.mean(axis=0), gain_db.mean()
        here, gain = xy_m - middle, gain_db - level
        slope = slopes(here, gain, np.isfinite(distance_m).astype(float))
        weight = distance_m**-2.0
        left = (weight @ gain - np.einsum("mi,mi->m", weight @ here, slope)) / weight.sum(axis=1)
        return level + left + np.einsum("mi,mi->m", target_xy_m - middle, slope)
