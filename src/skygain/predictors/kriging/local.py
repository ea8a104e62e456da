"""Kriging from neighbours, for surveys too large for one covariance matrix: 10⁵ measurements, 10⁶
cells.

Every cell is predicted from the ``neighbours`` measured cells nearest to it. With an exponential
covariance the near ones screen the far ones, so that a few dozen lose little. The trend's
coefficients are shared by the whole map and learned from `TREND_ROWS` of the measurements. Up to
``neighbours`` measurements the belief is exactly that of
`skygain.predictors.kriging.known_source.KrigingPredictor`, save one: without a transmitter nothing
says how the level changes over kilometres, so beyond 200 m from the nearest reading the variance
grows with distance.

An update notes the readings and keeps the parameters fitted. The map is predicted when it is asked
for, and then only the cells whose neighbourhood has changed since it last was. Cells are handled in
chunks by as many threads as there are processors; memory is a few numbers per cell and measurement,
whatever their numbers. Readings at the receiver's floor enter as in Kriging, each on its own. The
posterior has no covariance between cells; planners condition the kernel on the readings nearest to
where they plan.
"""

from __future__ import annotations

__all__ = ["LocalKrigingBelief", "LocalKrigingPredictor"]

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree

from skygain.fields.gaussian_process import KNOWN, CellKernel, Flat
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import Readings, checked_flat, combined
from skygain.predictors.kriging.parameters import (
    FLAT_DB2,
    KrigingParameters,
    far_columns,
    trained_parameters,
    trend_columns,
)
from skygain.predictors.kriging.state import floor_reading
from skygain.predictors.kriging.survey_fit import fit_is_due, fit_to_survey, survey_priors
from skygain.scenario import Scenario

Array = NDArray[np.float64]

TREND_ROWS = 1000
"""measurements that the trend is learned from; more of them change a handful of coefficients little
and cost their cube"""
UNTIED = 1e-3
"""cells by which positions are moved at most to tell equally near ones apart"""
DRIFT_FROM_M = 200.0
"""distance from the nearest reading beyond which a level of unknown origin may drift away"""
DRIFT_DB = 30.0
"""standard deviation of that drift in dB per decade of distance, without a transmitter: about what
path loss does"""
CHUNK = 16384
"""cells a thread handles at a time"""


@dataclass(frozen=True)
class LocalKrigingPredictor(Predictor):
    """Kriging from the nearest measured cells, around the path-loss line if the transmitter is
    known, else around a constant.

    Raises:
        InputError: fewer than one neighbour.
    """

    neighbours: int = 32
    """measured cells that each cell is predicted from"""
    parameters: KrigingParameters | None = None
    """trend and covariance to start from; ``None`` takes the trained ones for the scenario's
    altitude"""
    refit: bool = True
    """fit the covariance to the survey's own data on the schedule of Kriging"""
    progress: Callable[[int, int], None] | None = field(default=None, compare=False)
    """called with the number of cells done and to do, for updates that take long"""
    transmitter: Literal["required", "optional", "unused"] = field(
        init=False, repr=False, default="optional"
    )
    """the trend is better with it"""

    def __post_init__(self) -> None:
        if self.neighbours < 1:
            raise InputError(
                f"local Kriging needs at least one neighbour, got {self.neighbours}; 32 is usual"
            )

    def begin(self, scenario: Scenario) -> LocalKrigingBelief:
        """The belief before the first measurement.

        Raises:
            InputError: parameters whose trend has another number of coefficients than the
                scenario's trend.
        """
        trend = "constant" if scenario.transmitter_m is None else "log-distance"
        flown, predicted = (
            trend_columns(trend, scenario.grid, altitude, scenario.transmitter_m)
            for altitude in (scenario.uav_altitude_m, scenario.prediction_altitude_m)
        )
        priors = (
            survey_priors(trend, scenario) if self.parameters is None else [(self.parameters, 0.0)]
        )
        if self.parameters is None and trend == "log-distance":
            far = far_columns(predicted)
            if far[:, 2].any():  # the trained line ends on this map
                flown, predicted = far_columns(flown), far
                priors = [(prior.with_far_slope, odds) for prior, odds in priors]
        parameters = priors[0][0]
        if len(parameters.trend) != flown.shape[1]:
            raise InputError(
                f"a trend {trend!r} has {flown.shape[1]} coefficients, but the parameters give "
                f"{len(parameters.trend)}"
            )
        setting = _Setting(self, scenario, tuple(priors), flown, predicted)
        state = _unobserved(setting, parameters)
        waiting = _Waiting(parameters, 0, state.readings, state.readings.cells)
        return LocalKrigingBelief(setting, Measurements.none(), state, waiting)


@dataclass(frozen=True, eq=False)
class _Setting:
    """What stays the same through a survey."""

    predictor: LocalKrigingPredictor
    scenario: Scenario
    priors: tuple[tuple[KrigingParameters, float], ...]
    flown_columns: Array  # [P, q]
    columns: Array  # [P, q]

    @property
    def expected(self) -> KrigingParameters:
        """What is expected before the first reading, when only the training speaks."""
        if self.predictor.parameters is not None:
            return self.predictor.parameters
        trend = "constant" if self.scenario.transmitter_m is None else "log-distance"
        trained = trained_parameters(trend, self.scenario.prediction_altitude_m)
        return trained.with_far_slope if self.columns.shape[1] == 3 else trained

    @property
    def one_plane(self) -> bool:
        return self.scenario.uav_altitude_m == self.scenario.prediction_altitude_m

    def kernels(self, parameters: KrigingParameters) -> tuple[CellKernel, CellKernel]:
        """Covariance between observed cells, and between an observed and a predicted one."""
        grid = self.scenario.grid
        kernel = CellKernel(grid.shape, grid.spacing_m, parameters.kernel)
        gap = abs(self.scenario.uav_altitude_m - self.scenario.prediction_altitude_m)
        return kernel, (replace(kernel, gap_m=gap) if gap else kernel)


@dataclass(frozen=True, eq=False)
class _State:
    """Everything that follows from the parameters and the observations. Immutable."""

    parameters: KrigingParameters
    kernels: tuple[CellKernel, CellKernel]
    readings: Readings  # one per measured cell, in the order they came
    fitted_at: int
    information: Array  # [q, q] HᵀK⁻¹H
    score: Array  # [q] HᵀK⁻¹(y − Hθ₀)
    weighted: Array  # [P] w·y
    leftover: Array  # [P, q] h − w·H
    variance: Array  # [P] of the field given the neighbours
    # [P] distances in cells of the nearest neighbour, and of the farthest; infinite while missing
    nearest: Array
    reach: Array

    def coefficients(self) -> tuple[Array, Array]:
        """Mean ``[q]`` and covariance ``[q, q]`` of the trend's coefficients."""
        prior, sigma = (
            np.asarray(self.parameters.trend),
            np.asarray(self.parameters.trend_covariance),
        )
        covariance = np.linalg.solve(np.eye(len(prior)) + sigma @ self.information, sigma)
        covariance = (covariance + covariance.T) / 2
        return prior + covariance @ self.score, covariance

    def moments(self, setting: _Setting) -> tuple[Array, Array]:
        """Mean and variance ``[P]`` at every cell."""
        theta, covariance = self.coefficients()
        mean = self.weighted + self.leftover @ theta
        variance = self.variance + np.einsum(
            "pq,qr,pr->p", self.leftover, covariance, self.leftover
        )
        if self.leftover.shape[1] == 1 and len(self.readings):  # no transmitter: the level drifts
            away = self.nearest * setting.scenario.grid.spacing_m / DRIFT_FROM_M
            variance += (DRIFT_DB * np.log10(np.maximum(away, 1.0))) ** 2
        if setting.one_plane:
            exact = self.readings.noise_db2 == 0
            mean[self.readings.cells[exact]] = self.readings.gain_db[exact]
            variance[self.readings.cells[exact]] = 0.0
        return mean, np.maximum(variance, 0.0)


@dataclass(frozen=True, eq=False)
class _Waiting:
    """Parameters and readings to predict from, and where they differ from those of the state
    predicted last. Immutable."""

    parameters: KrigingParameters
    fitted_at: int
    readings: Readings  # one per measured cell
    changed: Flat  # cells whose reading is new or another one


def _unobserved(setting: _Setting, parameters: KrigingParameters) -> _State:
    """The state before any data."""
    size, q = setting.scenario.grid.size, len(parameters.trend)
    kernels = setting.kernels(parameters)
    return _State(
        parameters=parameters,
        kernels=kernels,
        readings=Readings(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0)),
        fitted_at=0,
        information=np.zeros((q, q)),
        score=np.zeros(q),
        weighted=np.zeros(size),
        leftover=setting.columns,
        variance=np.full(size, kernels[0].variance_db2),
        nearest=np.full(size, np.inf),
        reach=np.full(size, np.inf),
    )


def _untied(positions: NDArray[np.int64], cells: Flat) -> Array:
    """Positions in cells, each moved by less than `UNTIED` by a hash of its cell.

    On a grid many readings are equally near; which of them count as neighbours must not depend on
    the order of measuring.
    """
    hashed = (cells[:, None] * np.array([2654435761, 2246822519]) % 2**32) / 2**32
    return positions + UNTIED / 2 * hashed


def _predicted(setting: _Setting, state: _State, cells: Flat) -> _State:
    """``state`` with ``cells`` predicted from its readings."""
    from skygain.predictors.kriging.local_kernels import Field, Observations, neighbour_weights

    predictor, grid, data = setting.predictor, setting.scenario.grid, state.readings
    kernel, cross = state.kernels
    observations = Observations(
        data.cells, data.noise_db2, data.gain_db, setting.flown_columns[data.cells]
    )
    prior_db2 = float(kernel.variance_db2)
    field = Field(kernel.table, cross.table, prior_db2, KNOWN * prior_db2)
    tree = cKDTree(_untied(grid.cells[data.cells], data.cells))
    k = predictor.neighbours
    weighted, leftover = state.weighted.copy(), state.leftover.copy()
    variance, closest, reach = state.variance.copy(), state.nearest.copy(), state.reach.copy()

    def handle(first: int) -> int:
        some = cells[first : first + CHUNK]
        distance, nearest = tree.query(grid.cells[some], k=np.arange(1, k + 1))
        y, h, var = neighbour_weights(some, nearest, observations, field)
        weighted[some], leftover[some], variance[some] = y, setting.columns[some] - h, var
        closest[some], reach[some] = distance[:, 0], distance[:, -1]
        return len(some)

    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for count in pool.map(handle, range(0, len(cells), CHUNK)):
            done += count
            if predictor.progress is not None:
                predictor.progress(done, len(cells))
    return replace(
        state,
        weighted=weighted,
        leftover=leftover,
        variance=variance,
        nearest=closest,
        reach=reach,
    )


def _with_trend(setting: _Setting, state: _State) -> _State:
    """``state`` with the trend's likelihood taken from `TREND_ROWS` readings, picked by their cells
    alone."""
    data, kernel = state.readings, state.kernels[0]
    rank = np.random.default_rng(0).permutation(setting.scenario.grid.size)[data.cells]
    rows = (
        np.argpartition(rank, TREND_ROWS)[:TREND_ROWS]
        if len(rank) > TREND_ROWS
        else np.arange(len(rank))
    )
    rows = rows[np.argsort(rank[rows])]
    cells = data.cells[rows]
    covariance = kernel.between(cells, cells)
    covariance[np.diag_indices_from(covariance)] += (
        data.noise_db2[rows] + KNOWN * kernel.variance_db2
    )
    columns = setting.flown_columns[cells]
    residual = data.gain_db[rows] - columns @ np.asarray(state.parameters.trend)
    solved = cho_solve(cho_factor(covariance, lower=True), columns)
    return replace(state, information=columns.T @ solved, score=solved.T @ residual)


class LocalKrigingBelief(Belief):
    """What local Kriging knows in the middle of a survey."""

    __slots__ = ("_posterior", "_setting", "_state", "_waiting", "measurements", "scenario")

    def __init__(
        self, setting: _Setting, measurements: Measurements, state: _State, waiting: _Waiting
    ) -> None:
        self.scenario = setting.scenario
        self.measurements = measurements
        self._setting = setting
        self._state = state
        self._waiting = waiting
        self._posterior: Posterior | None = None

    @property
    def parameters(self) -> KrigingParameters:
        """Trend and covariance in use, as of the last fit."""
        return self._waiting.parameters

    def prior_covariance_db2(self, distance_m: ArrayLike) -> Array:
        """Covariance in dB² of the shadowing at two cells ``distance_m`` apart before any
        reading."""
        return self.parameters.kernel.at(distance_m)

    def updated(self, measurements: Measurements) -> LocalKrigingBelief:
        """The belief after ``measurements`` as well.

        Raises:
            InputError: a measurement lies off the map.
        """
        if len(measurements) == 0:
            return self
        flat = checked_flat(self.scenario.grid, measurements)
        gain, noise = measurements.gain_db.copy(), measurements.noise_std_db**2
        keep = np.ones(len(flat), dtype=bool)
        if measurements.censored.any():
            mean, variance = self._predicted().moments(self._setting)
            for i in np.flatnonzero(measurements.censored):
                here, spread = mean[flat[i]], variance[flat[i]]
                if spread > FLAT_DB2 / 2:  # as in Kriging, the level is taken to be the floor's
                    here, spread = gain[i], self.parameters.kernel.variance_db2
                pseudo = floor_reading(here, spread, gain[i], noise[i])
                keep[i] = pseudo is not None
                if pseudo is not None:
                    gain[i], noise[i] = pseudo
        waiting = self._grown(combined(flat[keep], gain[keep], noise[keep]))
        return LocalKrigingBelief(
            self._setting, self.measurements.extended(measurements), self._state, waiting
        )

    def _grown(self, coming: Readings) -> _Waiting:
        """What waits to be predicted from after ``coming`` as well, with the parameters fitted to
        it if that is due."""
        setting, waiting = self._setting, self._waiting
        old = waiting.readings
        known = np.zeros(self.scenario.grid.size, dtype=bool)
        known[old.cells[old.noise_db2 == 0]] = True
        news = ~known[coming.cells]
        coming = Readings(coming.cells[news], coming.gain_db[news], coming.noise_db2[news])
        if len(coming) == 0:
            return waiting
        merged = combined(
            np.concatenate([old.cells, coming.cells]),
            np.concatenate([old.gain_db, coming.gain_db]),
            np.concatenate([old.noise_db2, coming.noise_db2]),
        )
        changed = np.union1d(waiting.changed, coming.cells)
        if setting.predictor.refit and fit_is_due(len(merged), waiting.fitted_at):
            parameters = fit_to_survey(
                self.scenario.grid,
                setting.priors,
                merged,
                lambda cells: setting.flown_columns[cells],
            )
            return _Waiting(parameters, len(merged), merged, changed)
        return replace(waiting, readings=merged, changed=changed)

    def _predicted(self) -> _State:
        """The state with all readings in it, worked out at the first call."""
        setting, state, waiting = self._setting, self._state, self._waiting
        if len(waiting.changed) == 0:
            return state
        cells = self.scenario.grid.cells
        if waiting.fitted_at != state.fitted_at:
            fresh = replace(
                _unobserved(setting, waiting.parameters),
                readings=waiting.readings,
                fitted_at=waiting.fitted_at,
            )
            self._state = _predicted(setting, _with_trend(setting, fresh), np.arange(len(cells)))
        else:
            state = _with_trend(setting, replace(state, readings=waiting.readings))
            distance, _ = cKDTree(cells[waiting.changed]).query(cells)
            self._state = _predicted(
                setting, state, np.flatnonzero(distance <= state.reach + UNTIED)
            )
        self._waiting = replace(waiting, changed=waiting.changed[:0])
        return self._state

    def posterior(self) -> Posterior:
        if self._posterior is None:
            shape = self.scenario.grid.shape
            state = self._predicted()
            if len(self.measurements) == 0:
                state = _unobserved(self._setting, self._setting.expected)
            mean, variance = state.moments(self._setting)
            self._posterior = Posterior(mean.reshape(shape), variance.reshape(shape))
        return self._posterior
