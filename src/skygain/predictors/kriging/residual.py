"""Kriging of what another predictor gets wrong at the measured cells.

With mean m and standard deviation s of the other predictor, the residuals z = (y − m)/s at the n
measured cells are taken for one field of unit variance with correlation ρ(d)
(`skygain.fields.residual_field`). The mean becomes m + s·ρᵀR⁻¹z and the variance s²·(1 − ρᵀR⁻¹ρ),
with R the correlation of the measured cells and ρ theirs with the cell; noisy readings add their
variance over s² to the
diagonal of R. Exact readings are reproduced. It takes any mean: a network's, a regression's, one's
own.
"""

from __future__ import annotations

__all__ = ["ResidualKrigingBelief", "ResidualKrigingPredictor"]

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve

from skygain.fields.offsets import at_flat_offsets
from skygain.fields.residual_field import SMALLEST_VARIANCE, CorrelationModel
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.posterior import JointPosterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import combined
from skygain.predictors.networks.network_belief import NetworkBelief
from skygain.scenario import Scenario

Array = NDArray[np.float64]
Flat = NDArray[np.int64]

VARIANCE_FLOOR_DB2 = 1e-2
"""smallest variance of the other predictor that residuals are divided by"""
NETWORK_CORRELATION = CorrelationModel(length_m=15.0, far_share=0.0, nugget=0.3)
"""a network that has seen the readings leaves errors of short range"""


@dataclass(frozen=True)
class ResidualKrigingPredictor(Predictor):
    """``residual-kriging:of=unet`` and the like; see the module."""

    of: str | Predictor = "unet"
    """name of the predictor that gives the mean, or one built already"""
    correlation: CorrelationModel = NETWORK_CORRELATION
    """of its standardised residual"""

    @cached_property
    def _base(self) -> Predictor:
        if isinstance(self.of, Predictor):
            return self.of
        from skygain.predictors import create_predictor

        if self.of == "residual-kriging":
            raise InputError(
                "residual Kriging needs another predictor for its mean; name one with of="
            )
        return create_predictor(self.of)

    @property
    def transmitter(self) -> Literal["required", "optional", "unused"]:  # type: ignore[override]
        """As the other predictor's."""
        return self._base.transmitter

    @property
    def needs_gain(self) -> bool:  # type: ignore[override]
        """As the other predictor."""
        return self._base.needs_gain

    def outside_training(
        self, scenario: Scenario, *, uavs: int | None = None, quantity: str = "gain"
    ) -> str:
        return self._base.outside_training(scenario, uavs=uavs, quantity=quantity)

    def begin(self, scenario: Scenario) -> ResidualKrigingBelief:
        """The other predictor's belief before the first measurement.

        Raises:
            InputError: flight and prediction differ in altitude, or the other predictor leaves no
                residual.
        """
        if scenario.uav_altitude_m != scenario.prediction_altitude_m:
            raise InputError(
                "residual Kriging maps the altitude it measures at, got flight at "
                f"{scenario.uav_altitude_m:g} m and prediction at "
                f"{scenario.prediction_altitude_m:g} m; make them equal or use the predictor "
                "'operator'"
            )
        other = self._base.begin(scenario)
        if self._base.interpolates and not isinstance(other, NetworkBelief):
            raise InputError(
                f"the predictor {self.of!r} passes through the readings by itself and leaves no "
                "residual; name a network, "
                "or a predictor with interpolates = False"
            )
        return ResidualKrigingBelief(other, self.correlation)


@dataclass(frozen=True, eq=False)
class _Residual:
    """The standardised residual of a map: one field of unit variance, measured at some cells."""

    table: Array
    """``[|row offset|, |column offset|]`` its correlation"""
    cells: Flat
    """``[n]`` raveled measured cells"""
    exact: Flat
    """those of them that were measured without noise"""
    factor: Any
    """Cholesky factor of the measured cells' correlation, noise included"""

    @classmethod
    def at(cls, table: Array, cells: Flat, noise_share: Array) -> _Residual:
        """Measured at ``cells[n]`` with noise of variance ``noise_share[n]``, in the field's."""
        R = at_flat_offsets(table, cells, cells, table.shape[1])
        R[np.diag_indices_from(R)] += noise_share + SMALLEST_VARIANCE
        return cls(table, cells, cells[noise_share == 0], cho_factor(R, lower=True))

    def correlation(self, first: Flat, second: Flat) -> Array:
        """``[n, m]`` before any reading."""
        return at_flat_offsets(self.table, first, second, self.table.shape[1])

    def explained(self, first: Flat, second: Flat) -> Array:
        """``[n, m]`` the part of it that the readings take away."""
        return self.correlation(self.cells, first).T @ cho_solve(
            self.factor, self.correlation(self.cells, second)
        )

    def on_the_map(self, residual: Array) -> tuple[Array, Array]:
        """Mean ``[P]`` of the field given ``residual[n]``, and the share of the variance that is
        left."""
        cross = self.correlation(self.cells, np.arange(self.table.size))
        solved = cho_solve(self.factor, cross)
        left = np.maximum(1.0 - np.einsum("ij,ij->j", cross, solved), 0.0)
        left[self.exact] = 0.0
        return residual @ solved, left


@dataclass(frozen=True, eq=False, repr=False)
class ResidualPosterior(JointPosterior):
    """The other predictor's map with its residual put right."""

    std: Array = field(repr=False)
    """``[P]`` standard deviation of the other predictor in dB"""
    left: Array = field(repr=False)
    """``[P]`` share of its variance that is left"""
    residual: _Residual = field(repr=False)
    """the standardised residual"""

    def covariance(self, cells: ArrayLike, others: ArrayLike | None = None) -> Array:
        first = self._flat(cells)
        second = first if others is None else self._flat(others)
        shared = self.residual.correlation(first, second) - self.residual.explained(first, second)
        shared[np.isin(first, self.residual.exact)] = 0.0
        shared[:, np.isin(second, self.residual.exact)] = 0.0
        i, j = np.nonzero(first[:, None] == second)
        shared[i, j] = self.left[first[i]]
        return shared * self.std[first][:, None] * self.std[second]

    def _flat(self, cells: ArrayLike) -> Flat:
        cells = np.asarray(cells, dtype=np.int64)
        return cells[:, 0] * self.mean_db.shape[1] + cells[:, 1]


@dataclass(frozen=True, eq=False)
class ResidualKrigingBelief(Belief):
    """The other belief and the correlation of what it gets wrong."""

    other: Belief
    """gives mean and variance; knows all readings"""
    model: CorrelationModel
    """of its standardised residual"""

    @property
    def scenario(self) -> Scenario:  # type: ignore[override]
        return self.other.scenario

    @property
    def measurements(self) -> Measurements:  # type: ignore[override]
        return self.other.measurements

    def updated(self, measurements: Measurements) -> ResidualKrigingBelief:
        return replace(self, other=self.other.updated(measurements))

    def posterior(self) -> ResidualPosterior:
        return self._posterior

    @cached_property
    def _posterior(self) -> ResidualPosterior:
        grid, (mean_db, variance_db2), data = self.scenario.grid, self._prior, self.measurements
        data = data.taken(
            np.flatnonzero(~data.censored)
        )  # a reading at the receiver's floor has no residual
        readings = combined(grid.flat(data.cell), data.gain_db, data.noise_std_db**2)
        mean, at = mean_db.ravel().copy(), readings.cells
        std = np.sqrt(np.maximum(variance_db2.ravel(), VARIANCE_FLOOR_DB2))
        residual = _Residual.at(
            self.model.table(grid.shape, grid.spacing_m).astype(float),
            at,
            readings.noise_db2 / std[at] ** 2,
        )
        explained, left = residual.on_the_map((readings.gain_db - mean[at]) / std[at])
        mean += std * explained
        mean[residual.exact] = readings.gain_db[readings.noise_db2 == 0]
        return ResidualPosterior(
            mean.reshape(grid.shape), (left * std**2).reshape(grid.shape), std, left, residual
        )

    @property
    def _prior(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and variance of the other predictor; a network's as they are before exact readings
        are written over them."""
        if isinstance(self.other, NetworkBelief):
            return self.other.network_maps()
        posterior = self.other.posterior()
        return posterior.mean_db, posterior.variance_db2
