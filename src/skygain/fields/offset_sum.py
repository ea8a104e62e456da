"""Weighted sums over cells, at every cell of a map, when the weight depends on the offset between
cells alone."""

from __future__ import annotations

__all__ = ["OffsetSum"]

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]

AT_A_TIME = 8
"""images transformed together; a few of them stay in the processor's cache"""


class OffsetSum:
    """Sums Σⱼ weightⱼ · table[|row − rowⱼ|, |col − colⱼ|] at every cell by two FFTs, O(P log P)
    however many cells j there are.

    The cells j lie on a map; the sums are wanted on the map with ``margin`` cells added on every
    side. ``table`` holds the offsets that occur, so its shape is that of the map plus ``margin``.

    >>> near = OffsetSum(np.array([[2.0, 1.0, 0.0]]))
    >>> near(np.array([[1.0, 10.0]]), np.array([0, 1])).round(9) + 0.0
    array([[12., 21., 10.]])
    """

    def __init__(self, table: Array, margin: int = 0) -> None:
        self.shape = (table.shape[0] - margin, table.shape[1] - margin)
        """rows and columns of the map"""
        self.wide_shape = (table.shape[0] + margin, table.shape[1] + margin)
        """rows and columns with the margin"""
        self._margin = margin
        self._fft_shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in table.shape)
        # A circle of at least 2n − 1 offsets holds −(n − 1) to n − 1 without overlap.
        index = [
            np.minimum(np.arange(n), n - np.arange(n)).clip(max=m - 1)
            for n, m in zip(self._fft_shape, table.shape, strict=True)
        ]
        self._spectrum = fft.rfft2(table[np.ix_(*index)]).real

    def __call__(self, weights: Array, cells: NDArray[np.int64]) -> Array:
        """``[n, wide cells]`` sums for ``weights[n, v]`` at raveled ``cells[v]`` of the map, which
        may repeat."""
        images = np.zeros((len(weights), self.shape[0] * self.shape[1]))
        np.add.at(images.T, cells, weights.T)
        return self._summed(images.reshape(-1, *self.shape), self._margin, 0, self.wide_shape)

    def back(self, weights: Array) -> Array:
        """``[n, cells]`` the transposed sums: for ``weights[n, wide cells]`` on the map with its
        margin, at the cells of the map."""
        return self._summed(weights.reshape(-1, *self.wide_shape), 0, self._margin, self.shape)

    def _summed(self, images: Array, put: int, take: int, shape: tuple[int, int]) -> Array:
        out = np.empty((len(images), *shape))
        rows, cols = images.shape[1:]
        for first in range(0, len(images), AT_A_TIME):
            some = images[first : first + AT_A_TIME]
            if put:
                padded = np.zeros((len(some), put + rows, put + cols))
                padded[:, put:, put:] = some
                some = padded
            spectrum = fft.rfft2(some, s=self._fft_shape)
            spectrum *= self._spectrum
            summed = fft.irfft2(spectrum, s=self._fft_shape)
            out[first : first + AT_A_TIME] = summed[
                :, take : take + shape[0], take : take + shape[1]
            ]
        return out.reshape(len(images), -1)
