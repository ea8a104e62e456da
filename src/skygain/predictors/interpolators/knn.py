"""k nearest neighbours: the plain mean of the k nearest readings, the rival that every method
should beat."""

from __future__ import annotations

__all__ = ["KnnPredictor"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skygain.ground.errors import InputError
from skygain.predictors.interpolators.interpolation import Interpolator
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnnPredictor(Interpolator):
    """μ(q) = mean of the readings at the ``k`` measured cells nearest to q; a measured cell keeps
    its own reading.

    Raises:
        InputError: k < 1.
    """

    k: int = 5
    """how many readings are averaged, fewer while there are fewer"""

    def __post_init__(self) -> None:
        if self.k < 1:
            raise InputError(f"k nearest neighbours need k >= 1, got {self.k}; 5 is usual")

    def estimate(self, scenario: Scenario, readings: Readings) -> Array:
        cells = scenario.grid.cells
        k = min(self.k, len(readings))
        _, nearest = cKDTree(cells[readings.cells]).query(cells, k=np.arange(1, k + 1))
        return readings.gain_db[nearest].mean(axis=1)

    def left_out(self, distance_m: Array, xy_m: Array, target_xy_m: Array, gain_db: Array) -> Array:
        k = min(self.k, distance_m.shape[1])
        nearest = np.argpartition(distance_m, k - 1, axis=1)[:, :k]
        usable = np.isfinite(np.take_along_axis(distance_m, nearest, axis=1))
        return np.where(usable, gain_db[nearest], 0.0).sum(axis=1) / usable.sum(axis=1)
