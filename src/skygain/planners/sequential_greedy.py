"""Sequential greedy planning: UAVs choose their paths one after another, each knowing what the others will measure.

The first UAV takes the path that gains most, the second the path that gains most given the first one's readings, and so on; then
every UAV in turn plans again given all the others, until no one gains. The cost grows linearly with the number of UAVs. Three
objectives can be chosen: the fall of the posterior variance summed over outdoor unvisited cells (the expected squared error
itself), the entropy of the readings, and their mutual information with the unvisited cells.
"""

from __future__ import annotations

__all__ = ["SequentialGreedyPlanner"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.planners.covariance import PlanningField, planning_field
from skygain.planners.flight import Airspace, Cells, bfs, followed
from skygain.planners.path_search import (
    ENTROPY,
    MUTUAL_INFORMATION,
    VARIANCE,
    Reach,
    Traffic,
    beam_path,
    exact_path,
    path_value,
)
from skygain.planners.volatility import volatility
from skygain.predictors.base import Belief
from skygain.swarm import Swarm

OBJECTIVES = {"variance": VARIANCE, "entropy": ENTROPY, "mutual-information": MUTUAL_INFORMATION}


@dataclass(frozen=True)
class SequentialGreedyPlanner(Planner):
    objective: str = "variance"
    horizon: int = 20
    commit_steps: int = 10
    sweeps: int = 1
    width: int = 200
    exact_horizon: int = 6
    max_targets: int = 500
    target_range_m: float = 60.0
    noise_db2: float = 1.0
    stride: int = 1
    weighted: bool = True
    max_readings: int = 400

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        steps = min(self.horizon, horizon)
        field = planning_field(belief)
        air = Airspace.of(swarm)
        weight = (belief.scenario.outdoor & ~swarm.visited).astype(float)
        if self.weighted and field.is_stationary:
            weight *= volatility(field.posterior.mean_db)
        paths = np.repeat(swarm.cells[:, None], steps + 1, axis=1)
        known = np.where(swarm.flying, 0, steps)
        values = np.zeros(swarm.n_uavs)
        turns = [np.flatnonzero(swarm.flying)] * (1 + self.sweeps)
        for sweep, uavs in enumerate(turns):
            gained = False
            for u in rng.permutation(uavs):
                others = [v for v in uavs if v != u and known[v] > 0]
                ahead = int(min(steps, swarm.steps_left[u]))
                reach = self._reach(field, swarm, weight, paths, known, others, u, ahead)
                traffic = Traffic(paths, known, swarm.steps_left)
                order = rng.permutation(4)
                if ahead <= self.exact_horizon:
                    path, value = exact_path(u, swarm.cells[u], ahead, order, reach, traffic, air)
                else:
                    path, value = beam_path(u, swarm.cells[u], ahead, self.width, order, reach, traffic, air)
                if sweep > 0:
                    if value <= path_value(paths[u, : known[u] + 1], reach) * (1 + 1e-4):
                        continue
                gained = True
                paths[u, : len(path)] = path
                paths[u, len(path) :] = path[-1]
                known[u] = len(path) - 1 if len(path) > 1 else steps
                values[u] = value
            if not gained:
                break
        routes = [paths[u, : min(known[u], swarm.steps_left[u]) + 1] for u in range(swarm.n_uavs)]
        legal = followed(swarm, routes, steps)
        return Plan(legal, commit_steps=min(self.commit_steps, steps))

    def _reach(self, field, swarm, weight, paths, known, others, u, ahead):  # type: ignore[no-untyped-def]
        flyable = swarm.flyable
        distance = np.empty(flyable.shape, dtype=np.int32)
        row, col = swarm.cells[u]
        bfs(np.ascontiguousarray(flyable), int(row), int(col), distance, np.empty(flyable.size, dtype=np.int64))
        near = (distance > 0) & (distance <= ahead)
        if self.stride == 2:
            near &= distance % 2 == 0
        cells = np.argwhere(near)
        index = np.full(flyable.shape, -1, dtype=np.int32)
        index[near] = np.arange(len(cells))
        planned = [paths[v, 1 : known[v] + 1] for v in others]
        planned_cells = np.unique(np.concatenate([np.empty((0, 2), dtype=np.int64), *planned]), axis=0)
        if self.stride == 2 and len(planned_cells):
            planned_cells = np.unique(np.concatenate([p[1::2] for p in planned]), axis=0)
        reach_cells = self.target_range_m / swarm.spacing_m
        span = ahead + reach_cells
        if len(planned_cells):
            planned_cells = planned_cells[np.abs(planned_cells - (row, col)).max(axis=1) <= span + reach_cells]
        targets, root = targets_of(weight, (int(row), int(col)), span, self.max_targets)
        local = field.near(swarm.cells[u : u + 1], self.max_readings)
        joined, factor = local.whitener(planned_cells, self.noise_db2)
        white = local.whitened(joined, factor, np.concatenate([cells, targets]))
        mine, theirs = white[:, : len(cells)], white[:, len(cells) :]
        among = local.prior(cells, cells).astype(np.float32) - mine.T @ mine
        objective = OBJECTIVES[self.objective]
        level = float(np.max(np.diag(local.prior(cells[:1], cells[:1])), initial=1.0))
        empty = np.zeros((len(cells), 0), dtype=np.float32)
        with_targets = given = empty
        if objective == VARIANCE:
            with_targets = (local.prior(cells, targets).astype(np.float32) - mine.T @ theirs) * root
        elif objective == MUTUAL_INFORMATION:
            both, factor2 = local.whitener(np.concatenate([planned_cells, targets]), self.noise_db2)
            w2 = local.whitened(both, factor2, cells)
            given = local.prior(cells, cells).astype(np.float32) - w2.T @ w2
        return Reach(
            index,
            among,
            np.ascontiguousarray(with_targets),
            given,
            self.noise_db2 if objective != VARIANCE else 1e-3 * level,
            1e-4 * level,
            objective,
        )


def targets_of(weight: NDArray[np.float64], centre: tuple[int, int], span: float, most: int):  # type: ignore[no-untyped-def]
    rows, cols = weight.shape
    low = (max(0, int(centre[0] - span)), max(0, int(centre[1] - span)))
    high = (min(rows, int(centre[0] + span) + 1), min(cols, int(centre[1] + span) + 1))
    window = weight[low[0] : high[0], low[1] : high[1]]
    cells = np.argwhere(window > 0)
    w = window[window > 0]
    side = 1
    while True:
        block = (cells // side) @ np.array([10_000, 1])
        _, where = np.unique(block, return_inverse=True)
        n = int(where.max(initial=-1)) + 1
        if n <= most:
            break
        side += 1
    total = np.bincount(where, w, minlength=n)
    off = np.abs(cells % side - (side - 1) / 2).sum(axis=1)
    order = np.lexsort((off, where))
    first = order[np.searchsorted(where[order], np.arange(n))]
    return cells[first] + low, np.sqrt(total).astype(np.float32)
