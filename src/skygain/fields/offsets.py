"""Functions of the offset between two cells of a grid: tables of them, and how to look them up.

A stationary covariance is one: it is computed once for every ``[|row offset|, |column offset|]``
and read from there. Sums over many cells stand in `skygain.fields.offset_sum`.
"""

from __future__ import annotations

__all__ = ["ExponentialKernel", "at_flat_offsets", "at_offsets", "offset_distance_m", "seen_from"]

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]


@dataclass(frozen=True)
class ExponentialKernel:
    """Exponential (Gudmundson) covariance: φ exp(−d/δ), plus ν at d = 0.

    >>> ExponentialKernel(sill_db2=9.0, range_m=8.0, nugget_db2=1.0).at([0.0, 4.0]).round(3)
    array([10.   ,  5.459])
    """

    sill_db2: float
    """φ, variance of the spatially correlated part"""
    range_m: float
    """δ, distance at which the correlation has fallen to 1/e"""
    nugget_db2: float = 0.0
    """ν, variance of the part that differs from cell to cell; it belongs to the field, not to the
    measurement"""

    @property
    def variance_db2(self) -> float:
        """Covariance of a cell with itself."""
        return self.sill_db2 + self.nugget_db2

    def at(self, distance_m: ArrayLike) -> Array:
        """Covariance in dB² of two cells ``distance_m`` apart, in that shape."""
        distance = np.asarray(distance_m, dtype=float)
        return self.sill_db2 * np.exp(-distance / self.range_m) + self.nugget_db2 * (distance == 0)


def offset_distance_m(shape: tuple[int, int], spacing_m: float, gap_m: float = 0.0) -> Array:
    """``[|row offset|, |column offset|]`` distance between two cells whose planes are ``gap_m``
    apart."""
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    return np.sqrt(spacing_m**2 * (rows**2 + cols**2) + gap_m**2)


@njit(cache=True)
def _looked_up(table, cells, others):
    out = np.empty((len(cells), len(others)), dtype=table.dtype)
    for i in range(len(cells)):
        for j in range(len(others)):
            out[i, j] = table[abs(cells[i, 0] - others[j, 0]), abs(cells[i, 1] - others[j, 1])]
    return out


def at_offsets(table: NDArray[Any], cells: Cells, others: Cells) -> NDArray[Any]:
    """``[n, m]`` entries of ``table[|row offset|, |column offset|]`` for ``cells[n, (row, col)]``
    and ``others[m, (row, col)]``."""
    return _looked_up(
        np.ascontiguousarray(table), np.ascontiguousarray(cells), np.ascontiguousarray(others)
    )


def at_flat_offsets(table: NDArray[Any], first: Cells, second: Cells, cols: int) -> NDArray[Any]:
    """`at_offsets` of raveled cells ``first[n]`` and ``second[m]`` on a map with ``cols``
    columns."""
    return at_offsets(table, _rows_and_cols(first, cols), _rows_and_cols(second, cols))


def _rows_and_cols(cells: Cells, cols: int) -> Cells:
    return np.stack(np.divmod(cells, cols), axis=-1)


def seen_from(table: NDArray[Any], row: int, col: int) -> NDArray[Any]:
    """``[row, col]`` entries of ``table`` for every cell of the map, seen from one cell."""
    rows, cols = (np.abs(np.arange(n) - at) for n, at in zip(table.shape, (row, col), strict=True))
    return table[rows[:, None], cols]
