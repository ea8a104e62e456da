"""Greedy variance, the paper's active baseline (section VIII-D, problems P4 and P5), for any
belief.

Every UAV on its own takes the path with the largest sum of predicted variances, Σ_t σ²(P_{t+1}),
among the paths on which each move leads further from where the UAV stood when it planned (the
paper's G*). "Further" is measured in moves round the buildings (the breadth-first distance d), so
every move adds exactly one, time is the distance itself, and value iteration needs each cell once:

    V(c) = max over neighbours c' with d(c') = d(c) + 1 of  σ²(c') + V(c'),     V = 0 where no such
    neighbour is left.

Where no move leads further (the end of a street, the rim of the map), G* starts anew from there,
with the variance of the cells already on the path counted as zero; where all such moves are blocked
by other UAVs, the UAV takes its best other legal move.
"""

from __future__ import annotations

__all__ = ["GreedyVariancePlanner"]

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from skygain.flight.airspace import (
    Airspace,
    blocked_home,
    home_margins,
    resolve_step,
)
from skygain.flight.moves import DCOL, DROW
from skygain.flight.swarm import Swarm
from skygain.flight.ways import fill_steps
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.planners.random_waypoint import RandomWaypointPlanner
from skygain.predictors.base import Belief


@dataclass(frozen=True)
class GreedyVariancePlanner(Planner):
    """Per-UAV value iteration over the predicted variance. O(N · cells) per plan and restart of
    G*."""

    start_steps: int = 20
    """T_start: random-waypoint steps flown before the variance is trusted"""
    commit_steps: int = 40
    """T_plan: steps flown before planning again"""
    start: RandomWaypointPlanner = field(default_factory=RandomWaypointPlanner)
    """how the first steps are flown"""

    def __post_init__(self) -> None:
        if self.start_steps < 0 or self.commit_steps < 1:
            raise InputError(
                "greedy variance needs start_steps >= 0 and commit_steps >= 1, got "
                f"{self.start_steps} and {self.commit_steps}; "
                "the paper uses 20 and 40"
            )

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        if swarm.steps_flown < self.start_steps:
            steps = min(self.start_steps - swarm.steps_flown, horizon)
            return Plan(self.start.paths(swarm, steps, rng), commit_steps=steps)
        variance = np.array(belief.posterior().variance_db2, dtype=np.float64)
        variance[swarm.visited] = 0.0
        noise = rng.random((swarm.n_uavs, 4)) * 1e-9  # breaks ties between equal streets, by seed
        air, start = Airspace.of(swarm), np.ascontiguousarray(swarm.cells)
        for margin in home_margins(swarm):
            paths, flown = _greedy(start, swarm.steps_left, horizon, variance, noise, margin, air)
            if flown == horizon:
                return Plan(paths, commit_steps=min(self.commit_steps, horizon))
        raise blocked_home()


@njit(cache=True)
def _away_values(flyable, row, col, steps, variance, distance, value, queue):
    """Fill ``distance`` from (row, col) and the value of moving away from there within ``steps``
    moves."""
    rows, cols = flyable.shape
    reached = fill_steps(flyable, row, col, distance, queue)
    for k in range(reached - 1, -1, -1):  # breadth-first order backwards: farthest cells first
        r, c = queue[k] // cols, queue[k] % cols
        value[r, c] = 0.0
        if distance[r, c] >= steps:
            continue
        best = 0.0
        for m in range(4):
            i, j = r + DROW[m], c + DCOL[m]
            if 0 <= i < rows and 0 <= j < cols and distance[i, j] == distance[r, c] + 1:
                best = max(best, variance[i, j] + value[i, j])
        value[r, c] = best


@njit(cache=True)
def _greedy(start, left, horizon, variance, noise, margin, air):
    """Greedy paths ``[uav, step, 2]`` and how many steps succeeded."""
    n = len(start)
    rows, cols = air.flyable.shape
    paths = np.empty((n, horizon + 1, 2), dtype=np.int64)
    paths[:, 0] = start
    left = left.copy()
    now, then = start.copy(), start.copy()
    own = np.empty(
        (n, rows, cols)
    )  # what each UAV still finds at a cell: it knows its own path, not the others'
    distance = np.empty((n, rows, cols), dtype=np.int32)
    value = np.empty((n, rows, cols))
    queue = np.empty(rows * cols, dtype=np.int64)
    score = np.empty((n, 4))
    for u in range(n):
        own[u] = variance
        _away_values(
            air.flyable,
            now[u, 0],
            now[u, 1],
            min(horizon, left[u]),
            own[u],
            distance[u],
            value[u],
            queue,
        )
    for step in range(horizon):
        for u in range(n):
            if left[u] <= 0:
                continue
            for attempt in range(2):
                away = False
                for m in range(4):
                    i, j = now[u, 0] + DROW[m], now[u, 1] + DCOL[m]
                    score[u, m] = -1e9
                    if not (0 <= i < rows and 0 <= j < cols) or not air.flyable[i, j]:
                        continue
                    score[u, m] = own[u, i, j] + value[u, i, j] + noise[u, m]
                    if distance[u, i, j] > distance[u, now[u, 0], now[u, 1]]:
                        away = True
                    else:
                        score[u, m] -= 1e6
                if away or attempt == 1:
                    break
                ahead = min(horizon - step, left[u])
                _away_values(
                    air.flyable, now[u, 0], now[u, 1], ahead, own[u], distance[u], value[u], queue
                )
        if not resolve_step(now, score, left, margin, air, then):
            return paths, step
        for u in range(n):
            left[u] = max(left[u] - 1, 0)
            own[u, then[u, 0], then[u, 1]] = 0.0
            paths[u, step + 1] = then[u]
        now[:] = then
    return paths, horizon
