"""Thin plate splines and block terms, after Zhang, Fu, Wang, Zhao and Hong (2020).

The map is a sum of terms, each of low rank in rows and columns. Splines fill the cells between the
readings, and TensorLy fits the terms to readings and filled cells; a filled cell counts the less,
the farther the nearest reading is. The variance is the error at readings left out, by distance.
docs/kriging.md has the equations and what differs from the paper.
"""

from __future__ import annotations

__all__ = ["TensorPredictor"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.ground.errors import InputError, require
from skygain.predictors.interpolators.interpolation import (
    InterpolationBelief,
    ReadingsPredictor,
    nearest_reading_m,
    trained_error_db2,
    variance_by_distance,
)
from skygain.predictors.interpolators.readings import Readings
from skygain.predictors.interpolators.thin_plate import (
    CHUNK,
    ON_A_LINE,
    kernel,
    plane,
    roughness_and_scale,
)
from skygain.scenario import Scenario

Array = NDArray[np.float64]

SWEEPS = 40
"""of alternating least squares, each followed by filling in what the terms say"""
RIDGE = 0.23
"""of the factors, for gains of unit variance, times √rows + √columns: the norm of a map of noise"""
SPLINE_READINGS = 400
"""most readings that the spline goes through, which bounds the time; the terms see all"""
DISCS = (1.5, 6.0, 16.0, 48.0)
"""radii of the discs that are left out, in cells"""
TARGETS = 24
"""most discs of one radius that are left out together"""


@dataclass(frozen=True)
class TensorPredictor(ReadingsPredictor):
    """See the module.

    `RIDGE` had the smallest mean error of seven values on 10 surveys of split T2 of the small
    Manhattan set (three UAVs, random waypoints, after 25, 100 and 200 steps). The maps of ranks 2
    and 8 were equally good there: the ridge leaves few terms.

    Raises:
        InputError: a rank below 1.
    """

    rank: int = 4
    """largest rank of the map: terms times the rank of each"""

    def __post_init__(self) -> None:
        if self.rank < 1:
            raise InputError(f"the terms need `rank` of 1 or more, got {self.rank}; 4 is usual")

    def begin(self, scenario: Scenario) -> InterpolationBelief:
        """The belief before the first measurement.

        Raises:
            MissingExtraError: TensorLy is not installed.
        """
        require("tensorly", "tensor")
        return super().begin(scenario)

    def memory_bytes(self, cells: int, readings: int) -> float:
        """A chunk's kernels, and the maps with discs left out."""
        held = 32.0 * CHUNK * min(readings, SPLINE_READINGS) + 160.0 * cells
        return super().memory_bytes(cells, readings) + held

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        grid = scenario.grid
        rank_of = np.random.default_rng(0).permutation(grid.size)[readings.cells]
        left_out = _discs(grid.cells[readings.cells], np.argsort(rank_of))
        use = np.array([np.ones(len(readings), dtype=bool), *(use for use, _ in left_out)])
        filled = _splines(grid, readings, use, rank_of)
        maps = [
            self._completed(scenario, _taken(readings, used), surface)
            for used, surface in zip(use, filled, strict=True)
        ]
        nearest, errors = [np.empty(0)], [np.empty(0)]
        for (used, targets), map_db in zip(left_out, maps[1:], strict=True):
            away = nearest_reading_m(scenario, _taken(readings, used))
            cells = readings.cells[targets]
            nearest.append(away[cells])
            errors.append((map_db[cells] - readings.gain_db[targets]) ** 2)
        variance = variance_by_distance(
            scenario, readings, np.concatenate(nearest), np.concatenate(errors)
        )
        return maps[0], variance

    def _completed(self, scenario: Scenario, readings: Readings, surface_db: Array) -> Array:
        """``[P]`` the terms that are nearest to readings and surface.

        Each sweep fits them to w·y + (1 − w)·x, with x what they said before: a bound from above of
        Σ w (y − x)² that touches it at x, so the weighted error falls with every sweep.
        """
        import tensorly as tl
        from tensorly.cp_tensor import CPTensor, cp_to_tensor
        from tensorly.decomposition import parafac

        shape = scenario.grid.shape
        level, scale = readings.gain_db.mean(), readings.gain_db.std() or 1.0
        error = trained_error_db2(scenario, nearest_reading_m(scenario, readings))
        nugget = trained_error_db2(scenario, np.zeros(1))
        error[readings.cells] += readings.noise_db2
        y = (surface_db - level) / scale
        y[readings.cells] = (readings.gain_db - level) / scale
        w, y = (nugget / error).reshape(shape), y.reshape(shape)
        rank = min(self.rank, *shape)
        with tl.backend_context("numpy", local_threadsafe=True):
            U, s, V = tl.truncated_svd(y, n_eigenvecs=rank)
            terms = CPTensor((np.ones(rank), [U * np.sqrt(s), V.T * np.sqrt(s)]))
            for _ in range(SWEEPS):
                goal = w * y + (1 - w) * cp_to_tensor(terms)
                ridge = RIDGE * np.sqrt(shape).sum()
                terms = parafac(goal, rank, init=terms, n_iter_max=1, tol=0, l2_reg=ridge)
            return level + scale * np.asarray(cp_to_tensor(terms)).ravel()


def _taken(readings: Readings, use: NDArray[np.bool_]) -> Readings:
    return Readings(readings.cells[use], readings.gain_db[use], readings.noise_db2[use])


def _discs(
    cells: NDArray[np.int64], order: NDArray[np.int64]
) -> list[tuple[NDArray[np.bool_], NDArray[np.int64]]]:
    """For each radius of `DISCS` the readings that stay, and those at the middles of discs that do
    not overlap; at least half of the readings stay."""
    found = []
    for radius in DISCS:
        use, targets = np.ones(len(cells), dtype=bool), np.empty(0, dtype=np.int64)
        for middle in order:
            away = np.linalg.norm(cells - cells[middle], axis=1)
            stays = use & (away > radius)
            apart = len(targets) == 0 or away[targets].min() > 2 * radius
            if apart and 2 * stays.sum() >= len(cells):
                use, targets = stays, np.append(targets, middle)
            if len(targets) == TARGETS:
                break
        if len(targets):
            found.append((use, targets))
    return found


def _splines(
    grid: Grid, readings: Readings, use: NDArray[np.bool_], rank_of: NDArray[np.int64]
) -> Array:
    """``[f, P]`` thin plate splines through the readings that ``use[f, v]`` counts, held to their
    range; their mean where three of them are not off one line."""
    fewer = np.argsort(rank_of)[:SPLINE_READINGS]
    use, gain, noise = use[:, fewer], readings.gain_db[fewer], readings.noise_db2[fewer]
    everywhere = grid.xy_m(grid.cells)
    xy = everywhere[readings.cells[fewer]]
    middle = xy.mean(axis=0)
    extent = np.sqrt(((xy - middle) ** 2).sum(axis=1).mean()) or 1.0
    xy, everywhere = (xy - middle) / extent, (everywhere - middle) / extent
    if not _spread(xy):
        level = np.array([gain[u].mean() if u.any() else gain.mean() for u in use])
        return np.repeat(level[:, None], grid.size, axis=1)
    K, P, v, level = kernel(xy, xy), plane(xy), len(xy), gain.mean()
    roughness, scale = roughness_and_scale(K, P, gain - level)
    own = K + np.diag(roughness + noise / max(scale, 1e-12))
    weights = np.zeros((len(use), v + 3))
    for weight, u in zip(weights, use, strict=True):
        if not _spread(xy[u]):
            weight[v] = gain[u].mean() - level if u.any() else 0.0
            continue
        system = np.block([[own[np.ix_(u, u)], P[u]], [P[u].T, np.zeros((3, 3))]])
        weight[np.append(u, np.ones(3, dtype=bool))] = np.linalg.solve(
            system, np.append(gain[u] - level, np.zeros(3))
        )
    surface = np.empty((len(use), grid.size))
    for first in range(0, grid.size, CHUNK):
        part = slice(first, first + CHUNK)
        surface[:, part] = weights @ np.concatenate(
            [kernel(xy, everywhere[part]), plane(everywhere[part]).T]
        )
    return np.clip(level + surface, gain.min(), gain.max())


def _spread(xy: Array) -> bool:
    """Whether more than three places lie off one line."""
    if len(xy) <= 3:
        return False
    long, short = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)
    return bool(short >= ON_A_LINE * long)
