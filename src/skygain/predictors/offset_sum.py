"""Weighted sums over measured cells, at every cell of a map, when the weight depends on the offset between cells alone."""

from __future__ import annotations

__all__ = ["OffsetSum"]

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]

AT_A_TIME = 8
"""images transformed together; a few of them stay in the processor's cache"""


class OffsetSum:
    """Sums Σⱼ weightⱼ · table[|row − rowⱼ|, |col − colⱼ|] for all P cells by two FFTs, O(P log P) however many cells j there are.

    >>> near = OffsetSum(np.array([[2.0, 1.0, 0.0]]))
    >>> near(np.array([[1.0, 10.0]]), np.array([0, 1])).round(9) + 0.0
    array([[12., 21., 10.]])
    """

    def __init__(self, table: Array) -> None:
        self.shape = table.shape
        self._fft_shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in table.shape)
        # A circle of at least 2R − 1 offsets holds every difference of two rows without overlap.
        index = [
            np.minimum(np.arange(n), n - np.arange(n)).clip(max=m - 1) for n, m in zip(self._fft_shape, table.shape, strict=True)
        ]
        self._spectrum = fft.rfft2(table[np.ix_(*index)]).real

    def __call__(self, weights: Array, cells: NDArray[np.int64]) -> Array:
        """``[n, P]`` sums for ``weights[n, v]`` at raveled ``cells[v]``, which may repeat."""
        rows, cols = self.shape
        images = np.zeros((len(weights), rows * cols))
        np.add.at(images.T, cells, weights.T)
        out = np.empty_like(images)
        for first in range(0, len(weights), AT_A_TIME):
            some = images[first : first + AT_A_TIME].reshape(-1, rows, cols)
            spectrum = fft.rfft2(some, s=self._fft_shape)
            spectrum *= self._spectrum
            out[first : first + AT_A_TIME] = fft.irfft2(spectrum, s=self._fft_shape)[:, :rows, :cols].reshape(len(some), -1)
        return out
