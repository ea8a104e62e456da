"""What one UAV can measure within its horizon, and which cells it can teach something about.

`LocalReach` holds one UAV's covariances given the readings so far; they are computed once per
decision. `LocalReach.given` conditions them on what the other UAVs plan, which is a small update
and happens every time the UAV's turn comes.

Target cells stand for small blocks of outdoor unvisited cells: the outdoor cell nearest the middle
of the block, with the summed weight of the block, so that the sum over targets approximates the sum
over the map.
"""

from __future__ import annotations

__all__ = ["Attention", "LocalReach", "target_cells"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from skygain.fields.planning import Conditioned, PlanningField, less_product
from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.flight.ways import distances_within
from skygain.planners.search.objectives import Objective
from skygain.planners.search.path_gain import Reach

Floats = NDArray[np.float32]

KNOWN_SHARE = 1e-4
"""share of the prior variance below which a cell counts as known"""


def target_cells(
    weight: NDArray[np.float64], centre: Cells | NDArray[np.float64], span: float, most: int
) -> tuple[Cells, Floats]:
    """Up to ``most`` cells ``[x, (row, col)]`` that stand for the weighted cells within ``span`` of
    ``centre``, and their weights."""
    low = np.maximum(0, np.floor(centre - span)).astype(int)
    high = np.minimum(weight.shape, np.ceil(centre + span + 1)).astype(int)
    window = weight[low[0] : high[0], low[1] : high[1]]
    cells = np.argwhere(window > 0)
    side = max(1, int(np.sqrt(len(cells) / max(most, 1))))
    while True:
        block = (cells // side) @ np.array([window.shape[1] + 1, 1])
        _, where = np.unique(block, return_inverse=True)
        n = int(where.max(initial=-1)) + 1
        if n <= most:
            break
        side += 1
    from_middle = np.abs(cells % side - (side - 1) / 2).sum(axis=1)
    order = np.lexsort((from_middle, where))
    first = order[np.searchsorted(where[order], np.arange(n))]
    return cells[first] + low, np.bincount(where, window[window > 0], minlength=n).astype(
        np.float32
    )


@dataclass(frozen=True)
class Attention:
    """What a UAV looks at, and what it is paid for."""

    objective: Objective
    """what is maximised"""
    noise_db2: float
    """noise variance of a planned reading"""
    stride: int
    """1 counts every cell of a path as measured, 2 every second one"""
    most_readings: int
    """readings conditioned on, the nearest"""
    most_targets: int
    """cells that stand for the map"""
    target_range_m: float
    """how far beyond its reach a UAV looks for cells to learn about"""


@dataclass(frozen=True, eq=False)
class LocalReach:
    """Covariances around one UAV given the readings so far, in single precision."""

    source: Conditioned
    """where covariances come from"""
    index: NDArray[np.int32]
    """``[row, col]`` number of each measurable cell, −1 elsewhere"""
    cells: Cells
    """``[m, (row, col)]`` measurable cells"""
    targets: Cells
    """``[x, (row, col)]`` target cells"""
    root: Floats
    """``[x]`` square root of the targets' weights"""
    white: Floats
    """``[n, m + x]`` covariance of the whitened readings with measurable and target cells"""
    among: Floats
    """``[m, m]`` covariance of the measurable cells"""
    with_targets: Floats
    """``[m, x]`` covariance of measurable cells and targets"""
    attention: Attention
    """what it was computed for"""

    @classmethod
    def around(
        cls,
        field: PlanningField,
        swarm: Swarm,
        uav: int,
        steps: int,
        weight: NDArray[np.float64],
        attention: Attention,
    ) -> LocalReach:
        """The reach of ``uav`` within ``steps``, to learn about cells that count by ``weight[row,
        col]``."""
        here = swarm.cells[uav]
        distance = distances_within(swarm.flyable, here, steps)
        near = (distance >= 0) & (distance <= steps) & (distance % attention.stride == 0)
        cells = np.argwhere(near)
        index = np.full(distance.shape, -1, dtype=np.int32)
        index[near] = np.arange(len(cells))
        beyond = attention.target_range_m / swarm.spacing_m
        if attention.objective == Objective.ENTROPY:  # a matter of the measured cells alone
            targets, weights = np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.float32)
        else:
            targets, weights = target_cells(weight, here, steps + beyond, attention.most_targets)
        # readings as far beyond the targets as those are beyond the reach are screened off by
        # nearer ones
        near_by = field.near(here[None], attention.most_readings, steps + 2 * beyond)
        source = near_by.conditioned(np.float32)
        white = source.whitened(np.concatenate([cells, targets]))
        mine, theirs = white[:, : len(cells)], white[:, len(cells) :]
        return cls(
            source=source,
            index=index,
            cells=cells,
            targets=targets,
            root=np.sqrt(weights),
            white=white,
            among=source.covariance(cells, cells, mine, mine),
            with_targets=source.covariance(cells, targets, mine, theirs),
            attention=attention,
        )

    def given(self, planned: Cells) -> Reach:
        """The reach when ``planned[p, (row, col)]``, distinct cells, will be measured by others."""
        among, with_targets, objective = self.among, self.with_targets, self.attention.objective
        if len(planned):
            shares = self._explained(planned, np.concatenate([self.cells, self.targets]))
            mine, theirs = shares[:, : len(self.cells)], shares[:, len(self.cells) :]
            among = less_product(among.copy(), mine, mine)
            with_targets = less_product(with_targets.copy(), mine, theirs)
        given_targets = np.zeros((0, 0), dtype=np.float32)
        if objective == Objective.MUTUAL_INFORMATION:
            known = np.unique(np.concatenate([planned, self.targets]), axis=0)
            shares = self._explained(known, self.cells)
            given_targets = less_product(self.among.copy(), shares, shares)
        if objective == Objective.VARIANCE:
            with_targets = with_targets * self.root
        return Reach(
            self.index,
            among,
            np.ascontiguousarray(with_targets),
            given_targets,
            self.attention.noise_db2,
            KNOWN_SHARE * self.source.field.level_db2,
            objective,
        )

    def _explained(self, known: Cells, cells: Cells) -> Floats:
        """``[k, n]`` covariance of the whitened readings of ``known[k]`` with ``cells[n]``, which
        are the first of ours."""
        white = self.source.whitened(known)
        gram = self.source.covariance(known, known, white, white).astype(float)
        gram[np.diag_indices_from(gram)] += self.attention.noise_db2
        cross = self.source.covariance(known, cells, white, self.white[:, : len(cells)])
        return solve_triangular(
            np.linalg.cholesky(gram).astype(np.float32), cross, lower=True, check_finite=False
        )
