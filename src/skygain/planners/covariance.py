"""What a planner may know about how cells vary together, whatever the belief can tell.

Planning needs covariances between many cells given the data so far, a few thousand at a time, several times per decision. Three
kinds of belief answer, and `planning_field` picks the best that is there:

1. a belief with a stationary prior (`HasStationaryPrior`, like Kriging): the covariance is computed here from the prior kernel and
   the readings, at most ``MAX_READINGS`` of them, the nearest. A nearer reading screens the farther ones off, so leaving those out
   changes little, it never understates a variance, and the cost of a decision does not grow with the survey;
2. a belief whose posterior is joint: its own ``covariance``;
3. any other belief, for example a deep one that knows only variances: the fallback
   k(x, x') = σ(x)·σ(x')·exp(−‖x − x'‖/δ_f) with the belief's own standard deviations and δ_f = ``FALLBACK_RANGE_M``.
   The standard deviations hold the data already, so they are not conditioned on again.
"""

from __future__ import annotations

__all__ = ["FALLBACK_RANGE_M", "MAX_READINGS", "HasStationaryPrior", "PlanningField", "planning_field"]

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from skygain.grid import Grid
from skygain.posterior import JointPosterior, Posterior
from skygain.predictors.base import Belief

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

MAX_READINGS = 600
"""readings conditioned on at once; the rest are screened off"""
FALLBACK_RANGE_M = 25.0
"""δ_f, decorrelation distance of what a deep belief still does not know"""
_JITTER = 1e-6
"""share of the prior variance added to the diagonal, which keeps exact readings of near cells invertible"""


@runtime_checkable
class HasStationaryPrior(Protocol):
    """A belief that began with the same covariance function everywhere."""

    def prior_covariance_db2(self, distance_m: ArrayLike) -> Array:
        """Prior covariance in dB² of the gains at two cells ``distance_m`` apart, in the shape of ``distance_m``."""


@dataclass(frozen=True, eq=False)
class PlanningField:
    """Covariances between cells given the data so far, and given cells that are planned to be measured."""

    grid: Grid
    """where the cells are"""
    posterior: Posterior
    """what the belief says now"""
    prior_covariance_db2: Callable[[ArrayLike], Array] | None
    """prior covariance by distance in metres, ``None`` without a stationary prior"""
    table: Array | None
    """``[|row offset|, |col offset|]`` the same by offset in cells"""
    cells: Cells
    """``[n, (row, col)]`` distinct measured cells"""
    noise_db2: Array
    """``[n]`` noise variance of the readings there, combined"""

    @property
    def is_stationary(self) -> bool:
        """Whether covariances come from a stationary prior and the readings."""
        return self.table is not None

    def prior(self, cells: Cells, others: Cells) -> Array:
        """``[n, m]`` covariance in dB² before any reading (case 1), or of the posterior itself (cases 2 and 3)."""
        if self.table is not None:
            rows = np.abs(cells[:, None, 0] - others[None, :, 0])
            cols = np.abs(cells[:, None, 1] - others[None, :, 1])
            return self.table[rows, cols]
        if isinstance(self.posterior, JointPosterior):
            return self.posterior.covariance(cells, others)
        gap = np.hypot(*(cells[:, None] - others[None]).transpose(2, 0, 1)) * self.grid.spacing_m
        std = self.posterior.std_db
        return std[cells[:, 0], cells[:, 1]][:, None] * std[others[:, 0], others[:, 1]] * np.exp(-gap / FALLBACK_RANGE_M)

    def near(self, centres: Cells, most: int = MAX_READINGS) -> PlanningField:
        """The same field, conditioned on only the ``most`` readings nearest to any of ``centres[k, (row, col)]``."""
        if len(self.cells) <= most:
            return self
        gap = np.min(np.sum((self.cells[:, None] - centres[None]) ** 2, axis=2), axis=1)
        keep = np.sort(np.argsort(gap, kind="stable")[:most])
        return replace(self, cells=self.cells[keep], noise_db2=self.noise_db2[keep])

    def whitener(self, planned: Cells, planned_noise_db2: float) -> tuple[Cells, Array]:
        """Cells to condition on (the readings', then ``planned``) and the Cholesky factor ``[n, n]`` of their covariance."""
        known = np.concatenate([self.cells, planned]) if self.is_stationary else planned
        noise = np.full(len(known), planned_noise_db2)
        if self.is_stationary:
            noise[: len(self.cells)] = self.noise_db2
        gram = self.prior(known, known)
        level = float(np.max(np.diag(gram))) if len(known) else 1.0
        gram[np.diag_indices_from(gram)] += noise + _JITTER * level
        return known, np.linalg.cholesky(gram)

    def whitened(self, known: Cells, factor: Array, cells: Cells) -> NDArray[np.float32]:
        """``[n, m]`` L⁻¹·K(known, cells), in single precision."""
        cross = self.prior(known, cells).astype(np.float32)
        return solve_triangular(factor.astype(np.float32), cross, lower=True, check_finite=False, overwrite_b=True)

    def covariance(self, cells: Cells, others: Cells | None = None) -> Array:
        """``[n, m]`` covariance in dB² given the readings, in double precision."""
        known, factor = self.whitener(np.empty((0, 2), dtype=np.int64), 0.0)
        left = solve_triangular(factor, self.prior(known, cells), lower=True, check_finite=False)
        if others is None:
            return self.prior(cells, cells) - left.T @ left
        right = solve_triangular(factor, self.prior(known, others), lower=True, check_finite=False)
        return self.prior(cells, others) - left.T @ right


def planning_field(belief: Belief) -> PlanningField:
    """The covariances of ``belief`` for planning, from the best source it has."""
    grid, posterior = belief.scenario.grid, belief.posterior()
    kernel = table = None
    cells, noise = np.empty((0, 2), dtype=np.int64), np.empty(0)
    if isinstance(belief, HasStationaryPrior):
        rows, cols = np.ogrid[: grid.shape[0], : grid.shape[1]]
        kernel = belief.prior_covariance_db2
        table = np.asarray(kernel(np.hypot(rows, cols) * grid.spacing_m), dtype=float)
        readings = belief.measurements
        flat, where = np.unique(grid.flat(readings.cell), return_inverse=True)
        cells = np.stack(np.divmod(flat, grid.shape[1]), axis=1)
        # several noisy readings of one cell are worth one of the harmonic variance; an exact one settles the cell
        precision = np.bincount(where, 1.0 / np.maximum(readings.noise_std_db**2, 1e-12), minlength=len(flat))
        noise = np.where(precision > 1e11, 0.0, 1.0 / np.maximum(precision, 1e-300))
    return PlanningField(grid, posterior, kernel, table, cells, noise)
