"""What a planner may know about how cells vary together, whatever the belief can tell.

Planning needs covariances between many cells given the data so far, a few thousand at a time,
several times per decision. Three kinds of belief answer, and `planning_field` picks the best that
is there:

1. a belief with a stationary prior (`skygain.posterior.HasStationaryPrior`, like Kriging): the
   covariance is computed here from the prior kernel and the readings nearest to where it is asked
   for. A nearer reading screens the farther ones off, so leaving those out changes little, it never
   understates a variance, and the cost of a decision does not grow with the survey;
2. a belief whose posterior is joint: its own ``covariance``;
3. any other belief, for example a deep one that knows only variances: the fallback
   k(x, x') = σ(x)·σ(x')·exp(−‖x − x'‖/δ_f) with the belief's own standard deviations and δ_f =
   ``FALLBACK_RANGE_M``. The standard deviations hold the data already, so they are not conditioned
   on again.
"""

from __future__ import annotations

__all__ = [
    "FALLBACK_RANGE_M",
    "Conditioned",
    "PlanningField",
    "less_product",
    "planning_field",
]

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_blas_funcs, solve_triangular

from skygain.fields.offsets import at_offsets, offset_distance_m
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.posterior import HasStationaryPrior, JointPosterior, Posterior
from skygain.scenario import Scenario

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

FALLBACK_RANGE_M = 60.0
"""δ_f, decorrelation distance of what a deep belief still does not know"""
JITTER = 1e-6
"""share of the prior variance added to the variance of a reading, which keeps exact readings of
near cells invertible"""


class Believing(Protocol):
    """What planning needs of a belief."""

    @property
    def scenario(self) -> Scenario: ...
    @property
    def measurements(self) -> Measurements: ...
    def posterior(self) -> Posterior: ...


@dataclass(frozen=True, eq=False)
class PlanningField:
    """Covariances between cells given the data so far."""

    grid: Grid
    """where the cells are"""
    posterior: Posterior
    """what the belief says now"""
    kernel: Callable[[Any], Any] | None
    """prior covariance by distance in metres; ``None`` without a stationary prior"""
    table: Array
    """``[|row offset|, |col offset|]`` the same by offset in cells; of size 0 without a stationary
    prior"""
    cells: Cells
    """``[n, (row, col)]`` distinct measured cells to condition on; none without a stationary
    prior"""
    noise_db2: Array
    """``[n]`` noise variance of the readings there, combined"""

    @property
    def level_db2(self) -> float:
        """Variance before any reading, or the largest there is without a stationary prior."""
        return (
            float(self.table[0, 0])
            if self.kernel
            else float(np.max(self.posterior.variance_db2, initial=1e-9))
        )

    def prior(self, cells: Cells, others: Cells, dtype: type = np.float64) -> NDArray[Any]:
        """``[n, m]`` covariance in dB² before the readings `cells` (case 1), or of the posterior
        itself (cases 2 and 3)."""
        if self.kernel:
            return at_offsets(self.table.astype(dtype), cells, others)
        if isinstance(self.posterior, JointPosterior):
            return self.posterior.covariance(cells, others).astype(dtype)
        gap = np.hypot(*(cells[:, None] - others[None]).transpose(2, 0, 1)) * self.grid.spacing_m
        std = self.posterior.std_db
        product = std[cells[:, 0], cells[:, 1]][:, None] * std[others[:, 0], others[:, 1]]
        return (product * np.exp(-gap / FALLBACK_RANGE_M)).astype(dtype)

    def near(self, centres: Cells, most: int, span: float = np.inf) -> PlanningField:
        """The same field, conditioned on only the ``most`` readings nearest to any of ``centres[k,
        (row, col)]``.

        Readings more than ``span`` cells away from all of them are left out too.
        """
        if len(self.cells) <= most and not np.isfinite(span):
            return self
        gap = np.min(np.sum((self.cells[:, None] - centres[None]) ** 2, axis=2), axis=1)
        keep = np.argsort(gap, kind="stable")[:most]
        keep = np.sort(keep[gap[keep] <= span**2])
        return replace(self, cells=self.cells[keep], noise_db2=self.noise_db2[keep])

    def conditioned(self, dtype: type = np.float64) -> Conditioned:
        """The field given its readings, ready to answer in precision ``dtype``."""
        gram = self.prior(self.cells, self.cells)
        gram[np.diag_indices_from(gram)] += self.noise_db2 + JITTER * self.level_db2
        return Conditioned(self, np.linalg.cholesky(gram).astype(dtype))


@dataclass(frozen=True, eq=False)
class Conditioned:
    """A planning field with the Cholesky factor of its readings."""

    field: PlanningField
    """the field"""
    factor: NDArray[Any]
    """``[n, n]`` lower Cholesky factor of the readings' covariance; its precision is that of all
    answers"""

    def whitened(self, cells: Cells) -> NDArray[Any]:
        """``[n, m]`` covariance of the whitened readings with ``cells[m, (row, col)]``."""
        cross = self.field.prior(self.field.cells, cells, self.factor.dtype.type)
        return solve_triangular(
            self.factor, cross, lower=True, check_finite=False, overwrite_b=True
        )

    def covariance(
        self,
        cells: Cells,
        others: Cells,
        white: NDArray[Any] | None = None,
        white_others: NDArray[Any] | None = None,
    ) -> NDArray[Any]:
        """``[n, m]`` covariance in dB² given the readings; pass what `whitened` gave for the cells
        to save computing it again."""
        white = self.whitened(cells) if white is None else white
        white_others = self.whitened(others) if white_others is None else white_others
        return less_product(
            self.field.prior(cells, others, self.factor.dtype.type), white, white_others
        )


def less_product(matrix: NDArray[Any], left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """``matrix[n, m]``, in rows, less ``left[k, n]``ᵀ ``right[k, m]``, in its own memory."""
    if matrix.size and len(left):
        gemm = get_blas_funcs("gemm", (matrix, left, right))
        gemm(-1.0, right, left, beta=1.0, c=matrix.T, trans_a=True, overwrite_c=True)
    return matrix


def planning_field(belief: Believing) -> PlanningField:
    """The covariances of ``belief`` for planning, from the best source it has."""
    grid, posterior = belief.scenario.grid, belief.posterior()
    if not isinstance(belief, HasStationaryPrior):
        return PlanningField(
            grid, posterior, None, np.empty((0, 0)), np.empty((0, 2), dtype=np.int64), np.empty(0)
        )
    distance_m = offset_distance_m(grid.shape, grid.spacing_m)
    table = np.asarray(belief.prior_covariance_db2(distance_m), dtype=float)
    readings = belief.measurements
    flat, where = np.unique(grid.flat(readings.cell), return_inverse=True)
    # several noisy readings of one cell are worth one of the harmonic variance; an exact one
    # settles the cell
    precision = np.bincount(
        where, 1.0 / np.maximum(readings.noise_std_db**2, 1e-12), minlength=len(flat)
    )
    cells = np.stack(np.divmod(flat, grid.shape[1]), axis=1)
    return PlanningField(
        grid, posterior, belief.prior_covariance_db2, table, cells, 1.0 / precision
    )
