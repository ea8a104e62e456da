"""Kriging: a trend, a Gaussian process around it, and beliefs that grow with the survey (paper, section VII-A).

The gain is modelled as y(q) = h(q)ᵀθ + g(q) with θ ~ N(θ₀, Σ) and g a zero-mean field with covariance φ exp(−d/δ) + ν·1[d = 0].
With Σ = 0 this is the paper's simple Kriging around a fixed path-loss line. With the trained Σ the survey also learns its own θ,
which the paper does not do; the answer is still exact, since θ enters linearly.

Every ``updated`` appends to the inverse Cholesky factor (see `skygain.predictors.gaussian_process`) and to two maps. At
scheduled sizes, when the number of observations passes 10, 15, 23, … (half as many again each time), the covariance is first
fitted to the survey anew (see `skygain.predictors.kriging_fit`) and everything is rebuilt once.

Readings at the receiver's floor say only "this or less". Each is taken in as the normal reading that moves the belief at its
cell to the mean and variance of its normal cut off at the floor (assumed-density filtering), unless the belief already expects
a reading at the floor there, with a probability of 0.9 or more: then it is no news, and counting it again would feign certainty.
"""

from __future__ import annotations

__all__ = ["KrigingBelief", "KrigingPredictor", "blind_kriging", "quadratic_kriging"]

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import log_ndtr, ndtr

from skygain.errors import InputError
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.posterior import GaussianProcessPosterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.gaussian_process import KNOWN, CellKernel, GaussianProcess
from skygain.predictors.kriging_fit import fit_to_survey
from skygain.predictors.kriging_parameters import TRENDS, KrigingParameters, generic_parameters, trained_parameters, trend_columns
from skygain.predictors.readings import Readings, checked_flat, combined
from skygain.scenario import Scenario

Array = NDArray[np.float64]

FIRST_FIT = 3
"""observations at which the covariance is fitted for the first time"""
FIT_GROWTH = 1.5
"""it is fitted again when there are this many times as many"""
FIT_ROWS = 300
"""observations used for one fit; more of them change the estimate little and cost their cube"""
GENERIC_LOG_ODDS = -2.0
"""log odds, before any data, that a place is nothing like the cities of the training"""
FLAT_LOG_ODDS = -3.0
"""log odds, before any data, that the gain does not follow the trained path-loss line at all; the other way round where the
transmitter is no street-level one or the receivers do not fly, since nothing of that kind was trained on"""
SPREAD_OUT = 0.35
"""how widely the observations must be scattered, in terms of an even spread, before they may choose between priors"""
TRAINED_TRANSMITTER_M = 5.0
"""height up to which a transmitter counts as one at street level; the trained ones stand at 1.5 m"""
TRAINED_RECEIVER_M = 5.0
"""altitude from which a receiver counts as flying; the trained ones fly at 10 to 30 m"""
EXPECTED_FLOOR = 0.9
"""a reading at the floor is left out where the belief gives it at least this probability"""
BATCH = 32
"""observations taken in at a time, which bounds the memory of one update"""


@dataclass(frozen=True)
class KrigingPredictor(Predictor):
    """Kriging around ``trend``; the default needs the transmitter's position.

    Raises:
        InputError: unknown trend, or parameters with another number of trend coefficients.
    """

    trend: str = "log-distance"
    """``"log-distance"``, ``"constant"`` or ``"quadratic"``"""
    parameters: KrigingParameters | None = None
    """trend and covariance to start from; ``None`` takes the trained ones for the scenario's altitudes"""
    refit: bool = True
    """fit the covariance to the survey's own data on the schedule; ``False`` keeps the parameters as they are"""
    transmitter: Literal["required", "optional", "unused"] = field(init=False, repr=False, default="unused")
    """only the log-distance trend needs the transmitter's position"""

    def __post_init__(self) -> None:
        if self.trend not in TRENDS:
            raise InputError(f"unknown trend {self.trend!r}; known: {', '.join(TRENDS)}")
        expected = {"log-distance": 2, "constant": 1, "quadratic": 6}[self.trend]
        if self.parameters is not None and len(self.parameters.trend) != expected:
            raise InputError(
                f"a {self.trend} trend has {expected} coefficients, but the parameters give {len(self.parameters.trend)}"
            )
        object.__setattr__(self, "transmitter", "required" if self.trend == "log-distance" else "unused")

    def begin(self, scenario: Scenario) -> KrigingBelief:
        """The belief before the first measurement.

        Raises:
            InputError: the trend needs a transmitter and the scenario has none.
        """
        trend = trend_columns(self.trend, scenario.grid, scenario.prediction_altitude_m, scenario.transmitter_m)
        flown = trend
        if scenario.uav_altitude_m != scenario.prediction_altitude_m:
            flown = trend_columns(self.trend, scenario.grid, scenario.uav_altitude_m, scenario.transmitter_m)
        setting = _Setting(self, scenario, self.trained(scenario), flown, trend)
        return KrigingBelief(setting, Measurements.none(), _fresh(setting, setting.trained))

    def trained(self, scenario: Scenario) -> KrigingParameters:
        """What a survey of ``scenario`` starts from."""
        return self.parameters or trained_parameters(self.trend, scenario.prediction_altitude_m)

    def priors(self, scenario: Scenario) -> list[tuple[KrigingParameters, float]]:
        """What the fit chooses from, the likeliest first, with the logarithm of the odds."""
        if self.parameters is not None:
            return [(self.parameters, 0.0)]
        trained = self.trained(scenario)
        generic = generic_parameters(self.trend)
        if self.trend != "log-distance":
            return [(trained, 0.0), (generic, GENERIC_LOG_ODDS)]
        flat = trained_parameters("constant", scenario.prediction_altitude_m)
        flat = replace(flat, trend=(*flat.trend, 0.0), trend_covariance=((flat.trend_covariance[0][0], 0.0), (0.0, 0.0)))
        assert scenario.transmitter_m is not None
        if scenario.transmitter_m[2] <= TRAINED_TRANSMITTER_M and scenario.uav_altitude_m >= TRAINED_RECEIVER_M:
            return [(trained, 0.0), (flat, FLAT_LOG_ODDS), (generic, GENERIC_LOG_ODDS)]
        return [(flat, 0.0), (trained, FLAT_LOG_ODDS), (generic, GENERIC_LOG_ODDS)]


def blind_kriging(**options: object) -> KrigingPredictor:
    """Kriging that does not know the transmitter: constant trend."""
    return KrigingPredictor(trend="constant", **options)  # type: ignore[arg-type]


def quadratic_kriging(**options: object) -> KrigingPredictor:
    """Kriging that does not know the transmitter: second-order trend."""
    return KrigingPredictor(trend="quadratic", **options)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class _Setting:
    """What stays the same through a survey."""

    predictor: KrigingPredictor
    scenario: Scenario
    trained: KrigingParameters
    flown_columns: Array  # [P, k] trend columns where the UAVs measure
    columns: Array  # [P, k] trend columns where the gain is predicted

    @property
    def one_plane(self) -> bool:
        return self.scenario.uav_altitude_m == self.scenario.prediction_altitude_m


@dataclass(frozen=True, eq=False)
class _State:
    """Everything that follows from the parameters and the observations."""

    parameters: KrigingParameters
    process: GaussianProcess
    gain_db: Array  # [v] observed values
    whitened_columns: Array  # [v, k] R h at the observed cells
    whitened_residual: Array  # [v] R (y − h θ₀)
    shadowing: Array  # [P] mean of g for θ = θ₀
    leftover: Array  # [k, P] what of each trend column the observations do not explain at every cell
    fitted_at: int  # observations at the last fit
    exact: NDArray[np.bool_] = field(repr=False)  # [P] cells that were read exactly
    exact_gain_db: Array = field(repr=False)  # [P] what was read there

    def trend_posterior(self) -> tuple[Array, Array]:
        """Mean ``[k]`` and covariance ``[k, k]`` of θ − θ₀ given the data."""
        sigma = np.asarray(self.parameters.trend_covariance)
        white = self.whitened_columns
        covariance = np.linalg.solve(np.eye(len(sigma)) + sigma @ (white.T @ white), sigma)
        covariance = (covariance + covariance.T) / 2
        return covariance @ (white.T @ self.whitened_residual), covariance

    def moments(self, setting: _Setting) -> tuple[Array, Array]:
        """Mean and variance ``[P]`` of the gain at every cell."""
        shift, covariance = self.trend_posterior()
        trend = np.asarray(self.parameters.trend)
        mean = setting.columns @ trend + self.shadowing + shift @ self.leftover
        variance = self.process.prior.variance_db2 - self.process.reduction_db2
        variance += np.einsum("kp,kl,lp->p", self.leftover, covariance, self.leftover)
        if setting.one_plane:
            mean[self.exact] = self.exact_gain_db[self.exact]
            variance[self.exact] = 0.0
        return mean, np.maximum(variance, 0.0)


def _fresh(setting: _Setting, parameters: KrigingParameters) -> _State:
    """The state without observations."""
    grid = setting.scenario.grid
    gap = abs(setting.scenario.uav_altitude_m - setting.scenario.prediction_altitude_m)
    kernel = CellKernel(grid.shape, grid.spacing_m, parameters.sill_db2, parameters.range_m, parameters.nugget_db2)
    process = GaussianProcess.unobserved(kernel, kernel if gap == 0 else replace(kernel, gap_m=gap), kernel)
    width = len(parameters.trend)
    return _State(
        parameters=parameters,
        process=process,
        gain_db=np.empty(0),
        whitened_columns=np.empty((0, width)),
        whitened_residual=np.empty(0),
        shadowing=np.zeros(grid.size),
        leftover=setting.columns.T.copy(),
        fitted_at=0,
        exact=np.zeros(grid.size, dtype=bool),
        exact_gain_db=np.zeros(grid.size),
    )


def _with_rows(setting: _Setting, state: _State, readings: Readings) -> _State:
    """The state after a few more observations at distinct cells."""
    process, new = state.process.observed(readings.cells, readings.noise_db2)
    gain = np.concatenate([state.gain_db, readings.gain_db])
    columns = setting.flown_columns[process.cells]
    white_columns = new.rows @ columns
    white_residual = new.rows @ (gain - columns @ np.asarray(state.parameters.trend))
    exact, exact_gain = state.exact, state.exact_gain_db
    which = readings.noise_db2 == 0
    if which.any():
        exact, exact_gain = exact.copy(), exact_gain.copy()
        exact[readings.cells[which]] = True
        exact_gain[readings.cells[which]] = readings.gain_db[which]
    return replace(
        state,
        process=process,
        gain_db=gain,
        whitened_columns=np.concatenate([state.whitened_columns, white_columns]),
        whitened_residual=np.concatenate([state.whitened_residual, white_residual]),
        shadowing=state.shadowing + white_residual @ new.maps,
        leftover=state.leftover - white_columns.T @ new.maps,
        exact=exact,
        exact_gain_db=exact_gain,
    )


def _with_readings(setting: _Setting, state: _State, readings: Readings) -> _State:
    """The state after any number of observations at distinct cells; what is known exactly already is left out."""
    news = ~state.exact[readings.cells]
    for first in range(0, len(readings), BATCH):
        part = slice(first, first + BATCH)
        keep = news[part]
        if keep.any():
            some = Readings(readings.cells[part][keep], readings.gain_db[part][keep], readings.noise_db2[part][keep])
            state = _with_rows(setting, state, some)
    return state


def _with_floor_reading(setting: _Setting, state: _State, cell: int, floor_db: float, noise_db2: float) -> _State:
    """The state after one reading that says the gain at raveled ``cell`` is ``floor_db`` or less."""
    at = np.array([cell])
    white = state.process.factor.times(state.process.kernel.between(state.process.cells, at))[:, 0]
    shift, covariance = state.trend_posterior()
    column = setting.flown_columns[cell]
    leftover = column - white @ state.whitened_columns
    mean = column @ np.asarray(state.parameters.trend) + white @ state.whitened_residual + leftover @ shift
    variance = state.process.kernel.variance_db2 - white @ white + leftover @ covariance @ leftover
    if variance <= KNOWN * state.process.kernel.variance_db2:
        return state
    # The reading is the gain plus noise; it is that sum which is cut off at the floor.
    total = variance + noise_db2
    above = (floor_db - mean) / np.sqrt(total)
    if ndtr(above) >= EXPECTED_FLOOR:
        return state
    hazard = np.exp(-0.5 * above**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(above))
    shrink = min(hazard * (hazard + above), 1 - 1e-9)  # the cut lowers the variance of the sum by this share
    # The normal reading of the sum that has the same effect has this noise and this value.
    pseudo_noise = total * (1 / shrink - 1)
    pseudo_gain = mean - np.sqrt(total) * hazard / shrink
    return _with_rows(setting, state, Readings(at, np.array([pseudo_gain]), np.array([pseudo_noise + noise_db2])))


def _spread(xy_m: Array, grid: Grid) -> float:
    """How widely positions are scattered, 1 when evenly over the whole map."""
    rows, cols = grid.shape
    even = rows * cols * grid.spacing_m**2 / 12
    return float(np.sqrt(max(np.linalg.det(np.cov(xy_m.T)), 0.0)) / even)


class KrigingBelief(Belief):
    """What Kriging knows in the middle of a survey."""

    __slots__ = ("_posterior", "_setting", "_state", "measurements", "scenario")

    def __init__(self, setting: _Setting, measurements: Measurements, state: _State) -> None:
        self.scenario = setting.scenario
        self.measurements = measurements
        self._setting = setting
        self._state = state
        self._posterior: GaussianProcessPosterior | None = None

    @property
    def parameters(self) -> KrigingParameters:
        """Trend and covariance in use, as of the last fit."""
        return self._state.parameters

    @property
    def trend_db(self) -> tuple[Array, Array]:
        """Posterior mean ``[k]`` and covariance ``[k, k]`` of the trend's coefficients θ."""
        shift, covariance = self._state.trend_posterior()
        return np.asarray(self.parameters.trend) + shift, covariance

    def prior_covariance_db2(self, distance_m: ArrayLike) -> Array:
        """Covariance in dB² of the shadowing at two cells ``distance_m`` apart before any reading: φ exp(−d/δ) + ν·1[d = 0]."""
        distance, kernel = np.asarray(distance_m, dtype=float), self.parameters
        return kernel.sill_db2 * np.exp(-distance / kernel.range_m) + kernel.nugget_db2 * (distance == 0)

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
        state = _with_readings(self._setting, self._fitted(readings), readings)
        for i in np.flatnonzero(measurements.censored):
            state = _with_floor_reading(self._setting, state, int(flat[i]), float(measurements.gain_db[i]), float(noise[i]))
        return KrigingBelief(self._setting, self.measurements.extended(measurements), state)

    def _fitted(self, coming: Readings) -> _State:
        """The state to extend by ``coming``: rebuilt with parameters fitted to it as well, if the schedule says so."""
        state, setting = self._state, self._setting
        size = len(state.gain_db) + int((~state.exact[coming.cells]).sum())
        if not setting.predictor.refit or size < max(FIRST_FIT, FIT_GROWTH * state.fitted_at):
            return state
        old = combined(state.process.cells, state.gain_db, state.process.noise_db2)
        everything = combined(
            np.concatenate([old.cells, coming.cells]),
            np.concatenate([old.gain_db, coming.gain_db]),
            np.concatenate([old.noise_db2, coming.noise_db2]),
        )
        grid = self.scenario.grid
        # Which rows are left out depends on their cells only, so the order of the readings does not matter.
        rank = np.random.default_rng(0).permutation(grid.size)[everything.cells]
        rows = np.argsort(rank)[:FIT_ROWS]
        xy = grid.xy_m(grid.cells[everything.cells[rows]])
        priors = setting.predictor.priors(self.scenario)
        parameters = fit_to_survey(
            priors=priors if _spread(xy, grid) >= SPREAD_OUT else priors[:1],
            xy_m=xy,
            gain_db=everything.gain_db[rows],
            noise_db2=everything.noise_db2[rows],
            columns=setting.flown_columns[everything.cells[rows]],
        )
        rebuilt = _with_readings(setting, _fresh(setting, parameters), old)
        return replace(rebuilt, fitted_at=size)

    def posterior(self) -> GaussianProcessPosterior:
        if self._posterior is None:
            shape = self.scenario.grid.shape
            mean, variance = self._state.moments(self._setting)
            self._posterior = GaussianProcessPosterior(mean.reshape(shape), variance.reshape(shape), self._covariance)
        return self._posterior

    def _covariance(self, cells: NDArray[np.int64], others: NDArray[np.int64]) -> Array:
        """``[n, m]`` posterior covariance in dB² of the gain at ``cells[n]`` and ``others[m]``."""
        state, grid = self._state, self.scenario.grid
        first, second = grid.flat(cells), grid.flat(others)
        white_first = state.process.whitened(first)
        white_second = white_first if cells is others else state.process.whitened(second)
        _, trend = state.trend_posterior()
        covariance = state.process.prior.between(first, second) - white_first.T @ white_second
        covariance += state.leftover[:, first].T @ trend @ state.leftover[:, second]
        if self._setting.one_plane:
            covariance[state.exact[first]] = 0.0
            covariance[:, state.exact[second]] = 0.0
        return covariance
