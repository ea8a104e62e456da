"""Fixtures shared by the whole suite."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from skygain.measurements import Measurements
from skygain.posterior import GaussianProcessPosterior, Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.scenario import Scenario

if TYPE_CHECKING:
    from skygain.reports.outcome import Outcome


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with the large data sets that are not part of the product; tests that need it skip
    where it is absent."""
    root = (
        Path(os.environ.get("SKYGAIN_SHARED", Path(__file__).parents[1].parent / "shared")) / "data"
    )
    if not (root / "manhattan-v0.zarr.zip").exists():
        pytest.skip(
            "the shared data sets are absent; set SKYGAIN_SHARED to the folder that holds "
            "data/manhattan-v0.zarr.zip"
        )
    return root


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240229)


@pytest.fixture(scope="session")
def make_outcome() -> Callable[..., Outcome]:
    """A small real survey, flown anew for each call: a map that is no square, with a high and a low
    building and a no-fly zone."""
    from skygain.city import City
    from skygain.evaluation.rollout import Recorder
    from skygain.flight.swarm import Swarm
    from skygain.grid import Grid
    from skygain.instruments.simulated import PerfectInstrument
    from skygain.planners import create_planner
    from skygain.predictors import create_predictor
    from skygain.reports.outcome import Outcome
    from skygain.scenario import Scenario
    from skygain.survey.loop import Survey

    def make(
        *, crs: str | None = None, truth: str | None = "full", name: str = "test town", **told: Any
    ) -> Outcome:
        height = np.zeros((12, 18))
        height[6:9, 4:10], height[2:4, 12:16] = 24.0, 6.0
        no_fly = np.zeros((12, 18), dtype=bool)
        no_fly[0:2, 16:] = True
        origin = (691234.0, 3985876.0) if crs else (2.0, 2.0)
        city = City(Grid((12, 18), 4.0, origin, crs), height, name=name)
        scenario = Scenario(
            city, no_fly=no_fly, transmitter_m=(origin[0] + 20.0, origin[1] + 8.0, 1.5)
        )
        distance_m = np.hypot(*np.meshgrid(np.arange(18) - 5.0, np.arange(12) - 2.0)) * 4.0
        gain_db = (
            -55
            - 30 * np.log10(np.maximum(distance_m, 2.0))
            + np.random.default_rng(5).normal(size=(12, 18))
        )
        known = {
            "full": gain_db,
            "partial": np.where(np.arange(18) % 3 == 0, gain_db, np.nan),
            None: None,
        }[truth]
        recorder = Recorder(frozenset(range(0, 31, 5)), known, keep_maps=True)
        survey = Survey(
            scenario,
            create_predictor("idw"),
            create_planner("random-waypoint"),
            PerfectInstrument(gain_db),
        )
        swarm = Swarm.deployed(scenario, [(0, 0), (11, 17)], 30)
        result = survey.fly(swarm, np.random.default_rng(1), recorder)
        return Outcome(
            result, recorder.frames, known, **{"title": "A survey", "config": {"seed": 1}, **told}
        )

    return make


@dataclass(frozen=True, eq=False)
class FieldBelief(Belief):
    scenario: Scenario
    measurements: Measurements
    sill_db2: float
    range_m: float

    def prior_covariance_db2(self, distance_m):
        return self.sill_db2 * np.exp(-np.asarray(distance_m) / self.range_m)

    def updated(self, measurements):
        return FieldBelief(
            self.scenario, self.measurements.extended(measurements), self.sill_db2, self.range_m
        )

    def _prior(self, a, b):
        gap = np.hypot(*(np.asarray(a)[:, None] - np.asarray(b)[None]).transpose(2, 0, 1))
        return self.prior_covariance_db2(gap * self.scenario.grid.spacing_m)

    def posterior(self):
        cells = np.unique(self.measurements.cell, axis=0)
        inverse = np.linalg.inv(
            self._prior(cells, cells) + 1e-9 * self.sill_db2 * np.eye(len(cells))
        )

        def covariance(a, b):
            return self._prior(a, b) - self._prior(a, cells) @ inverse @ self._prior(cells, b)

        grid = self.scenario.grid
        cross = self._prior(grid.cells, cells)
        variance = np.clip(
            self.sill_db2 - np.einsum("ij,jk,ik->i", cross, inverse, cross), 0, None
        ).reshape(grid.shape)
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
        return Posterior(
            np.full(shape, -100.0), np.where(self.measurements.visited(shape), 0.0, 100.0)
        )


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
