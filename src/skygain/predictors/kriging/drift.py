"""Kriging around the map of another method, moved and scaled to the readings.

A map m(q) with standard deviations s(q) says what shape the gain has. The gain is taken to be

    y(q) = θ₁ + θ₂ m(q) + s(q) ε(q),

with an unknown level θ₁, a slope θ₂ near 1, and ε a field with exponential covariance whose scale,
range and nugget are fitted to the readings (`skygain.predictors.kriging.survey_fit`). So a map of
another simulator, antenna or power is still of use, and one that is of none is found out: the
slope falls and the scale grows. It is Kriging of y/s with the columns 1/s and m/s.
"""

from __future__ import annotations

__all__ = ["DRIFT_PARAMETERS", "DriftKriging"]

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skygain.posterior import GaussianProcessPosterior
from skygain.predictors.interpolators.readings import Readings, combined
from skygain.predictors.kriging.parameters import FLAT_DB2, KrigingParameters
from skygain.predictors.kriging.state import KrigingState
from skygain.predictors.kriging.survey_fit import fit_rows, map_estimate
from skygain.predictors.kriging.trend import FixedTrend
from skygain.scenario import Scenario

Array = NDArray[np.float64]
Flat = NDArray[np.int64]

SLOPE_STD = 0.25
"""of the prior of the slope about 1"""
LEAST_STD_DB = 2.0
"""smallest standard deviation that residuals are divided by"""
DRIFT_PARAMETERS = KrigingParameters(
    trend=(0.0, 1.0),
    trend_covariance=((FLAT_DB2, 0.0), (0.0, SLOPE_STD**2)),
    sill_db2=0.6,
    range_m=30.0,
    nugget_db2=0.1,
    log_spread=(4.0, 2.0, 4.0),
)
"""where the fit of ε starts"""


@dataclass(frozen=True, eq=False)
class DriftKriging:
    """Kriging in one survey around one map. Immutable; `updated` returns the grown one."""

    scenario: Scenario
    """of the survey"""
    std_db: tuple[Array, Array]
    """``[P]`` s where the UAVs fly, and where the gain is predicted"""
    state: KrigingState
    """of y/s"""

    @classmethod
    def around(
        cls,
        scenario: Scenario,
        flown: tuple[Array, Array],
        predicted: tuple[Array, Array],
        readings: Readings,
    ) -> DriftKriging:
        """Fitted to ``readings``, which it holds; the maps are (mean, standard deviation), each
        ``[P]``, where the UAVs fly and where the gain is predicted."""
        level = float(predicted[0].mean())
        std = tuple(np.maximum(s, LEAST_STD_DB) for _, s in (flown, predicted))
        columns = [
            np.column_stack([1 / s, (m - level) / s])
            for (m, _), s in zip((flown, predicted), std, strict=True)
        ]
        rows = fit_rows(scenario.grid, readings.cells)
        cells = readings.cells[rows]
        xy = scenario.grid.xy_m(scenario.grid.cells[cells])
        scale = std[0][cells]
        parameters = replace(DRIFT_PARAMETERS, trend=(level, 1.0))
        _, parameters = map_estimate(
            parameters,
            np.linalg.norm(xy[:, None] - xy[None], axis=-1),
            readings.gain_db[rows] / scale,
            readings.noise_db2[rows] / scale**2,
            columns[0][cells],
        )
        trend = FixedTrend.unobserved(columns[0], columns[1], parameters)
        begun = cls(
            scenario, (std[0], std[1]), KrigingState.unobserved(scenario, parameters, trend)
        )
        return begun.updated(readings)

    def updated(self, readings: Readings) -> DriftKriging:
        """With readings at distinct cells."""
        scale = self.std_db[0][readings.cells]
        scaled = Readings(readings.cells, readings.gain_db / scale, readings.noise_db2 / scale**2)
        return replace(self, state=self.state.with_readings(scaled))

    def with_floor_reading(self, cell: int, floor_db: float, noise_db2: float) -> DriftKriging:
        """With a reading that says "this or less"."""
        scale = float(self.std_db[0][cell])
        state = self.state.with_floor_reading(cell, floor_db / scale, noise_db2 / scale**2)
        return replace(self, state=state)

    def readings(self) -> Readings:
        """All that was taken in, one per cell."""
        cells = self.state.process.cells
        scale = self.std_db[0][cells]
        return combined(cells, self.state.gain_db * scale, self.state.process.noise_db2 * scale**2)

    def posterior(self) -> GaussianProcessPosterior:
        """What is believed of the gain."""
        grid, state, std = self.scenario.grid, self.state, self.std_db[1]

        def covariance(cells: NDArray[np.int64], others: NDArray[np.int64]) -> Array:
            first = grid.flat(cells)
            second = first if cells is others else grid.flat(others)
            return state.covariance(first, second) * np.outer(std[first], std[second])

        mean, variance = state.moments()
        mean, variance = mean * std, variance * std**2
        return GaussianProcessPosterior(
            mean.reshape(grid.shape), variance.reshape(grid.shape), covariance
        )
