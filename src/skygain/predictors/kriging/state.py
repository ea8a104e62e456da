"""The state of Kriging in one survey: covariance, trend and observations, and how readings enter.

Readings at the receiver's floor say only "this or less". Each is taken in as the normal reading
that moves the belief at its cell to the mean and variance of its normal cut off at the floor
(assumed-density filtering), unless the belief already expects
a reading at the floor there, with a probability of 0.9 or more: then it is no news, and counting it
again would feign certainty.
"""

from __future__ import annotations

__all__ = ["KrigingState", "floor_reading"]

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from skygain.fields.gaussian_process import KNOWN, CellKernel, Flat, GaussianProcess
from skygain.predictors.interpolators.readings import Readings
from skygain.predictors.kriging.parameters import FLAT_DB2, KrigingParameters
from skygain.predictors.kriging.trend import Trend
from skygain.scenario import Scenario

Array = NDArray[np.float64]

EXPECTED_FLOOR = 0.9
"""a reading at the floor is left out where the belief gives it at least this probability"""
BATCH = 32
"""observations taken in at a time, which bounds the memory of one update"""


def floor_reading(
    mean_db: float, variance_db2: float, floor_db: float, noise_db2: float
) -> tuple[float, float] | None:
    """Value and noise variance of the normal reading that says what "gain plus noise is
    ``floor_db`` or less" says.

    ``None`` where the belief N(``mean_db``, ``variance_db2``) expects a reading at the floor
    anyway.
    """
    total = variance_db2 + noise_db2
    if total <= 0:
        return None
    above = (floor_db - mean_db) / np.sqrt(total)
    if ndtr(above) >= EXPECTED_FLOOR:
        return None
    hazard = np.exp(-0.5 * above**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(above))
    shrink = min(
        hazard * (hazard + above), 1 - 1e-9
    )  # share of the variance that the cut takes away
    return float(mean_db - np.sqrt(total) * hazard / shrink), float(
        total * (1 / shrink - 1) + noise_db2
    )


@dataclass(frozen=True, eq=False)
class KrigingState:
    """Everything that follows from the parameters and the observations. Immutable."""

    parameters: KrigingParameters
    """trend and covariance in use"""
    process: GaussianProcess
    """the random field, observed"""
    trend: Trend
    """what the observations tell about the trend"""
    gain_db: Array
    """``[v]`` observed values"""
    fitted_at: int
    """observations at the last fit of the covariance"""
    one_plane: bool
    """whether the gain is predicted at the altitude where it is measured"""
    exact: NDArray[np.bool_] = field(repr=False)
    """``[P]`` cells that were read without noise"""
    exact_gain_db: Array = field(repr=False)
    """``[P]`` what was read there"""

    @classmethod
    def unobserved(
        cls, scenario: Scenario, parameters: KrigingParameters, trend: Trend
    ) -> KrigingState:
        """The state before any data."""
        grid = scenario.grid
        gap = abs(scenario.uav_altitude_m - scenario.prediction_altitude_m)
        kernel = CellKernel(grid.shape, grid.spacing_m, parameters.kernel)
        return cls(
            parameters=parameters,
            process=GaussianProcess.unobserved(
                kernel, kernel if gap == 0 else replace(kernel, gap_m=gap), kernel
            ),
            trend=trend,
            gain_db=np.empty(0),
            fitted_at=0,
            one_plane=gap == 0,
            exact=np.zeros(grid.size, dtype=bool),
            exact_gain_db=np.zeros(grid.size),
        )

    def with_readings(self, readings: Readings) -> KrigingState:
        """The state after readings at distinct cells; cells that are known exactly already are left
        out."""
        state, news = self, ~self.exact[readings.cells]
        for first in range(0, len(readings), BATCH):
            part = slice(first, first + BATCH)
            keep = news[part]
            if keep.any():
                some = Readings(
                    readings.cells[part][keep],
                    readings.gain_db[part][keep],
                    readings.noise_db2[part][keep],
                )
                state = state._with_batch(some)
        return state

    def _with_batch(self, readings: Readings) -> KrigingState:
        process, rows = self.process.observed(readings.cells, readings.noise_db2)
        gain = np.concatenate([self.gain_db, readings.gain_db])
        exact, exact_gain = self.exact, self.exact_gain_db
        which = readings.noise_db2 == 0
        if which.any():
            exact, exact_gain = exact.copy(), exact_gain.copy()
            exact[readings.cells[which]] = True
            exact_gain[readings.cells[which]] = readings.gain_db[which]
        trend = self.trend.extended(process, rows, gain)
        return replace(
            self, process=process, trend=trend, gain_db=gain, exact=exact, exact_gain_db=exact_gain
        )

    def with_floor_reading(self, cell: int, floor_db: float, noise_db2: float) -> KrigingState:
        """The state after a reading that says the gain at raveled ``cell``, plus noise, is
        ``floor_db`` or less."""
        process = self.process
        white = process.factor.times(process.kernel.between(process.cells, np.array([cell])))[:, 0]
        mean, added = self.trend.at(process, self.gain_db, cell, white)
        variance = process.kernel.variance_db2 - white @ white + added
        if variance <= KNOWN * process.kernel.variance_db2:
            return self
        expected, doubt = float(mean), float(variance)
        if added > FLAT_DB2 / 2:  # no reading has told the level yet: it is taken to be the floor's
            expected, doubt = floor_db, process.kernel.variance_db2
        pseudo = floor_reading(expected, doubt, floor_db, noise_db2)
        if pseudo is None:
            return self
        return self._with_batch(
            Readings(np.array([cell]), np.array([pseudo[0]]), np.array([pseudo[1]]))
        )

    def moments(self) -> tuple[Array, Array]:
        """Mean and variance ``[P]`` of the gain at every cell."""
        mean = self.trend.mean(self.process)
        variance = (
            self.process.prior.variance_db2
            - self.process.reduction_db2
            + self.trend.variance(self.process)
        )
        if self.one_plane:
            mean[self.exact] = self.exact_gain_db[self.exact]
            variance[self.exact] = 0.0
        return mean, np.maximum(variance, 0.0)

    def covariance(self, first: Flat, second: Flat) -> Array:
        """``[n, m]`` posterior covariance in dB² of the gain at raveled cells ``first[n]`` and
        ``second[m]``."""
        process = self.process
        white_first = process.whitened(first)
        white_second = white_first if first is second else process.whitened(second)
        covariance = process.prior.between(first, second) - white_first.T @ white_second
        covariance += self.trend.covariance(process, first, second)
        if self.one_plane:
            covariance[self.exact[first]] = 0.0
            covariance[:, self.exact[second]] = 0.0
        return covariance
