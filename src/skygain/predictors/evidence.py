"""What the measurements say about hypotheses that each predict a mean and a standard deviation at every measured cell.

With z = (y − m)/s the standardised residual of a hypothesis and L the Cholesky factor of the residual's correlation,

    log likelihood = −(ν + n)/2 · log(1 + |u|²/ν) − Σ_i [log s(i) − log g′(z(i))],   u = L⁻¹ g(z),   g(z) = a·arcsinh(z/a):

a correlated Student likelihood of a residual whose overall scale is unknown, after g has taken the weight from gross errors (a
shadow edge a cell off, a reflection missed). The weight of a hypothesis is prior · likelihood^(κ/√n): the models are wrong in ways no
stationary field describes, and a power that falls with 1/√n gave the transmitter's true surroundings more probability than any
constant one, on surveys of T2 and T3 at 50, 100 and 200 steps alike.
"""

from __future__ import annotations

__all__ = ["Evidence", "Factor", "Rows", "posterior_weights"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from skygain.predictors.residual_field import CorrelationModel

Array = NDArray[np.floating]

SMALLEST = 1e-4
"""added to the diagonal"""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows appended to L by one update of m measurements."""

    side: Array
    """``[n, m]`` transposed block to the left of the diagonal"""
    corner: Array
    """``[m, m]`` lower triangular block on it"""


@dataclass(frozen=True, eq=False)
class Factor:
    """Cholesky factor of the correlation of the measured cells."""

    model: CorrelationModel
    """how the residual correlates"""
    spacing_m: float
    """side of a cell"""
    cells: NDArray[np.int64]
    """``[n, (row, col)]``"""
    L: Array
    """``[n, n]`` lower triangular"""

    @classmethod
    def empty(cls, model: CorrelationModel, spacing_m: float) -> Factor:
        """No measurement yet."""
        return cls(model, spacing_m, np.empty((0, 2), dtype=np.int64), np.empty((0, 0)))

    def grown(self, cells: NDArray[np.int64], noise_share: NDArray[np.float64]) -> tuple[Factor, Rows]:
        """With m more ``cells[m, (row, col)]`` whose noise variance is ``noise_share[m]`` of the model's; old factors stay valid."""
        n, m = len(self.cells), len(cells)
        cross, own = self._correlation(self.cells, cells), self._correlation(cells, cells)
        side = solve_triangular(self.L, cross, lower=True, check_finite=False) if n else cross
        corner = np.linalg.cholesky(own + np.diag(noise_share + SMALLEST) - side.T @ side)
        L = np.zeros((n + m, n + m))
        L[:n, :n], L[n:, :n], L[n:, n:] = self.L, side.T, corner
        return Factor(self.model, self.spacing_m, np.concatenate([self.cells, cells]), L), Rows(side.astype(np.float32), corner)

    def _correlation(self, one: NDArray[np.int64], two: NDArray[np.int64]) -> Array:
        offset = np.abs(one[:, None] - two[None])
        distance = self.spacing_m * np.hypot(offset[..., 0], offset[..., 1])
        return self.model.correlation(distance)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Of k hypotheses after n measurements."""

    whitened: Array
    """``[n, k]`` u"""
    misfit: NDArray[np.float64]
    """``[k]`` |u|²"""
    log_scale: NDArray[np.float64]
    """``[k]`` Σ_i log s(i) − log g′(z(i))"""

    @classmethod
    def none(cls, count: int) -> Evidence:
        """Before the first measurement, of ``count`` hypotheses."""
        return cls(np.empty((0, count), dtype=np.float32), np.zeros(count), np.zeros(count))

    @classmethod
    def solved(cls, z: Array, std: Array, factor: Factor, soften: float) -> Evidence:
        """Of hypotheses that join late, from all their residuals ``z[n, k]`` and ``std[n, k]``."""
        soft, log_slope = _softened(z, soften)
        u = solve_triangular(factor.L, soft, lower=True, check_finite=False).astype(np.float32)
        return cls(u, (u.astype(float) ** 2).sum(axis=0), (np.log(std) - log_slope).sum(axis=0, dtype=float))

    def grown(self, z: Array, std: Array, rows: Rows, soften: float) -> Evidence:
        """After m more measurements with residuals ``z[m, k]`` and predicted ``std[m, k]``."""
        soft, log_slope = _softened(z, soften)
        new = solve_triangular(rows.corner, soft - rows.side.T @ self.whitened, lower=True, check_finite=False)
        return Evidence(
            np.concatenate([self.whitened, new.astype(np.float32)]),
            self.misfit + (new.astype(float) ** 2).sum(axis=0),
            self.log_scale + (np.log(std) - log_slope).sum(axis=0, dtype=float),
        )

    def joined(self, kept: NDArray[np.int64], more: Evidence) -> Evidence:
        """The hypotheses ``kept`` of these, then ``more``."""
        return Evidence(
            np.concatenate([self.whitened[:, kept], more.whitened], axis=1),
            np.append(self.misfit[kept], more.misfit),
            np.append(self.log_scale[kept], more.log_scale),
        )

    def log_likelihood(self, degrees: float) -> NDArray[np.float64]:
        """``[k]`` see the module; ``degrees`` is ν."""
        n = len(self.whitened)
        return -0.5 * (degrees + n) * np.log1p(self.misfit / degrees) - self.log_scale


def posterior_weights(prior: NDArray[np.float64], log_likelihood: NDArray[np.float64], temper: float) -> NDArray[np.float64]:
    """``[k]`` prior · likelihood^temper, normalised."""
    log_weight = np.log(prior) + temper * log_likelihood
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum()


def _softened(z: Array, a: float) -> tuple[Array, Array]:
    """g(z) and log g′(z)."""
    return a * np.arcsinh(z / np.float32(a)), -0.5 * np.log1p((z / np.float32(a)) ** 2)
