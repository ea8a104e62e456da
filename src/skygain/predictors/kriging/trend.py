"""The part of a Kriging model that is not the random field: a trend whose coefficients are learned
along with it.

A trend is grown by the rows that new observations add to the inverse factor R (see
`skygain.fields.gaussian_process`), and answers for the mean and for the variance that its own
uncertainty adds. `FixedTrend` knows its columns h(q); the trend that has to find the transmitter
first is `skygain.predictors.kriging.inferred_trend.InferredTrend`.
"""

from __future__ import annotations

__all__ = ["FixedTrend", "Trend"]

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skygain.fields.gaussian_process import Flat, GaussianProcess
from skygain.predictors.kriging.parameters import KrigingParameters

Array = NDArray[np.float64]


class Trend(ABC):
    """What is known of the trend at some stage of a survey. Immutable."""

    @abstractmethod
    def restarted(self, parameters: KrigingParameters) -> Trend:
        """The same trend before any data, with other parameters."""

    @abstractmethod
    def extended(self, process: GaussianProcess, rows: Array, gain_db: Array) -> Trend:
        """The trend after the observations that added ``rows[n, v]`` to the inverse factor;
        ``process`` and ``gain_db[v]`` hold them already."""

    @abstractmethod
    def mean(self, process: GaussianProcess) -> Array:
        """``[P]`` mean of the gain, trend and field together, at every predicted cell."""

    @abstractmethod
    def variance(self, process: GaussianProcess) -> Array:
        """``[P]`` variance that not knowing the trend adds to that of the field."""

    @abstractmethod
    def covariance(self, process: GaussianProcess, first: Flat, second: Flat) -> Array:
        """``[n, m]`` covariance that not knowing the trend adds between raveled cells ``first[n]``
        and ``second[m]``."""

    @abstractmethod
    def at(
        self, process: GaussianProcess, gain_db: Array, cell: int, whitened: Array
    ) -> tuple[float, float]:
        """Mean of the gain and added variance at one raveled cell of the plane that is flown.

        ``whitened[v]`` is the covariance of the cell with each innovation, ``gain_db[v]`` what was
        observed.
        """

    @abstractmethod
    def columns(self, cells: Flat) -> Array:
        """``[n, k]`` columns h(q) at raveled ``cells[n]`` of the plane that is flown, for the fit
        of the covariance."""


@dataclass(frozen=True, eq=False)
class FixedTrend(Trend):
    """m(q) = h(q)ᵀθ with known h and θ ~ N(θ₀, Σ).

    θ enters linearly, so the data's posterior of it is normal, and exact: with H and y whitened by
    R its covariance is (Σ⁻¹ + HᵀH)⁻¹, here in the form (I + ΣHᵀH)⁻¹Σ, which also holds for Σ = 0.
    """

    flown_columns: Array
    """``[P, k]`` h(q) where the UAVs measure"""
    predicted_columns: Array
    """``[P, k]`` h(q) where the gain is predicted"""
    prior_mean: Array
    """``[k]`` θ₀"""
    prior_covariance: Array
    """``[k, k]`` Σ"""
    information: Array
    """``[k, k]`` HᵀH, both whitened"""
    score: Array
    """``[k]`` Hᵀ(y − Hθ₀), both whitened"""
    whitened: Array
    """``[v, 1 + k]`` y − Hθ₀ and H, whitened"""

    @classmethod
    def unobserved(
        cls, flown_columns: Array, predicted_columns: Array, parameters: KrigingParameters
    ) -> FixedTrend:
        """The trend before any data."""
        k = len(parameters.trend)
        return cls(
            flown_columns=flown_columns,
            predicted_columns=predicted_columns,
            prior_mean=np.asarray(parameters.trend),
            prior_covariance=np.asarray(parameters.trend_covariance),
            information=np.zeros((k, k)),
            score=np.zeros(k),
            whitened=np.empty((0, 1 + k)),
        )

    def restarted(self, parameters: KrigingParameters) -> FixedTrend:
        return FixedTrend.unobserved(self.flown_columns, self.predicted_columns, parameters)

    def extended(self, process: GaussianProcess, rows: Array, gain_db: Array) -> FixedTrend:
        h = self.flown_columns[process.cells]
        columns = rows @ h
        residual = rows @ (gain_db - h @ self.prior_mean)
        return replace(
            self,
            information=self.information + columns.T @ columns,
            score=self.score + columns.T @ residual,
            whitened=np.concatenate([self.whitened, np.column_stack([residual, columns])]),
        )

    def _maps(self, process: GaussianProcess) -> tuple[Array, Array]:
        """Mean of the field for θ = θ₀, ``[P]``, and what of each column the observations do not
        explain, ``[k, P]``."""
        kept: tuple[Array, Array] | None = self.__dict__.get("_kept_maps")
        if kept is None:
            weights = process.factor.transposed_times(self.whitened)
            explained = process.to_prediction.to_map(weights.T, process.cells)
            kept = explained[0], self.predicted_columns.T - explained[1:]
            self.__dict__["_kept_maps"] = kept
        return kept

    @cached_property
    def coefficients(self) -> tuple[Array, Array]:
        """Mean ``[k]`` and covariance ``[k, k]`` of θ given the data."""
        k = len(self.prior_mean)
        covariance = np.linalg.solve(
            np.eye(k) + self.prior_covariance @ self.information, self.prior_covariance
        )
        covariance = (covariance + covariance.T) / 2
        return self.prior_mean + covariance @ self.score, covariance

    def mean(self, process: GaussianProcess) -> Array:
        (theta, _), (shadowing, leftover) = self.coefficients, self._maps(process)
        return (
            self.predicted_columns @ self.prior_mean
            + shadowing
            + (theta - self.prior_mean) @ leftover
        )

    def variance(self, process: GaussianProcess) -> Array:
        (_, covariance), (_, leftover) = self.coefficients, self._maps(process)
        return np.einsum("kp,kp->p", leftover, covariance @ leftover)

    def covariance(self, process: GaussianProcess, first: Flat, second: Flat) -> Array:
        (_, covariance), (_, leftover) = self.coefficients, self._maps(process)
        return leftover[:, first].T @ covariance @ leftover[:, second]

    def at(
        self, process: GaussianProcess, gain_db: Array, cell: int, whitened: Array
    ) -> tuple[float, float]:
        theta, covariance = self.coefficients
        weights = process.factor.transposed_times(whitened[:, None])[:, 0]
        leftover = self.flown_columns[cell] - weights @ self.flown_columns[process.cells]
        return float(leftover @ theta + weights @ gain_db), float(leftover @ covariance @ leftover)

    def columns(self, cells: Flat) -> Array:
        return self.flown_columns[cells]
