"""Kriging: a trend, a Gaussian process around it, and beliefs that grow with the survey (paper,
section VII-A).

The gain is modelled as y(q) = h(q)ᵀθ + g(q) with θ ~ N(θ₀, Σ) and g a zero-mean field with
covariance φ exp(−d/δ) + ν·1[d = 0]. With Σ = 0 this is the paper's simple Kriging around a fixed
path-loss line. With the trained Σ the survey also learns its own θ, which the paper does not do;
the answer is still exact, since θ enters linearly.

Every ``updated`` appends to the inverse Cholesky factor and to a few maps. At scheduled sizes, when
the number of observations passes 3, 5, 8, 12, … (half as many again each time), the covariance is
first fitted to the survey anew and everything is rebuilt once. Three things may be chosen there
(see `skygain.predictors.kriging.survey_fit`): the trained parameters, ones without a path-loss
line, and generic ones for a place or a quantity unlike all that was trained on.
"""

from __future__ import annotations

__all__ = [
    "KrigingBelief",
    "KrigingPredictor",
    "blind_kriging",
    "inferred_kriging",
    "launched_kriging",
    "quadratic_kriging",
]

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.posterior import GaussianProcessPosterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import Readings, checked_flat, combined
from skygain.predictors.kriging.inferred_trend import InferredTrend
from skygain.predictors.kriging.launched import launched_columns, launched_priors
from skygain.predictors.kriging.parameters import (
    TRENDS,
    KrigingParameters,
    Trained,
    parameter_file,
    shipped_parameters,
    trained_parameters,
    trend_columns,
)
from skygain.predictors.kriging.state import KrigingState
from skygain.predictors.kriging.survey_fit import fit_is_due, fit_to_survey, survey_priors
from skygain.predictors.kriging.trend import FixedTrend, Trend
from skygain.scenario import Scenario

Array = NDArray[np.float64]

OFFSETS_BYTES = 2000.0
"""per cell, of the tables by offset and what is computed with them"""
INFERRED_BYTES = 4000.0
"""the same with the places where the transmitter may stand and their means"""
LEVELS = ("any", "gain")
"""what may be said of the readings' level"""


@dataclass(frozen=True)
class KrigingPredictor(Predictor):
    """Kriging around ``trend``; the default needs the transmitter's position.

    Raises:
        InputError: unknown trend, or parameters with another number of trend coefficients.
    """

    trend: str = "log-distance"
    """``"log-distance"``; ``"inferred"``, the same around a transmitter that has to be found;
    ``"launched"``, the map of the propagation model; ``"constant"``; ``"quadratic"``"""
    parameters: KrigingParameters | str | None = None
    """trend and covariance to start from, or a file written by ``skygain train kriging``; ``None``
    takes the ones that ship, for the scenario's altitude"""
    refit: bool = True
    """fit the covariance to the survey's own data on the schedule; ``False`` keeps the parameters
    as they are"""
    level: str = "any"
    """without a known transmitter, ``"any"``: readings of any level, in dBm too, are taken alike;
    ``"gain"``: they are channel gains in dB at the level of the training cities"""
    transmitter: Literal["required", "optional", "unused"] = field(
        init=False, repr=False, default="unused"
    )
    """only the log-distance and the launched trend need the transmitter's position"""

    def __post_init__(self) -> None:
        known = (*TRENDS, "inferred", "launched")
        if self.trend not in known:
            raise InputError(f"unknown trend {self.trend!r}; known: {', '.join(known)}")
        if self.level not in LEVELS:
            raise InputError(f"unknown level {self.level!r}; expected one of {', '.join(LEVELS)}")
        expected = {"constant": 1, "quadratic": 6}.get(self.trend, 2)
        _ = self._trained  # an unreadable file is told at once
        if (
            isinstance(self.parameters, KrigingParameters)
            and len(self.parameters.trend) != expected
        ):
            raise InputError(
                f"a trend {self.trend!r} has {expected} coefficients, but the parameters give "
                f"{len(self.parameters.trend)}"
            )
        told = self.trend in ("log-distance", "launched")
        object.__setattr__(self, "transmitter", "required" if told else "unused")

    @property
    def needs_gain(self) -> bool:  # type: ignore[override]
        """Where its parameters or the path-loss line know the level."""
        return self.trend == "log-distance" or self.level == "gain" or self.parameters is not None

    @cached_property
    def _trained(self) -> Trained:
        of = self.parameters
        return parameter_file(of) if isinstance(of, str | Path) else shipped_parameters()

    def memory_bytes(self, cells: int, readings: int) -> float:
        """Each reading is tied to every cell, in single precision; covariances are looked up by
        offset, and a transmitter that has to be found is thought of in many places."""
        held = INFERRED_BYTES if self.trend == "inferred" else OFFSETS_BYTES
        return super().memory_bytes(cells, readings) + (held + 4.0 * readings) * cells

    def begin(self, scenario: Scenario) -> KrigingBelief:
        """The belief before the first measurement.

        Raises:
            InputError: the trend needs a transmitter and the scenario has none.
        """
        parameters = self.priors(scenario)[0][0]
        if self.trend == "inferred":
            trend: Trend = InferredTrend.unobserved(scenario, parameters)
        elif self.trend == "launched":
            flown, predicted = (
                launched_columns(scenario, altitude_m)
                for altitude_m in (scenario.uav_altitude_m, scenario.prediction_altitude_m)
            )
            trend = FixedTrend.unobserved(flown, predicted, parameters)
        else:
            grid, transmitter = scenario.grid, scenario.transmitter_m
            predicted = trend_columns(self.trend, grid, scenario.prediction_altitude_m, transmitter)
            flown = trend_columns(self.trend, grid, scenario.uav_altitude_m, transmitter)
            trend = FixedTrend.unobserved(flown, predicted, parameters)
        return KrigingBelief(
            self,
            scenario,
            Measurements.none(),
            KrigingState.unobserved(scenario, parameters, trend),
        )

    def priors(self, scenario: Scenario) -> list[tuple[KrigingParameters, float]]:
        """What a survey chooses from, the likeliest first, with the logarithm of the odds."""
        if isinstance(self.parameters, KrigingParameters):
            return [(self.parameters, 0.0)]
        if self.trend == "launched":
            return launched_priors(flat=self.level == "any")
        if (
            self.trend == "inferred"
        ):  # without a path-loss line there would be no transmitter to find
            altitude_m = scenario.prediction_altitude_m
            trained = trained_parameters("log-distance", altitude_m, self._trained)
            return [(trained if self.level == "gain" else trained.with_flat_level, 0.0)]
        return survey_priors(self.trend, scenario, self.level, self._trained)

    def expected(self, scenario: Scenario) -> KrigingParameters:
        """What is expected before the first reading, when only the training speaks."""
        if isinstance(self.parameters, KrigingParameters):
            return self.parameters
        if self.trend == "launched":
            return launched_priors(flat=False)[0][0]
        trend = "log-distance" if self.trend == "inferred" else self.trend
        return trained_parameters(trend, scenario.prediction_altitude_m, self._trained)


def blind_kriging(**options: Any) -> KrigingPredictor:
    """Kriging that does not know the transmitter: constant trend."""
    return KrigingPredictor(trend="constant", **options)


def quadratic_kriging(**options: Any) -> KrigingPredictor:
    """Kriging that does not know the transmitter: second-order trend."""
    return KrigingPredictor(trend="quadratic", **options)


def launched_kriging(**options: Any) -> KrigingPredictor:
    """The propagation model's own map from a known transmitter, put right by the readings: its
    level, its slope, and Kriging of what is left."""
    return KrigingPredictor(trend="launched", **options)


def inferred_kriging(**options: Any) -> KrigingPredictor:
    """Kriging that does not know the transmitter and finds it on the way.

    It looks for it by the trained gain along the path-loss line, so readings are taken for gains in
    dB unless ``level="any"`` says otherwise.
    """
    return KrigingPredictor(trend="inferred", **({"level": "gain"} | options))


class KrigingBelief(Belief):
    """What Kriging knows in the middle of a survey."""

    __slots__ = ("_posterior", "measurements", "predictor", "scenario", "state")

    def __init__(
        self,
        predictor: KrigingPredictor,
        scenario: Scenario,
        measurements: Measurements,
        state: KrigingState,
    ) -> None:
        self.predictor = predictor
        self.scenario = scenario
        self.measurements = measurements
        self.state = state
        self._posterior: GaussianProcessPosterior | None = None

    @property
    def parameters(self) -> KrigingParameters:
        """Trend and covariance in use, as of the last fit."""
        return self.state.parameters

    def prior_covariance_db2(self, distance_m: ArrayLike) -> Array:
        """Covariance in dB² of the shadowing at two cells ``distance_m`` apart before any
        reading."""
        return self.parameters.kernel.at(distance_m)

    def updated(self, measurements: Measurements) -> KrigingBelief:
        """The belief after ``measurements`` as well.

        Raises:
            InputError: a measurement lies off the map.
        """
        if len(measurements) == 0:
            return self
        flat = checked_flat(self.scenario.grid, measurements)
        noise = measurements.noise_std_db**2
        plain = ~measurements.censored
        readings = combined(flat[plain], measurements.gain_db[plain], noise[plain])
        state = self._fitted(readings).with_readings(readings)
        for i in np.flatnonzero(measurements.censored):
            state = state.with_floor_reading(
                int(flat[i]), float(measurements.gain_db[i]), float(noise[i])
            )
        return KrigingBelief(
            self.predictor, self.scenario, self.measurements.extended(measurements), state
        )

    def _fitted(self, coming: Readings) -> KrigingState:
        """The state to extend by ``coming``: rebuilt with parameters fitted to it as well, if the
        schedule says so."""
        state = self.state
        size = len(state.gain_db) + int((~state.exact[coming.cells]).sum())
        if not self.predictor.refit or not fit_is_due(size, state.fitted_at):
            return state
        old = combined(state.process.cells, state.gain_db, state.process.noise_db2)
        everything = combined(
            np.concatenate([old.cells, coming.cells]),
            np.concatenate([old.gain_db, coming.gain_db]),
            np.concatenate([old.noise_db2, coming.noise_db2]),
        )
        priors = self.predictor.priors(self.scenario)
        # Where the transmitter may be is part of the columns, and the coming readings have a say in
        # it.
        trend = (
            state.with_readings(coming).trend if self.predictor.trend == "inferred" else state.trend
        )
        parameters = fit_to_survey(self.scenario.grid, priors, everything, trend.columns)
        fresh = KrigingState.unobserved(
            self.scenario, parameters, state.trend.restarted(parameters)
        )
        return replace(fresh.with_readings(old), fitted_at=size)

    def posterior(self) -> GaussianProcessPosterior:
        if self._posterior is None:
            grid, state = self.scenario.grid, self.state
            if len(self.measurements) == 0:
                parameters = self.predictor.expected(self.scenario)
                trend = state.trend.restarted(parameters)
                state = KrigingState.unobserved(self.scenario, parameters, trend)

            def covariance(cells: NDArray[np.int64], others: NDArray[np.int64]) -> Array:
                first = grid.flat(cells)
                return state.covariance(first, first if cells is others else grid.flat(others))

            mean, variance = state.moments()
            self._posterior = GaussianProcessPosterior(
                mean.reshape(grid.shape), variance.reshape(grid.shape), covariance
            )
        return self._posterior
