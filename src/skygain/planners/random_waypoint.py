"""Random waypoints, the paper's passive baseline (section VIII-B) and the motion its predictors are
trained on.

Each UAV repeats its last move with probability p and otherwise draws a legal move uniformly. The
last move is read from the swarm's history, so a survey that plans again in the middle continues
straight.
"""

from __future__ import annotations

__all__ = ["RandomWaypointPlanner"]

from dataclasses import dataclass

import numpy as np
from numba import njit

from skygain.flight.airspace import Airspace, blocked_home, home_margins, resolve_step
from skygain.flight.moves import DCOL, DROW, Cells
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.predictors.base import Belief


@dataclass(frozen=True)
class RandomWaypointPlanner(Planner):
    """Straight on with probability p, else any legal move. O(horizon · N²), a few microseconds per
    step."""

    repeat_probability: float = 0.8
    """p, the probability of repeating the last move; when that move is illegal the UAV draws like
    otherwise"""

    def __post_init__(self) -> None:
        if not 0 <= self.repeat_probability <= 1:
            raise InputError(
                f"repeat_probability must lie in 0..1, got {self.repeat_probability}; the paper "
                "uses 0.8"
            )

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        return Plan(self.paths(swarm, horizon, rng), commit_steps=horizon)

    def paths(self, swarm: Swarm, horizon: int, rng: np.random.Generator) -> Cells:
        """``[uav, horizon + 1, (row, col)]`` legal random paths; needs no belief.

        Raises:
            InputError: UAVs that must return block each other's way home.
        """
        last = np.full(swarm.n_uavs, -1)
        if swarm.steps_flown:
            delta = swarm.history[:, -1] - swarm.history[:, -2]
            match = (delta[:, None, 0] == DROW) & (delta[:, None, 1] == DCOL)
            last = np.where(match.any(axis=1), match.argmax(axis=1), -1)
        air = Airspace.of(swarm)
        draws = rng.random((horizon, swarm.n_uavs, 5))
        start = np.ascontiguousarray(swarm.cells)
        for margin in home_margins(swarm):
            paths, flown = _walk(
                start, swarm.steps_left, last, draws, self.repeat_probability, margin, air
            )
            if flown == horizon:
                return paths
        raise blocked_home()


@njit(cache=True)
def _walk(start, left, last, draws, p, margin, air):
    """Random-waypoint paths ``[uav, step, 2]`` from uniform ``draws[step, uav, 5]``, and how many
    steps succeeded."""
    horizon, n, _ = draws.shape
    paths = np.empty((n, horizon + 1, 2), dtype=np.int64)
    for u in range(n):
        paths[u, 0, 0], paths[u, 0, 1] = start[u, 0], start[u, 1]
    left, last = left.copy(), last.copy()
    now, then = start.copy(), start.copy()
    score = np.empty((n, 4))
    for step in range(horizon):
        for u in range(n):
            # the highest of four uniform draws is a uniform choice among any legal subset
            for m in range(4):
                score[u, m] = draws[step, u, 1 + m]
            if last[u] >= 0 and draws[step, u, 0] < p:
                score[u, last[u]] = 2.0
        if not resolve_step(now, score, left, margin, air, then):
            return paths, step
        for u in range(n):
            for m in range(4):
                if then[u, 0] - now[u, 0] == DROW[m] and then[u, 1] - now[u, 1] == DCOL[m]:
                    last[u] = m
            left[u] = max(left[u] - 1, 0)
            paths[u, step + 1, 0], paths[u, step + 1, 1] = then[u, 0], then[u, 1]
            now[u, 0], now[u, 1] = then[u, 0], then[u, 1]
    return paths, horizon
