"""Fixed-rank Kriging, after Cressie and Johannesson (2008); for radio maps Braham et al. (2016).

The field is a sum of bisquare functions on two lattices, g = μ + S η + ξ, with η normal, one
variance for each lattice, and ξ independent from cell to cell. The variances come from the readings
by expectation maximisation. With r functions an update costs O(n r²) whatever the map, and the map
O(P r); what is smaller than the fine lattice is noise to it.
"""

from __future__ import annotations

__all__ = ["FixedRankKrigingPredictor"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.predictors.interpolators.interpolation import ReadingsPredictor
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]

REACH = 1.5
"""radius of a function in spacings of its lattice"""
CHUNK = 16384
"""cells that are predicted at a time"""
FIRST_DB2 = 100.0
"""variances that the estimation begins with"""
LEAST_DB2 = 1e-3
"""least variance that it may end with"""


@dataclass(frozen=True)
class FixedRankKrigingPredictor(ReadingsPredictor):
    """See the module.

    Raises:
        InputError: no function along a side, or no iteration.
    """

    coarse: int = 4
    """functions along the longer side of the map on the coarse lattice; the fine one has twice as
    many"""
    iterations: int = 40
    """of the estimation"""

    def __post_init__(self) -> None:
        if self.coarse < 1 or self.iterations < 1:
            raise InputError(
                "fixed-rank Kriging needs `coarse` and `iterations` of 1 or more, got "
                f"{self.coarse} and {self.iterations}"
            )

    def memory_bytes(self, cells: int, readings: int) -> float:
        """A chunk's functions."""
        functions = 5.0 * (self.coarse + 1) ** 2 * 4
        return super().memory_bytes(cells, readings) + 8.0 * functions * (CHUNK + readings)

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        grid = scenario.grid
        lattices = [_lattice(grid, self.coarse), _lattice(grid, 2 * self.coarse)]
        xy = grid.xy_m(grid.cells)
        S = _functions(xy[readings.cells], lattices)
        level_of = np.repeat(np.arange(2), [len(centres) for centres, _ in lattices])
        tau, sigma = np.full(2, FIRST_DB2), FIRST_DB2
        mean_db, eta = float(readings.gain_db.mean()), np.zeros(S.shape[1])
        for _ in range(self.iterations):
            weight = 1.0 / (sigma + readings.noise_db2)
            precision = np.diag(1.0 / tau[level_of]) + (S.T * weight) @ S
            A = np.linalg.inv(precision)
            mean_db = float(np.average(readings.gain_db - S @ eta, weights=weight))
            residual = readings.gain_db - mean_db
            eta = A @ (S.T @ (weight * residual))
            square = eta**2 + np.diag(A)
            tau = np.maximum(np.bincount(level_of, square) / np.bincount(level_of), LEAST_DB2)
            left = (residual - S @ eta) ** 2 + np.einsum("nr,rs,ns->n", S, A, S)
            share = sigma * weight  # of the unexplained that is not the receivers' noise
            sigma = max(float(np.mean(share**2 * left + sigma * (1 - share))), LEAST_DB2)
        mean, variance = np.empty(grid.size), np.empty(grid.size)
        for first in range(0, grid.size, CHUNK):
            part = slice(first, first + CHUNK)
            some = _functions(xy[part], lattices)
            mean[part] = mean_db + some @ eta
            variance[part] = sigma + np.einsum("pr,rs,ps->p", some, A, some)
        return mean, variance


def _lattice(grid: Grid, along: int) -> tuple[Array, float]:
    """Centres ``[r, (x, y)]`` in metres, up to one spacing outside the map, and the spacing."""
    low, high = grid.xy_m(grid.cells[[0, -1]])
    low, high = np.minimum(low, high), np.maximum(low, high)
    spacing = max(float((high - low).max()), grid.spacing_m) / along
    axes = [
        np.arange(a - spacing / 2, b + spacing, spacing) for a, b in zip(low, high, strict=True)
    ]
    x, y = np.meshgrid(*axes, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()]), spacing


def _functions(xy_m: Array, lattices: list[tuple[Array, float]]) -> Array:
    """``[place, function]`` (1 − (d/R)²)² within the radius R, 0 outside."""
    parts = []
    for centres, spacing in lattices:
        square = ((xy_m[:, None] - centres[None]) ** 2).sum(axis=-1) / (REACH * spacing) ** 2
        parts.append(np.maximum(1.0 - square, 0.0) ** 2)
    return np.concatenate(parts, axis=1)
