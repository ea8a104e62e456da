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

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from skygain.fields.residual_field import SMALLEST_VARIANCE, CorrelationModel
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.posterior import GaussianProcessPosterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import combined
from skygain.predictors.networks.network_belief import NetworkBelief
from skygain.scenario import Scenario

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

    def posterior(self) -> GaussianProcessPosterior:
        return self._posterior

    @cached_property
    def _posterior(self) -> GaussianProcessPosterior:
        grid, prior, data = self.scenario.grid, self._prior, self.measurements
        data = data.taken(
            np.flatnonzero(~data.censored)
        )  # a reading at the receiver's floor has no residual
        readings = combined(grid.flat(data.cell), data.gain_db, data.noise_std_db**2)
        mean, std = (
            prior[0].ravel().copy(),
            np.sqrt(np.maximum(prior[1].ravel(), VARIANCE_FLOOR_DB2)),
        )
        table = self.model.table(grid.shape, grid.spacing_m).astype(float)
        everywhere = np.arange(grid.size)

        def correlation(cells: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.float64]:
            (r, c), (i, j) = np.divmod(cells, grid.shape[1]), np.divmod(others, grid.shape[1])
            return table[np.abs(r[:, None] - i), np.abs(c[:, None] - j)]

        at = readings.cells
        R = correlation(at, at)
        R[np.diag_indices_from(R)] += readings.noise_db2 / std[at] ** 2 + SMALLEST_VARIANCE
        factor: Any = cho_factor(R, lower=True) if len(at) else None
        exact, known = readings.noise_db2 == 0, np.zeros(grid.size, dtype=bool)
        known[at[exact]] = True

        def explained(cells: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.float64]:
            if factor is None:
                return np.zeros((len(cells), len(others)))
            return correlation(at, cells).T @ cho_solve(factor, correlation(at, others))

        left = np.ones(grid.size)
        if factor is not None:
            cross = correlation(at, everywhere)
            solved = cho_solve(factor, cross)
            mean += std * (((readings.gain_db - mean[at]) / std[at]) @ solved)
            left = np.maximum(1.0 - np.einsum("ij,ij->j", cross, solved), 0.0)
            mean[at[exact]] = readings.gain_db[exact]
            left[known] = 0.0

        def covariance(cells: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.float64]:
            a, b = grid.flat(cells), grid.flat(others)
            shared = correlation(a, b) - explained(a, b)
            shared[known[a]] = 0.0
            shared[:, known[b]] = 0.0
            same = a[:, None] == b[None]
            shared[same] = np.broadcast_to(left[a][:, None], same.shape)[same]
            return shared * std[a][:, None] * std[b]

        return GaussianProcessPosterior(
            mean.reshape(grid.shape), (left * std**2).reshape(grid.shape), covariance
        )

    @property
    def _prior(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and variance of the other predictor; a network's as they are before exact readings
        are written over them."""
        if isinstance(self.other, NetworkBelief):
            return self.other.network_maps()
        posterior = self.other.posterior()
        return posterior.mean_db, posterior.variance_db2
