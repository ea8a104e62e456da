"""What the plain interpolators share: a belief that holds the readings, and an honest variance.

IDW, kNN and GIDS give a number per cell and no word on how wrong it may be. The error can be asked
of the data: leave out a measured cell together with all readings within a disc around it, predict
it from the rest, and note the squared error against the distance of the nearest reading that was
left. Discs of several radii give the error at every distance that occurs on the
map, which leaving out single readings does not: along a flight path the next reading is always one
cell away. The curve is made to rise with distance and is held to the trained Kriging model's, φ(1 −
exp(−2d/δ)) + ν, by the weight of `PRIOR_ERRORS`.
"""

from __future__ import annotations

__all__ = [
    "InterpolationBelief",
    "Interpolator",
    "ReadingsPredictor",
    "nearest_reading_m",
    "trained_error_db2",
    "variance_by_distance",
]

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import Readings, checked_flat, combined
from skygain.predictors.kriging.parameters import trained_parameters
from skygain.scenario import Scenario

Array = NDArray[np.float64]

DISCS = (0.0, 1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
"""radii of the discs that are left out, in cells"""
TARGETS = 64
"""measured cells that are predicted from the others; more of them cost time and add little"""
PRIOR_ERRORS = 5.0
"""errors that the trained curve counts for at each distance"""


class ReadingsPredictor(Predictor):
    """A predictor whose answer is a function of the readings alone, computed when it is asked
    for."""

    @abstractmethod
    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        """Mean and variance ``[P]`` at every cell from at least one reading; measured cells are put
        right afterwards."""

    def begin(self, scenario: Scenario) -> InterpolationBelief:
        return InterpolationBelief(self, scenario, Measurements.none())

    def outside_training(
        self, scenario: Scenario, *, uavs: int | None = None, quantity: str = "gain"
    ) -> str:
        if scenario.one_altitude:
            return ""
        return (
            f"it takes the readings at {scenario.altitude_text} for the map's values at "
            f"{scenario.map_altitude_text}; kriging and operator model what lies between"
        )


class InterpolationBelief(Belief):
    """Readings on a map. A reading at the receiver's floor counts as a reading of the floor's
    level."""

    __slots__ = ("_flat", "_posterior", "_predictor", "measurements", "scenario")

    def __init__(
        self, predictor: ReadingsPredictor, scenario: Scenario, measurements: Measurements
    ) -> None:
        self.scenario = scenario
        self.measurements = measurements
        self._predictor = predictor
        self._flat = checked_flat(scenario.grid, measurements)
        self._posterior: Posterior | None = None

    def updated(self, measurements: Measurements) -> InterpolationBelief:
        """The belief after ``measurements`` as well.

        Raises:
            InputError: a measurement lies off the map.
        """
        if len(measurements) == 0:
            return self
        return InterpolationBelief(
            self._predictor, self.scenario, self.measurements.extended(measurements)
        )

    def posterior(self) -> Posterior:
        if self._posterior is None:
            self._posterior = self._computed()
        return self._posterior

    def _computed(self) -> Posterior:
        scenario, data = self.scenario, self.measurements
        shape = scenario.grid.shape
        if len(data) == 0:
            trained = trained_parameters("constant", scenario.prediction_altitude_m)
            prior = trained.sill_db2 + trained.nugget_db2 + trained.trend_covariance[0][0]
            return Posterior(np.full(shape, trained.trend[0]), np.full(shape, prior))
        # Sorted by cell, so that ties between equally near readings do not depend on the order of
        # measuring.
        order = np.argsort(self._flat, kind="stable")
        readings = combined(self._flat[order], data.gain_db[order], data.noise_std_db[order] ** 2)
        mean, variance = self._predictor.predict(scenario, readings)
        mean[readings.cells] = readings.gain_db
        variance[readings.cells] = readings.noise_db2
        return Posterior(mean.reshape(shape), variance.reshape(shape))


class Interpolator(ReadingsPredictor):
    """A mean that is a function of the readings, with a variance learned from discs left out."""

    @abstractmethod
    def estimate(self, scenario: Scenario, readings: Readings) -> Array:
        """``[P]`` gain at every cell from at least one reading; what it says at the measured cells
        is not used."""

    @abstractmethod
    def left_out(self, distance_m: Array, xy_m: Array, target_xy_m: Array, gain_db: Array) -> Array:
        """``[m]`` estimates at m targets; ``distance_m[m, v]`` to the v readings is infinite where
        a reading may not be used."""

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        variance = variance_by_distance(scenario, readings, *self._errors(scenario, readings))
        return self.estimate(scenario, readings), variance

    def _errors(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        """Distance to the nearest reading used ``[m]`` and squared error ``[m]`` of predictions
        with discs left out."""
        grid = scenario.grid
        xy = grid.xy_m(grid.cells[readings.cells])
        rank = np.random.default_rng(0).permutation(grid.size)[readings.cells]
        targets = np.argsort(rank)[:TARGETS]
        apart = np.linalg.norm(xy[targets, None] - xy[None], axis=-1)
        nearest, errors = [np.empty(0)], [np.empty(0)]
        for radius in DISCS:
            distance = np.where(apart > radius * grid.spacing_m, apart, np.inf)
            near = distance.min(axis=1)
            left = np.isfinite(near)
            if left.any():
                estimate = self.left_out(distance[left], xy, xy[targets[left]], readings.gain_db)
                nearest.append(near[left])
                errors.append((estimate - readings.gain_db[targets[left]]) ** 2)
        return np.concatenate(nearest), np.concatenate(errors)


def trained_error_db2(scenario: Scenario, distance_m: Array) -> Array:
    """The squared error that the trained Kriging model expects at a distance from the nearest
    reading."""
    trained = trained_parameters("constant", scenario.prediction_altitude_m)
    return trained.sill_db2 * (1 - np.exp(-2 * distance_m / trained.range_m)) + trained.nugget_db2


def nearest_reading_m(scenario: Scenario, readings: Readings) -> Array:
    """Distance ``[P]`` of every cell to the nearest measured one."""
    grid = scenario.grid
    unmeasured = np.ones(grid.size, dtype=bool)
    unmeasured[readings.cells] = False
    return grid.spacing_m * distance_transform_edt(unmeasured.reshape(grid.shape)).ravel()


def variance_by_distance(
    scenario: Scenario, readings: Readings, nearest_m: Array, error_db2: Array
) -> Array:
    """Variance ``[P]`` at every cell out of squared errors ``[m]`` of predictions whose nearest
    reading was ``nearest_m[m]`` away."""
    grid = scenario.grid
    nodes = grid.spacing_m * 2.0 ** np.arange(np.ceil(np.log2(max(grid.shape))) + 1)
    curve = _rising_curve(nearest_m, error_db2, nodes, trained_error_db2(scenario, nodes))
    distance = nearest_reading_m(scenario, readings)
    return np.interp(distance, np.append(0.0, nodes), np.append(0.0, curve))


def _rising_curve(nearest_m: Array, error_db2: Array, nodes_m: Array, expected_db2: Array) -> Array:
    """Mean squared error at each of ``nodes_m`` (each twice as far as the one before), held to
    ``expected_db2``."""
    node = np.clip(np.round(np.log2(nearest_m / nodes_m[0])).astype(int), 0, len(nodes_m) - 1)
    count = np.bincount(node, minlength=len(nodes_m))
    total = np.bincount(node, error_db2, minlength=len(nodes_m))
    return np.maximum.accumulate((PRIOR_ERRORS * expected_db2 + total) / (PRIOR_ERRORS + count))
