"""Readings as the interpolators want them: one value and one noise variance per cell.

Several readings of one cell in a batch say together what one reading would: an exact one stands for
all (the first, should exact ones disagree), noisy ones are averaged with weights 1/σ², and their
noise variance is 1/Σ(1/σ²). For a normal noise nothing is lost by that.
"""

from __future__ import annotations

__all__ = ["Readings", "checked_flat", "combined"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Readings:
    """Values at distinct cells."""

    cells: NDArray[np.int64]
    """``[n]`` raveled cells, distinct, in the order they first appeared"""
    gain_db: Array
    """``[n]`` gain"""
    noise_db2: Array
    """``[n]`` variance of its noise, 0 when exact"""

    def __len__(self) -> int:
        return len(self.cells)


def checked_flat(grid: Grid, measurements: Measurements) -> NDArray[np.int64]:
    """Raveled cells of ``measurements``.

    Raises:
        InputError: one lies off the map.
    """
    inside = grid.contains(measurements.cell)
    if not inside.all():
        row, col = measurements.cell[~inside][0]
        raise InputError(
            f"a measurement at cell ({row}, {col}) lies off the map of {grid.shape} cells; drop it "
            "or enlarge the map"
        )
    return grid.flat(measurements.cell)


def combined(cells: NDArray[np.int64], gain_db: Array, noise_db2: Array) -> Readings:
    """One reading per distinct cell, from raveled ``cells[n]`` with gains and noise variances.

    >>> both = combined(np.array([7, 7]), np.array([-90.0, -94.0]), np.array([1.0, 1.0]))
    >>> both.gain_db, both.noise_db2
    (array([-92.]), array([0.5]))
    """
    distinct, first, group = np.unique(cells, return_index=True, return_inverse=True)
    if len(distinct) == len(cells):
        return Readings(cells, gain_db, noise_db2)
    exact = noise_db2 == 0
    weight = np.where(exact, 0.0, 1 / np.where(exact, 1.0, noise_db2))
    total = np.bincount(group, weight)
    gain = np.divide(
        np.bincount(group, weight * gain_db), total, out=np.zeros_like(total), where=total > 0
    )
    noise = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    exact_index = np.flatnonzero(exact)[
        ::-1
    ]  # backwards, so that the first exact reading is written last
    gain[group[exact_index]] = gain_db[exact_index]
    noise[group[exact_index]] = 0.0
    order = np.argsort(first)
    return Readings(distinct[order], gain[order], noise[order])
