"""A Gaussian process on a grid that grows with its data and never refits.

Kriging needs, for the covariance K = L Lᵀ of the v values observed so far, only the inverse factor
R = L⁻¹. It has a property
worth building on: conditioning on n more values appends n rows to R and changes none of those that
are there. Row i of R holds the weights that turn observation i into its innovation, the part the
earlier ones could not foresee, scaled to unit variance. So a belief can hand its rows to the next
one, and only the newest belief of a line ever writes.

The covariance of innovation i with the field at every cell of the map is Σⱼ Rᵢⱼ k(cell, cellⱼ). The
kernel depends on the offset between cells alone, so that sum is a convolution of an image (the
weights, put at their cells) with the kernel, and two FFTs give it for the whole map, however many
observations there are. Appending n values to v on a map of P cells takes O(v²·n + n·P log P) time,
where products with the full v × P matrix would take O(v·n·P).
"""

from __future__ import annotations

__all__ = ["CellKernel", "GaussianProcess", "Innovation", "InverseFactor"]

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
class Innovation:
    """What n new observations add, in terms of the v before them."""

    rows: Array
    """``[n, v + n]`` new rows of R: ``rows @ x`` whitens the new entries of any column x of all v +
    n observations"""
    maps: Array
    """``[n, P]`` covariance of each innovation with the field at every cell, in dB"""


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A zero-mean field observed at some cells. Immutable; `observed` returns the grown process and
    its innovation."""

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
    reduction_db2: Array
    """``[P]`` how much the observations have lowered the variance at every cell"""

    @classmethod
    def unobserved(
        cls, kernel: CellKernel, to_prediction: CellKernel, prior: CellKernel
    ) -> GaussianProcess:
        """The process before any data."""
        none = np.empty(0)
        reduction = np.zeros(kernel.shape[0] * kernel.shape[1])
        return cls(
            kernel, to_prediction, prior, none.astype(np.int64), none, InverseFactor(), reduction
        )

    def innovation(self, cells: Flat, noise_db2: Array) -> Innovation:
        """What observing raveled ``cells[n]`` with noise variances ``noise_db2[n]`` would add."""
        cross = self.kernel.between(self.cells, cells)
        whitened = self.factor.times(cross)
        schur = self.kernel.between(cells, cells) - whitened.T @ whitened
        diagonal = np.diag_indices_from(schur)
        # Where the value is known already, rounding errors are all that is left: the floor keeps
        # the factor real.
        schur[diagonal] = np.maximum(schur[diagonal] + noise_db2, KNOWN * self.kernel.variance_db2)
        root = np.linalg.cholesky(schur)
        inverse, _ = lapack.dtrtri(root, lower=1)
        rows = np.concatenate(
            [-inverse @ self.factor.transposed_times(whitened).T, inverse], axis=1
        )
        return Innovation(
            rows, self.to_prediction.to_map(rows, np.concatenate([self.cells, cells]))
        )

    def observed(self, cells: Flat, noise_db2: Array) -> tuple[GaussianProcess, Innovation]:
        """The process after observing ``cells[n]`` as well, and what they added."""
        new = self.innovation(cells, noise_db2)
        grown = replace(
            self,
            cells=np.concatenate([self.cells, cells]),
            noise_db2=np.concatenate([self.noise_db2, noise_db2]),
            factor=self.factor.extended(new.rows),
            reduction_db2=self.reduction_db2 + np.einsum("np,np->p", new.maps, new.maps),
        )
        return grown, new

    def whitened(self, cells: Flat) -> Array:
        """``[v, n]`` covariance of every innovation with the field at raveled predicted
        ``cells[n]``."""
        return self.factor.times(self.to_prediction.between(self.cells, cells))
