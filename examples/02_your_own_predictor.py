"""A predictor of your own: two methods, a public conformance check, and it flies with every
planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors import PREDICTORS, Belief, Predictor
from skygain.scenario import Scenario
from skygain.testing import check_predictor


@dataclass(frozen=True, eq=False)
class MeanBelief(Belief):
    """Every cell has the mean of all readings; a measured cell has its own."""

    scenario: Scenario
    measurements: Measurements

    def updated(self, measurements: Measurements) -> MeanBelief:
        return MeanBelief(self.scenario, self.measurements.extended(measurements))

    def posterior(self) -> Posterior:
        rows, cols = self.measurements.cell.T
        measured = np.full(self.scenario.grid.shape, np.nan)
        measured[rows, cols] = (
            self.measurements.gain_db
        )  # a cell counts once, however often it was visited
        seen = measured[np.isfinite(measured)]
        mean = np.where(np.isfinite(measured), measured, seen.mean() if len(seen) else -130.0)
        variance = np.full(mean.shape, seen.var() + 1.0 if len(seen) > 1 else 900.0)
        variance[rows, cols] = self.measurements.noise_std_db**2
        return Posterior(mean, variance)


class MeanPredictor(Predictor):
    """The simplest predictor there is; anything worth its name beats it."""

    def begin(self, scenario: Scenario) -> MeanBelief:
        return MeanBelief(scenario, Measurements.none())


check_predictor(MeanPredictor())
PREDICTORS.register("mean", MeanPredictor)
print("known predictors now:", ", ".join(PREDICTORS))
