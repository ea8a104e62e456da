"""The hot loops of local Kriging, compiled on first use and kept on disk."""

from __future__ import annotations

__all__ = ["Field", "Observations", "neighbour_weights"]

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray


class Observations(NamedTuple):
    """Values at some cells."""

    cells: NDArray[np.int64]
    """``[v]`` raveled cells"""
    noise_db2: NDArray[np.float64]
    """``[v]`` noise variances"""
    gain_db: NDArray[np.float64]
    """``[v]`` values"""
    columns: NDArray[np.float64]
    """``[v, q]`` trend columns"""


class Field(NamedTuple):
    """A stationary field on a grid."""

    table: NDArray[np.float64]
    """``[|row offset|, |column offset|]`` covariance between observed cells, for the whole grid"""
    cross: NDArray[np.float64]
    """the same between an observed and a predicted cell"""
    prior_db2: float
    """variance of a predicted cell"""
    floor_db2: float
    """smallest conditional variance of an observation"""


@numba.njit(nogil=True, cache=True)
def neighbour_weights(cells, neighbours, data, field):  # type: ignore[no-untyped-def]
    """Simple Kriging of every cell from its own neighbours.

    Args:
        cells: ``[n]`` raveled cells to predict.
        neighbours: ``[n, k]`` indices of the observations to use; an index beyond the last one
            marks an empty place.
        data: the observations.
        field: what is observed.

    Returns:
        w·y ``[n]``, w·H ``[n, q]`` and the variance ``[n]``, with w the Kriging weights.
    """
    observed, noise_db2, gain_db, columns = data
    table, cross, prior_db2, floor_db2 = field
    n, k = neighbours.shape
    cols = table.shape[1]
    q = columns.shape[1]
    v = len(observed)
    weighted = np.zeros(n)
    explained = np.zeros((n, q))
    variance = np.full(n, prior_db2)
    root = np.empty((k, k))
    weight = np.empty(k)
    for i in range(n):
        row, col = cells[i] // cols, cells[i] % cols
        size = 0
        while size < k and neighbours[i, size] < v:
            size += 1
        for a in range(size):
            j = neighbours[i, a]
            row_a, col_a = observed[j] // cols, observed[j] % cols
            value = cross[abs(row - row_a), abs(col - col_a)]
            for b in range(a):
                m = neighbours[i, b]
                root[a, b] = table[
                    abs(row_a - observed[m] // cols), abs(col_a - observed[m] % cols)
                ]
            # One row of the Cholesky factor, and of the forward substitution.
            diagonal = table[0, 0] + noise_db2[j]
            for b in range(a):
                entry = root[a, b]
                for c in range(b):
                    entry -= root[a, c] * root[b, c]
                entry /= root[b, b]
                root[a, b] = entry
                diagonal -= entry * entry
                value -= entry * weight[b]
            root[a, a] = np.sqrt(max(diagonal, floor_db2))
            weight[a] = value / root[a, a]
            variance[i] -= weight[a] * weight[a]
        for a in range(size - 1, -1, -1):
            value = weight[a]
            for b in range(a + 1, size):
                value -= root[b, a] * weight[b]
            weight[a] = value / root[a, a]
            j = neighbours[i, a]
            weighted[i] += weight[a] * gain_db[j]
            for c in range(q):
                explained[i, c] += weight[a] * columns[j, c]
        variance[i] = max(variance[i], 0.0)
    return weighted, explained, variance
