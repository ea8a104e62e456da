"""Spectrum surveying along ways of least cost, after Shrestha, Romero and Chepuri (2022).

A UAV heads for the place where the belief is least sure, and takes the way there on which it learns
most: that of least cost, where entering a cell costs the inverse of its standard deviation. The
method was made for one UAV. With several, they choose one after another, and each leaves the
surroundings of the others' goals alone; the ways are flown so that nobody is in the way.
"""

from __future__ import annotations

__all__ = ["MinCostPathPlanner"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from skygain.flight.airspace import followed
from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.predictors.base import Belief

FLOOR = 0.05
"""share of the largest standard deviation that a known cell counts as, so that its cost is
finite"""


@dataclass(frozen=True)
class MinCostPathPlanner(Planner):
    """To the least sure place by the most instructive way.

    Raises:
        InputError: no step to fly, or a negative distance.
    """

    commit_steps: int = 20
    """steps flown at most before planning again; fewer where a goal is nearer"""
    apart_m: float = 60.0
    """distance that goals of several UAVs keep from each other where they can"""

    def __post_init__(self) -> None:
        if self.commit_steps < 1 or not self.apart_m >= 0:
            raise InputError(
                "least-cost paths need `commit_steps` of 1 or more and `apart_m` of 0 or more, got "
                f"{self.commit_steps} and {self.apart_m:g}"
            )

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        std = belief.posterior().std_db
        flyable = swarm.flyable
        doubt = np.where(flyable, std, 0.0)
        cost = 1.0 / (doubt / max(float(doubt.max()), 1e-9) + FLOOR)
        graph = _graph(flyable, cost)
        spacing_m, cells = belief.scenario.grid.spacing_m, belief.scenario.grid.cells
        free = np.ones(flyable.size, dtype=bool)
        routes: list[Cells] = []
        for uav in range(swarm.n_uavs):
            here = int(np.ravel_multi_index(tuple(swarm.cells[uav]), flyable.shape))
            away, before = dijkstra(graph, indices=here, return_predecessors=True)
            reachable = np.isfinite(away) & (np.arange(flyable.size) != here)
            wanted = reachable & free if (reachable & free).any() else reachable
            if not swarm.flying[uav] or not wanted.any():
                routes.append(swarm.cells[uav][None])
                continue
            goal = int(np.argmax(np.where(wanted, doubt.ravel(), -1.0)))
            free &= spacing_m * np.hypot(*(cells - cells[goal]).T) > self.apart_m
            way = [goal]
            while way[-1] != here:
                way.append(int(before[way[-1]]))
            routes.append(cells[way[::-1]].astype(np.int64))
        reached = min((len(r) - 1 for r in routes if len(r) > 1), default=1)
        commit = max(1, min(reached, self.commit_steps, horizon))
        return Plan(followed(swarm, routes, min(horizon, self.commit_steps)), commit)


def _graph(flyable: NDArray[np.bool_], cost: NDArray[np.float64]) -> csr_array:
    """``[cell, cell]`` cost of moving between neighbours, that of the cell entered."""
    number = np.arange(flyable.size).reshape(flyable.shape)
    pairs = []
    for first, second in (
        (np.s_[:-1, :], np.s_[1:, :]),
        (np.s_[:, :-1], np.s_[:, 1:]),
    ):
        both = flyable[first] & flyable[second]
        one, other = number[first][both], number[second][both]
        pairs += [(one, other), (other, one)]
    start, end = (np.concatenate(side) for side in zip(*pairs, strict=True))
    return csr_array((cost.ravel()[end], (start, end)), shape=(flyable.size,) * 2)
