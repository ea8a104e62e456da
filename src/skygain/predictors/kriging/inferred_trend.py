"""Kriging around a transmitter that nobody has located: every place it may stand at is weighed by
its likelihood.

Given the transmitter at t the model is Kriging with the trend h_t(q) = (1, −log₁₀‖q − t‖), and the
covariance of the field is the
same for every t. So one inverse factor R serves all of them: the observations enter the likelihood
of t only through the whitened columns R·h_t and R·y, as

    log p(y | t) = −½ rᵀr + ½ bᵀ(I + ΣM)⁻¹Σ b − ½ log det(I + ΣM),   M = H_tᵀH_t,  b = H_tᵀr,  r =
    R(y − h_t θ₀),  H_t = R h_t,

which are sums over rows of R that grow with the survey. log₁₀‖q − t‖ depends on the offset between
q and t alone, so one new row is whitened for all candidates by two FFTs. Candidates are all cells
of the map that are open at the transmitter's height, and all cells within `MARGIN_M` around the
map, equally likely before the first measurement.

The belief is the mixture over t. Its mean is linear in the candidates' trends and is computed with
all of them. Its variance, the mean of the variances plus the variance of the means, is computed
from `NODES` candidates of equal weight.
"""

from __future__ import annotations

__all__ = ["InferredTrend"]

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skygain.fields.gaussian_process import Flat, GaussianProcess
from skygain.fields.offset_sum import OffsetSum
from skygain.fields.offsets import at_flat_offsets, offset_distance_m
from skygain.predictors.kriging.parameters import CLOSEST_M, KrigingParameters
from skygain.predictors.kriging.trend import Trend
from skygain.scenario import Scenario

Array = NDArray[np.float64]

MARGIN_M = 108.0
"""how far outside the map the transmitter may stand"""
HEIGHT_M = 1.5
"""height at which it is taken to stand"""
NODES = 24
"""candidates that stand for the mixture in its variance"""
TEMPERATURE = 1.0
"""the log-likelihood is divided by this"""


class _Candidates:
    """Where the transmitter may stand: the cells of the map with a margin around it."""

    def __init__(self, scenario: Scenario) -> None:
        grid = scenario.grid
        self.margin = margin = int(np.ceil(MARGIN_M / grid.spacing_m))
        self.shape = (grid.shape[0] + 2 * margin, grid.shape[1] + 2 * margin)
        rows, cols = np.indices(self.shape).reshape(2, -1)
        inner = np.zeros(self.shape, dtype=bool)
        inner[margin : margin + grid.shape[0], margin : margin + grid.shape[1]] = True
        self.inner = np.flatnonzero(inner)
        """``[P]`` candidate in each cell of the map"""
        free = np.ones(self.shape, dtype=bool)
        free.ravel()[self.inner] = ~scenario.city.obstructed(HEIGHT_M).ravel()
        self.free = free.ravel()
        """``[Q]`` whether the transmitter may stand there"""
        self.curve = np.argsort(_interleaved(rows) | (_interleaved(cols) << 1), kind="stable")
        """``[Q]`` candidates along a curve that fills the plane, so that neighbours on it are
        neighbours on the ground"""
        self.flown = self._table(scenario, scenario.uav_altitude_m)
        self.predicted = self._table(scenario, scenario.prediction_altitude_m)
        self.flown_sum = OffsetSum(self.flown, margin)
        self.predicted_sum = OffsetSum(self.predicted, margin)

    def _table(self, scenario: Scenario, altitude_m: float) -> Array:
        """``[|row offset|, |column offset|]`` −log₁₀ of the distance."""
        rows, cols = scenario.grid.shape
        distance = offset_distance_m(
            (rows + self.margin, cols + self.margin),
            scenario.grid.spacing_m,
            altitude_m - HEIGHT_M,
        )
        return -np.log10(np.maximum(distance, CLOSEST_M))

    def columns(self, table: Array, candidates: Flat, cells: Flat) -> Array:
        """``[n, m]`` −log₁₀ of the distance from each of ``cells[n]`` of the map to each of
        ``candidates[m]``."""
        return at_flat_offsets(table, self.inner[cells], candidates, self.shape[1])


def _interleaved(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """Every bit of numbers below 2¹⁶ moved to twice its place."""
    x = bits.astype(np.int64)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = (x | (x << shift)) & mask
    return x


@dataclass(frozen=True, eq=False)
class _Nodes:
    """A few candidates that stand for all."""

    candidates: Flat
    """``[k]``"""
    weight: Array
    """``[k]`` sums to 1"""
    theta: Array
    """``[2, k]`` trend coefficients of each"""
    covariance: Array
    """``[2, 2, k]`` and their covariance"""


@dataclass(frozen=True, eq=False)
class _NodeMaps:
    """What the nodes say about the map."""

    constant: Array
    """``[P]`` what the observations do not explain of a constant"""
    distance: Array
    """``[k, P]`` and of each node's log-distance"""
    deviation: Array
    """``[k, P]`` each node's mean less that of the mixture"""


@dataclass(frozen=True, eq=False)
class InferredTrend(Trend):
    """The log-distance trend of a transmitter that may stand at any of Q candidates."""

    places: _Candidates
    """the candidates"""
    prior_mean: Array
    """``[2]`` θ₀"""
    prior_covariance: Array
    """``[2, 2]`` Σ"""
    gain_db: Array
    """``[v]`` observed values"""
    moments: Array
    """``[3, Q]`` sums over whitened rows: constant × distance, distance², gain × distance"""
    common: Array
    """``[3]`` the same without a candidate: constant², gain², gain × constant"""

    @classmethod
    def unobserved(cls, scenario: Scenario, parameters: KrigingParameters) -> InferredTrend:
        """The trend before any data."""
        places = _Candidates(scenario)
        start = cls(places, np.empty(0), np.empty(0), np.empty(0), np.empty(0), np.empty(0))
        return start.restarted(parameters)

    def restarted(self, parameters: KrigingParameters) -> InferredTrend:
        return InferredTrend(
            places=self.places,
            prior_mean=np.asarray(parameters.trend),
            prior_covariance=np.asarray(parameters.trend_covariance),
            gain_db=np.empty(0),
            moments=np.zeros((3, len(self.places.free))),
            common=np.zeros(3),
        )

    def extended(self, process: GaussianProcess, rows: Array, gain_db: Array) -> InferredTrend:
        constant, gain = rows.sum(axis=1), rows @ gain_db
        distance = self.places.flown_sum(rows, process.cells)
        added = np.stack(
            [constant @ distance, np.einsum("nq,nq->q", distance, distance), gain @ distance]
        )
        common = np.array([constant @ constant, gain @ gain, gain @ constant])
        return replace(
            self, gain_db=gain_db, moments=self.moments + added, common=self.common + common
        )

    @cached_property
    def _posterior(self) -> tuple[Array, Array, Array]:
        """Weight ``[Q]``, coefficients ``[2, Q]`` and their covariance ``[2, 2, Q]`` of every
        candidate."""
        (m1u, muu, bu), (m11, rr, b1) = self.moments, self.common
        (a, b), S = self.prior_mean, self.prior_covariance
        square = rr - 2 * (a * b1 + b * bu) + a * a * m11 + 2 * a * b * m1u + b * b * muu
        b1, bu = b1 - a * m11 - b * m1u, bu - a * m1u - b * muu
        # The 2 × 2 matrix I + ΣM of every candidate, its determinant and its inverse times Σ,
        # written out.
        a11, a12 = 1 + S[0, 0] * m11 + S[0, 1] * m1u, S[0, 0] * m1u + S[0, 1] * muu
        a21, a22 = S[1, 0] * m11 + S[1, 1] * m1u, 1 + S[1, 0] * m1u + S[1, 1] * muu
        determinant = a11 * a22 - a12 * a21
        c00, c01 = (
            (a22 * S[0, 0] - a12 * S[1, 0]) / determinant,
            (a22 * S[0, 1] - a12 * S[1, 1]) / determinant,
        )
        c11 = (a11 * S[1, 1] - a21 * S[0, 1]) / determinant
        shift0, shift1 = c00 * b1 + c01 * bu, c01 * b1 + c11 * bu
        log_weight = (
            -0.5 * (square - b1 * shift0 - bu * shift1) - 0.5 * np.log(determinant)
        ) / TEMPERATURE
        log_weight = np.where(self.places.free, log_weight, -np.inf)
        weight = np.exp(log_weight - log_weight.max())
        return (
            weight / weight.sum(),
            np.stack([a + shift0, b + shift1]),
            np.array([[c00, c01], [c01, c11]]),
        )

    @property
    def weight(self) -> Array:
        """``[row, col]`` probability of each candidate, on the map with its margin."""
        return self._posterior[0].reshape(self.places.shape)

    @cached_property
    def _nodes(self) -> _Nodes:
        weight, theta, covariance = self._posterior
        # Equal shares of the weight along the curve: where the transmitter is all but certain, the
        # nodes coincide.
        along = np.cumsum(weight[self.places.curve])
        picked = np.searchsorted(along, (np.arange(NODES) + 0.5) / NODES * along[-1])
        candidates, count = np.unique(self.places.curve[picked], return_counts=True)
        return _Nodes(candidates, count / NODES, theta[:, candidates], covariance[:, :, candidates])

    @cached_property
    def _trend_map(self) -> tuple[Array, Array]:
        """Mean of the trend where the UAVs fly and where the gain is predicted, ``[P]`` each."""
        weight, theta, _ = self._posterior
        level, slope = weight @ theta[0], (weight * theta[1])[None]
        predicted = level + self.places.predicted_sum.back(slope)[0]
        if np.array_equal(self.places.flown, self.places.predicted):
            return predicted, predicted
        return level + self.places.flown_sum.back(slope)[0], predicted

    def mean(self, process: GaussianProcess) -> Array:
        flown, predicted = self._trend_map
        residual = self.gain_db - flown[process.cells]
        weights = process.factor.transposed_times(process.factor.times(residual[:, None]))
        return predicted + process.to_prediction.to_map(weights.T, process.cells)[0]

    def _maps(self, process: GaussianProcess) -> _NodeMaps:
        cached: _NodeMaps | None = self.__dict__.get("_cached_maps")
        if cached is None:
            nodes, factor = self._nodes, process.factor
            everywhere = np.arange(len(self.places.inner))
            observed = self.places.columns(self.places.flown, nodes.candidates, process.cells)
            columns = np.column_stack([self.gain_db, np.ones(len(process.cells)), observed])
            weights = factor.transposed_times(factor.times(columns))
            explained = process.to_prediction.to_map(weights.T, process.cells)
            constant = 1 - explained[1]
            distance = (
                self.places.columns(self.places.predicted, nodes.candidates, everywhere).T
                - explained[2:]
            )
            means = (
                explained[0]
                + nodes.theta[0][:, None] * constant
                + nodes.theta[1][:, None] * distance
            )
            cached = _NodeMaps(constant, distance, means - self.mean(process))
            self.__dict__["_cached_maps"] = cached
        return cached

    def variance(self, process: GaussianProcess) -> Array:
        maps, nodes = self._maps(process), self._nodes
        c = nodes.weight * nodes.covariance
        within = c[0, 0].sum() * maps.constant**2 + 2 * maps.constant * (c[0, 1] @ maps.distance)
        return within + c[1, 1] @ maps.distance**2 + nodes.weight @ maps.deviation**2

    def covariance(self, process: GaussianProcess, first: Flat, second: Flat) -> Array:
        maps, nodes = self._maps(process), self._nodes
        c = nodes.weight * nodes.covariance
        constant, distance, deviation = maps.constant, maps.distance, maps.deviation
        cross = np.outer(constant[first], c[0, 1] @ distance[:, second]) + np.outer(
            c[0, 1] @ distance[:, first], constant[second]
        )
        within = c[0, 0].sum() * np.outer(constant[first], constant[second]) + cross
        within += (distance[:, first].T * c[1, 1]) @ distance[:, second]
        return within + (deviation[:, first].T * nodes.weight) @ deviation[:, second]

    def at(
        self, process: GaussianProcess, gain_db: Array, cell: int, whitened: Array
    ) -> tuple[float, float]:
        nodes = self._nodes
        weights = process.factor.transposed_times(whitened[:, None])[:, 0]
        columns = self.places.columns(
            self.places.flown, nodes.candidates, np.append(process.cells, cell)
        )
        constant, distance = 1 - weights.sum(), columns[-1] - weights @ columns[:-1]
        means = weights @ gain_db + nodes.theta[0] * constant + nodes.theta[1] * distance
        c = nodes.covariance
        within = c[0, 0] * constant**2 + 2 * c[0, 1] * constant * distance + c[1, 1] * distance**2
        mean = nodes.weight @ means
        return float(mean), float(nodes.weight @ (within + (means - mean) ** 2))

    def columns(self, cells: Flat) -> Array:
        """The constant and the log-distance averaged over the candidates."""
        averaged = self.places.flown_sum.back(self._posterior[0][None])[0]
        return np.column_stack([np.ones(len(cells)), averaged[cells]])
