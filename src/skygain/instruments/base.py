"""The seam every instrument implements: given cells, return readings."""

from __future__ import annotations

__all__ = ["Instrument"]

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.measurements import Measurements


class Instrument(ABC):
    """The UAVs' receivers. What they read may be looked up in a truth, replayed from a file, or
    come from the air."""

    @abstractmethod
    def measure(
        self, cells: ArrayLike, *, uav: ArrayLike | None = None, time_s: float = 0.0
    ) -> Measurements:
        """Readings at ``cells[n, (row, col)]``.

        Args:
            cells: where the UAVs are.
            uav: ``[n]`` which UAV stands at each cell; 0, 1, 2, … when left out.
            time_s: when, in seconds since the survey began.

        Returns:
            At most one reading per cell asked for: a reading may be lost, and it may be recorded at
            a neighbouring cell when the position is uncertain.
        """

    def available(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """``[row, col]`` cells where a reading can be had at all; every cell, unless a recording
        says otherwise."""
        return np.ones(shape, dtype=bool)
