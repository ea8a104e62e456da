"""Small beliefs to plan with: a Gaussian process, and one that knows only variances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from skygain.measurements import Measurements
from skygain.posterior import GaussianProcessPosterior, Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.scenario import Scenario


@dataclass(frozen=True, eq=False)
class FieldBelief(Belief):
    scenario: Scenario
    measurements: Measurements
    sill_db2: float
    range_m: float

    def prior_covariance_db2(self, distance_m):
        return self.sill_db2 * np.exp(-np.asarray(distance_m) / self.range_m)

    def updated(self, measurements):
        return FieldBelief(self.scenario, self.measurements.extended(measurements), self.sill_db2, self.range_m)

    def _prior(self, a, b):
        gap = np.hypot(*(np.asarray(a)[:, None] - np.asarray(b)[None]).transpose(2, 0, 1))
        return self.prior_covariance_db2(gap * self.scenario.grid.spacing_m)

    def posterior(self):
        cells = np.unique(self.measurements.cell, axis=0)
        inverse = np.linalg.inv(self._prior(cells, cells) + 1e-9 * self.sill_db2 * np.eye(len(cells)))

        def covariance(a, b):
            return self._prior(a, b) - self._prior(a, cells) @ inverse @ self._prior(cells, b)

        grid = self.scenario.grid
        cross = self._prior(grid.cells, cells)
        variance = np.clip(self.sill_db2 - np.einsum("ij,jk,ik->i", cross, inverse, cross), 0, None).reshape(grid.shape)
        return GaussianProcessPosterior(np.full(grid.shape, -100.0), variance, covariance)


@dataclass(frozen=True)
class FieldPredictor(Predictor):
    sill_db2: float = 100.0
    range_m: float = 30.0

    def begin(self, scenario):
        return FieldBelief(scenario, Measurements.none(), self.sill_db2, self.range_m)


@dataclass(frozen=True, eq=False)
class VarianceBelief(Belief):
    scenario: Scenario
    measurements: Measurements

    def updated(self, measurements):
        return VarianceBelief(self.scenario, self.measurements.extended(measurements))

    def posterior(self):
        shape = self.scenario.grid.shape
        return Posterior(np.full(shape, -100.0), np.where(self.measurements.visited(shape), 0.0, 100.0))


class VariancePredictor(Predictor):
    def begin(self, scenario):
        return VarianceBelief(scenario, Measurements.none())


@pytest.fixture
def field_predictor():
    """An exact Gaussian process: 100 dB², 30 m."""
    return FieldPredictor()


@pytest.fixture
def variance_predictor():
    """A belief without covariances, like a deep predictor's."""
    return VariancePredictor()
