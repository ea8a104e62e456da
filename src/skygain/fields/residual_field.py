"""Kriging of what a model of the mean gets wrong, shared by any number of models.

A model c gives mean m_c and standard deviation s_c per cell. Its standardised residual (y −
m_c)/s_c is taken to be one stationary field with unit variance and correlation

    ρ(d) = (1 − η) [(1 − λ) exp(−d/ℓ) + λ exp(−d/ℓ_far)] + η·1{same cell},

the same for every model. Then the factor L of the correlation matrix of the measured cells and W =
L⁻¹ R(measured, all cells)
serve all models at once: u_c = L⁻¹ z_c gives the likelihood of model c (−½ |u_c|² − Σ log s_c) and
its Kriging mean m_c + s_c Wᵀu_c, with variance s_c² (1 − Σ W²). A new measurement appends one row
to L, W and u (a column of W *is* the new row of L), so it costs n·cells multiplications and nothing
is ever solved again; those of one update are taken in together.
"""

from __future__ import annotations

__all__ = ["CorrelationModel", "ResidualField"]

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skygain.fields.offsets import offset_distance_m, seen_from

Array = NDArray[np.float32]

FEW = 6
"""readings up to which products with one row after the other are quicker than one of matrices"""
SMALLEST_VARIANCE = 1e-5
"""share of the prior variance below which a measured cell counts as known exactly; keeps the factor
finite"""


@dataclass(frozen=True)
class CorrelationModel:
    """How the standardised residual varies together over distance."""

    length_m: float = 17.0
    """ℓ"""
    far_length_m: float = 310.0
    """ℓ_far, the reach of errors that a whole street or quarter shares"""
    far_share: float = 0.42
    """λ, the part of the correlated variance with the far reach"""
    nugget: float = 0.2
    """η, the part of the variance that neighbouring cells do not share"""

    def correlation(self, distance_m: NDArray[np.floating]) -> NDArray[np.floating]:
        """Between two cells ``distance_m`` apart; 1 at distance 0."""
        near, far = np.exp(-distance_m / self.length_m), np.exp(-distance_m / self.far_length_m)
        shared = (1 - self.nugget) * ((1 - self.far_share) * near + self.far_share * far)
        return np.where(distance_m == 0, 1.0, shared)

    def table(self, shape: tuple[int, int], spacing_m: float) -> Array:
        """``[|row difference|, |col difference|]`` correlation between two cells."""
        return self.correlation(offset_distance_m(shape, spacing_m)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ResidualField:
    """Factor of the correlation matrix of the cells measured so far. Growing it leaves older fields
    valid."""

    table: Array
    """correlation by cell offset, see `CorrelationModel.table`"""
    buffer: Array
    """``[capacity, row * col]`` buffer; the first `size` rows are W"""
    used: list[int]
    """how far the buffer is written; shared with the fields that were grown from this one"""
    size: int
    """number of measurements n"""
    left: Array
    """``[row * col]`` share of the prior variance that is left, 1 − Σ W²"""
    diagonal: Array
    """``[n]`` diagonal of L"""

    @classmethod
    def empty(
        cls, model: CorrelationModel, shape: tuple[int, int], spacing_m: float
    ) -> ResidualField:
        """No measurement yet, on a map of ``shape``."""
        table = model.table(shape, spacing_m)
        buffer = np.empty((64, table.size), dtype=np.float32)
        return cls(
            table,
            buffer,
            [0],
            0,
            np.ones(table.size, dtype=np.float32),
            np.empty(0, dtype=np.float32),
        )

    @property
    def W(self) -> Array:  # noqa: N802 - the matrix of the equations
        """``[n, row * col]`` L⁻¹ R(measured, all cells)."""
        return self.buffer[: self.size]

    def grown(
        self, cells: NDArray[np.int64], noise_share: NDArray[np.floating]
    ) -> tuple[ResidualField, Array]:
        """This field after k more measurements at raveled ``cells[k]``, and the rows ``[k, n + k]``
        of L that belong to them.

        ``noise_share[k]`` is the noise variance over the model's variance at each cell.
        """
        n, k, cols = self.size, len(cells), self.table.shape[1]
        buffer, used = self.buffer, self.used
        if n + k > len(buffer) or used[0] != n:  # full, or another field already grew from this one
            room = len(buffer)
            while room < n + k:
                room *= 2
            buffer = np.empty((room, self.table.size), dtype=np.float32)
            buffer[:n] = self.W
            used = [n]
        rows = np.zeros((k, n + k), dtype=np.float32)
        rows[:, :n] = buffer[:n, cells].T
        fresh = buffer[n : n + k]
        for i, cell in enumerate(cells.tolist()):
            fresh[i] = seen_from(self.table, *divmod(cell, cols)).ravel()
        if k > FEW:
            fresh -= rows[:, :n] @ buffer[:n]
        else:
            for i in range(k):
                fresh[i] -= rows[i, :n] @ buffer[:n]
        left = self.left
        for i, cell in enumerate(cells.tolist()):
            rows[i, n : n + i] = fresh[:i, cell]
            if i:
                fresh[i] -= rows[i, n : n + i] @ fresh[:i]
            variance = max(float(left[cell]), 0.0) + float(noise_share[i]) + SMALLEST_VARIANCE
            rows[i, n + i] = pivot = np.float32(np.sqrt(variance))
            fresh[i] /= pivot
            left = np.maximum(left - fresh[i] ** 2, 0.0)
        used[0] = n + k
        diagonal = np.append(self.diagonal, rows[np.arange(k), n + np.arange(k)])
        return replace(
            self, buffer=buffer, used=used, size=n + k, left=left, diagonal=diagonal
        ), rows
