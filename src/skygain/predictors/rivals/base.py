"""What the rivals share: a Gaussian process of another library over the readings of a survey.

A rival sees positions in metres and gains about their mean, so a constant added to every reading is
added to its map. It fits its covariance to the readings each time it is asked, unless it is told
one. From too few readings nothing can be fitted; then textbook values stand in.
"""

from __future__ import annotations

__all__ = ["LEAST_READINGS", "Answer", "RivalPredictor"]

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from skygain.fields.offsets import ExponentialKernel
from skygain.ground.errors import InputError, require
from skygain.predictors.interpolators.interpolation import InterpolationBelief, ReadingsPredictor
from skygain.predictors.interpolators.readings import Readings
from skygain.predictors.kriging.parameters import KrigingParameters, generic_parameters
from skygain.scenario import Scenario

Array = NDArray[np.float64]
Answer = Callable[[Array], tuple[Array, Array]]
"""positions ``[n, (x, y)]`` in metres -> mean and variance ``[n]``"""

LEAST_READINGS = 8
"""readings from which a covariance is fitted"""
ENTRIES = 16_000_000
"""covariances between cells and readings that are held at a time, which bounds the memory"""


@dataclass(frozen=True)
class RivalPredictor(ReadingsPredictor):
    """A constant mean and an exponential covariance, by another library.

    Raises:
        InputError: parameters with more than a constant trend.
    """

    package: ClassVar[str]
    """the library's module"""

    parameters: KrigingParameters | None = None
    """mean and covariance to take as exact; ``None`` fits them to the readings"""

    def __post_init__(self) -> None:
        if self.parameters is not None and len(self.parameters.trend) != 1:
            raise InputError(
                "this predictor has a constant trend of 1 coefficient, but the parameters give "
                f"{len(self.parameters.trend)}"
            )

    @abstractmethod
    def fitted(
        self, xy_m: Array, gain_db: Array, noise_db2: Array, told: ExponentialKernel | None
    ) -> Answer:
        """The process given gains about zero at positions about zero; ``told`` is its covariance,
        ``None`` asks for a fit."""

    def begin(self, scenario: Scenario) -> InterpolationBelief:
        """The belief before the first measurement.

        Raises:
            MissingExtraError: the library is not installed.
        """
        require(self.package, "rivals")
        return super().begin(scenario)

    def memory_bytes(self, cells: int, readings: int) -> float:
        """Covariances between so many cells and the readings, and what the library makes of
        them."""
        held = min(float(cells) * readings, ENTRIES)
        return super().memory_bytes(cells, readings) + 64.0 * (held + readings**2)

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        xy = scenario.grid.xy_m(scenario.grid.cells)
        xy -= xy.mean(axis=0)
        level, scale, told = self._begun(readings.gain_db)
        answer = self.fitted(
            xy[readings.cells],
            (readings.gain_db - level) / scale,
            readings.noise_db2 / scale**2,
            told,
        )
        mean, variance = np.empty(len(xy)), np.empty(len(xy))
        at_a_time = max(1, ENTRIES // len(readings))
        for first in range(0, len(xy), at_a_time):
            part = slice(first, first + at_a_time)
            mean[part], variance[part] = answer(xy[part])
        return level + scale * mean, scale**2 * np.maximum(variance, 0.0)

    def _begun(self, gain_db: Array) -> tuple[float, float, ExponentialKernel | None]:
        """What is taken off the gains, what they are divided by, and the covariance if it is not to
        be fitted."""
        parameters, level = self.parameters, float(gain_db.mean())
        if parameters is not None:
            level = parameters.trend[0]
        elif len(gain_db) < LEAST_READINGS or np.ptp(gain_db) < 1e-6:
            parameters = generic_parameters("constant")
        else:
            return level, float(gain_db.std()), None
        return level, 1.0, parameters.kernel
