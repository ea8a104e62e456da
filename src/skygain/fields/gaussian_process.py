"""A Gaussian process on a grid that grows with its data and never refits.

Kriging needs, for the covariance K = L Lᵀ of the v values observed so far, only the inverse factor
R = L⁻¹. It has a property
worth building on: conditioning on n more values appends n rows to R and changes none of those that
are there. Row i of R holds the weights that turn observation i into its innovation, the part the
earlier ones could not foresee, scaled to unit variance. So a belief can hand its rows to the next
one, and only the newest belief of a line ever writes.

Appending n values takes O(v²·n) time and no map at all. Maps are made when somebody looks at one.
A sum over observations is a convolution of an image (weights, put at their cells) with the kernel,
which depends on the offset between cells alone: two FFTs. The variance needs the covariance of
every innovation with every cell, but only of those that came since somebody looked last.
"""

from __future__ import annotations

__all__ = ["CellKernel", "GaussianProcess", "InverseFactor"]

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from skygain.fields.offset_sum import OffsetSum
from skygain.fields.offsets import ExponentialKernel, at_flat_offsets, offset_distance_m

Array = NDArray[np.float64]
Flat = NDArray[np.int64]

BLOCK_ROWS = 128
"""rows of the inverse factor that are allocated, and at most copied, together"""
WINDOW_CELLS = 1024
"""cells of the map whose covariances with all observations are held at a time"""
BUNDLE_ROWS = 16
"""rows of the inverse factor whose covariances with the map are summed together"""
TRANSFORM = 100.0
"""what a point of an FFT costs in terms of looking up a covariance and multiplying it"""
KNOWN = 1e-10
"""a value whose variance is below this share of the prior variance counts as known exactly"""


@dataclass(frozen=True, eq=False)
class CellKernel:
    """A covariance between cells of a grid.

    >>> kernel = CellKernel((3, 4), 4.0, ExponentialKernel(9.0, range_m=8.0, nugget_db2=1.0))
    >>> kernel.between(np.array([0]), np.array([0, 1])).round(3)
    array([[10.   ,  5.459]])
    """

    shape: tuple[int, int]
    """rows and columns of the grid"""
    spacing_m: float
    """side of a cell"""
    kernel: ExponentialKernel
    """covariance by distance"""
    gap_m: float = 0.0
    """vertical distance between the two planes that are compared; planes apart do not share the
    nugget"""

    @cached_property
    def table(self) -> Array:
        """``[|row offset|, |column offset|]`` covariance in dB²."""
        return self.kernel.at(offset_distance_m(self.shape, self.spacing_m, self.gap_m))

    @property
    def variance_db2(self) -> float:
        """Prior variance of the field at a cell."""
        return self.kernel.variance_db2

    def between(self, first: Flat, second: Flat) -> Array:
        """``[n, m]`` covariance of raveled cells ``first[n]`` and ``second[m]``."""
        return at_flat_offsets(self.table, first, second, self.shape[1])

    @cached_property
    def to_map(self) -> OffsetSum:
        """Sums of the covariance over observed cells, at every cell: ``to_map(weights[n, v],
        cells[v]) -> [n, P]``."""
        return OffsetSum(self.table)


class _Block:
    """`BLOCK_ROWS` rows of R, of which ``filled`` have been written."""

    __slots__ = ("filled", "rows")

    def __init__(self, index: int) -> None:
        self.rows = np.zeros((BLOCK_ROWS, (index + 1) * BLOCK_ROWS))
        self.filled = 0

    def copied(self, index: int, used: int) -> _Block:
        """A block of its own with the first ``used`` rows."""
        block = _Block(index)
        block.rows[:used] = self.rows[:used]
        block.filled = used
        return block


class InverseFactor:
    """R = L⁻¹ in blocks of rows, lower triangular. Immutable; extensions share the blocks that are
    full.

    The last block is shared too as long as only one extension is made: who appends first writes
    behind the rows that others see, who comes second finds the block longer than expected and takes
    a copy of that one block.
    """

    __slots__ = ("_blocks", "size")

    def __init__(self, blocks: tuple[_Block, ...] = (), size: int = 0) -> None:
        self._blocks = blocks
        self.size = size

    def _pieces(self) -> Iterator[tuple[slice, Array]]:
        for index, block in enumerate(self._blocks):
            first = index * BLOCK_ROWS
            last = min(first + BLOCK_ROWS, self.size)
            yield slice(first, last), block.rows[: last - first, :last]

    def times(self, columns: Array) -> Array:
        """R·columns, ``[v, k]``."""
        out = np.empty_like(columns)
        for rows, piece in self._pieces():
            out[rows] = piece @ columns[: piece.shape[1]]
        return out

    def transposed_times(self, columns: Array) -> Array:
        """Rᵀ·columns, ``[v, k]``."""
        out = np.zeros_like(columns)
        for rows, piece in self._pieces():
            out[: piece.shape[1]] += piece.T @ columns[rows]
        return out

    def bundles(self, first: int) -> Iterator[Array]:
        """The rows of R from ``first`` on, `BUNDLE_ROWS` at a time as counted from the beginning,
        ``[n, k]`` without the zeros behind."""
        for rows, piece in self._pieces():
            for row in range(max(first, rows.start), rows.stop, BUNDLE_ROWS):
                end = min(row + BUNDLE_ROWS, rows.stop)
                yield piece[row - rows.start : end - rows.start, :end]

    def extended(self, rows: Array) -> InverseFactor:
        """R with ``rows[n, v + n]`` appended."""
        blocks, size, width = list(self._blocks), self.size, rows.shape[1]
        while len(rows):
            index, used = divmod(size, BLOCK_ROWS)
            if used == 0:
                blocks.append(_Block(index))
            elif blocks[index].filled != used:
                blocks[index] = blocks[index].copied(index, used)
            block = blocks[index]
            taken = min(BLOCK_ROWS - used, len(rows))
            reach = min(width, block.rows.shape[1])
            block.rows[used : used + taken, :reach] = rows[:taken, :reach]
            block.filled = used + taken
            rows, size = rows[taken:], size + taken
        return InverseFactor(tuple(blocks), size)


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A zero-mean field observed at some cells. Immutable; `observed` returns the grown process."""

    kernel: CellKernel
    """covariance between cells of the plane where values are observed"""
    to_prediction: CellKernel
    """covariance between an observed cell and a predicted cell; the same as ``kernel`` if both
    planes are one"""
    prior: CellKernel
    """covariance between predicted cells"""
    cells: Flat
    """``[v]`` raveled cell of each observation; a cell may be observed again when the noise is not
    zero"""
    noise_db2: Array
    """``[v]`` variance of each observation's noise"""
    factor: InverseFactor
    """R, the inverse Cholesky factor of the observations' covariance"""
    before: tuple[int, Array]
    """how many of the first observations were looked at already, in whole bundles, and the
    reduction by these"""

    @classmethod
    def unobserved(
        cls, kernel: CellKernel, to_prediction: CellKernel, prior: CellKernel
    ) -> GaussianProcess:
        """The process before any data."""
        none = np.empty(0)
        before = 0, np.zeros(kernel.shape[0] * kernel.shape[1])
        return cls(
            kernel, to_prediction, prior, none.astype(np.int64), none, InverseFactor(), before
        )

    def innovation(self, cells: Flat, noise_db2: Array) -> Array:
        """``[n, v + n]`` rows of R that observing raveled ``cells[n]`` with noise variances
        ``noise_db2[n]`` would add: they whiten the new entries of any column of all v + n
        observations."""
        cross = self.kernel.between(self.cells, cells)
        whitened = self.factor.times(cross)
        schur = self.kernel.between(cells, cells) - whitened.T @ whitened
        diagonal = np.diag_indices_from(schur)
        # Where the value is known already, rounding errors are all that is left: the floor keeps
        # the factor real.
        schur[diagonal] = np.maximum(schur[diagonal] + noise_db2, KNOWN * self.kernel.variance_db2)
        root = np.linalg.cholesky(schur)
        inverse, _ = lapack.dtrtri(root, lower=1)
        return np.concatenate(
            [-inverse @ self.factor.transposed_times(whitened).T, inverse], axis=1
        )

    def observed(self, cells: Flat, noise_db2: Array) -> tuple[GaussianProcess, Array]:
        """The process after observing ``cells[n]`` as well, and the rows they added, see
        `innovation`."""
        rows = self.innovation(cells, noise_db2)
        looked_at = self.__dict__.get("_looked_at")
        grown = replace(
            self,
            cells=np.concatenate([self.cells, cells]),
            noise_db2=np.concatenate([self.noise_db2, noise_db2]),
            factor=self.factor.extended(rows),
            before=self.before if looked_at is None else looked_at[0],
        )
        return grown, rows

    @property
    def reduction_db2(self) -> Array:
        """``[P]`` how much the observations have lowered the variance at every cell."""
        return self._looked_at[1]

    @cached_property
    def _looked_at(self) -> tuple[tuple[int, Array], Array]:
        """``before`` for whoever goes on from here, and the reduction by all observations."""
        first, before = self.before
        settled, rest = before.copy(), np.zeros_like(before)
        bundles, sums = list(self.factor.bundles(first)), self.to_prediction
        cells, size = len(before), self.factor.size
        # What is done with a bundle depends on nothing but where it stands: the answer is the same
        # to the last bit however often somebody looked on the way.
        dense = [rows for rows in bundles if rows.shape[1] <= TRANSFORM * math.log2(4 * cells)]
        for start in range(0, cells if dense else 0, WINDOW_CELLS):
            window = slice(start, min(start + WINDOW_CELLS, cells))
            among = np.arange(window.start, window.stop)
            covariance = sums.between(self.cells[: dense[-1].shape[1]], among)
            for rows in dense:
                maps = rows @ covariance[: rows.shape[1]]
                total = settled if len(rows) == BUNDLE_ROWS else rest
                total[window] += np.einsum("np,np->p", maps, maps)
        for rows in bundles[len(dense) :]:
            maps = sums.to_map(rows, self.cells[: rows.shape[1]])
            (settled if len(rows) == BUNDLE_ROWS else rest)[:] += np.einsum("np,np->p", maps, maps)
        return (size - size % BUNDLE_ROWS, settled), settled + rest

    def whitened(self, cells: Flat) -> Array:
        """``[v, n]`` covariance of every innovation with the field at raveled predicted
        ``cells[n]``."""
        return self.factor.times(self.to_prediction.between(self.cells, cells))
