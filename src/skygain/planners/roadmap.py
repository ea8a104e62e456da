"""Paths of much uncertainty on a probabilistic road map (Kavraki et al., 1996), for any belief.

Random free cells are the junctions of a road map; each is joined to those nearest by ways of the
fewest moves around the buildings. A beam search looks for the path along the roads that gathers the
most standard deviation per move, every cell counted once. UAVs choose in stages, one after another:
what lies near the paths already given away counts less.
"""

from __future__ import annotations

__all__ = ["RoadMap", "RoadMapPlanner"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from skygain.flight.airspace import followed
from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.flight.ways import breadth_first, distances_within
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.predictors.base import Belief


@dataclass(frozen=True, eq=False)
class RoadMap:
    """Junctions, and the roads that lead on from each; cells are raveled."""

    junctions: NDArray[np.int64]
    """``[junction]`` cells"""
    roads: list[dict[int, NDArray[np.int64]]]
    """``roads[junction][junction]`` cells that are entered on the way"""

    @classmethod
    def joined(
        cls, flyable: NDArray[np.bool_], junctions: NDArray[np.int64], neighbours: int
    ) -> RoadMap:
        """Each of ``junctions`` joined to so many others nearest to it, both ways."""
        flyable = np.ascontiguousarray(flyable)
        roads: list[dict[int, NDArray[np.int64]]] = [{} for _ in junctions]
        queue = np.empty(flyable.size, dtype=np.int64)
        for start, cell in enumerate(junctions):
            steps = np.full(flyable.size, -1, dtype=np.int32)
            before = np.empty(flyable.size, dtype=np.int64)
            breadth_first(flyable, junctions[start : start + 1], -1, steps, before, queue)
            away = steps[junctions]
            order = np.argsort(away, kind="stable")
            for end in order[away[order] > 0][:neighbours]:
                way = [int(junctions[end])]
                while way[-1] != cell:
                    way.append(int(before[way[-1]]))
                roads[start].setdefault(int(end), np.array(way[-2::-1]))
                roads[int(end)].setdefault(start, np.array(way[1:]))
        return cls(junctions, roads)

    def best_path(
        self, start: int, worth: NDArray[np.float64], steps: int, width: int
    ) -> NDArray[np.int64]:
        """The cells entered on the path from junction ``start`` within ``steps`` moves that gathers
        the most ``worth[cell]`` per move, as far as a beam of ``width`` paths finds it; empty where
        no road fits."""
        beam = [_Path((), (start,), 0.0, 0)]
        ended: list[_Path] = []
        while beam:
            longer = []
            for path in beam:
                seen = np.concatenate([*path.cells, self.junctions[[start]]])
                on = [
                    path.along(road, end, worth, seen)
                    for end, road in self.roads[path.junctions[-1]].items()
                    if end not in path.junctions and path.moves + len(road) <= steps
                ]
                longer += on
                if not on and path.moves:
                    ended.append(path)
            beam = sorted(longer, key=lambda path: -path.per_move)[:width]
        if not ended:
            return np.empty(0, dtype=np.int64)
        return np.concatenate(max(ended, key=lambda path: path.per_move).cells)


@dataclass(frozen=True, eq=False)
class _Path:
    """A path under construction."""

    cells: tuple[NDArray[np.int64], ...]
    """of each road taken"""
    junctions: tuple[int, ...]
    """passed so far"""
    gathered: float
    """worth of the distinct cells"""
    moves: int
    """of all roads"""

    @property
    def per_move(self) -> float:
        return self.gathered / self.moves

    def along(
        self, road: NDArray[np.int64], end: int, worth: NDArray[np.float64], seen: NDArray[np.int64]
    ) -> _Path:
        """This path with one more road."""
        new = road[~np.isin(road, seen)]
        return _Path(
            (*self.cells, road),
            (*self.junctions, end),
            self.gathered + float(worth[new].sum()),
            self.moves + len(road),
        )


@dataclass(frozen=True)
class RoadMapPlanner(Planner):
    """The path on a random road map that gathers the most uncertainty per move.

    Raises:
        InputError: a number of junctions, roads or steps below 1, or a negative distance.
    """

    junctions: int = 100
    """random cells that the road map joins"""
    neighbours: int = 6
    """roads that lead from each to those nearest"""
    path_steps: int = 60
    """moves of a path at most"""
    commit_steps: int = 20
    """steps flown before planning again; fewer where a path is shorter"""
    width: int = 24
    """paths that the search keeps"""
    apart_m: float = 30.0
    """so far from another UAV's path uncertainty counts in full; nearer, in proportion"""

    def __post_init__(self) -> None:
        numbers = ("junctions", "neighbours", "path_steps", "commit_steps", "width")
        for name in numbers:
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` must be 1 or more, got {getattr(self, name)}")
        if not self.apart_m >= 0:
            raise InputError(f"`apart_m` must be 0 or more, got {self.apart_m:g}")

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        flyable, steps = swarm.flyable, min(self.path_steps, horizon)
        here = np.ravel_multi_index(tuple(swarm.cells.T), flyable.shape)
        near = np.zeros(flyable.shape, dtype=bool)
        for cell in swarm.cells[swarm.flying]:
            near |= distances_within(flyable, cell, steps) > 0
        free = np.setdiff1d(np.flatnonzero(near), here)
        drawn = rng.choice(free, min(self.junctions, len(free)), replace=False)
        where, first = np.unique(here, return_inverse=True)
        road_map = RoadMap.joined(flyable, np.concatenate([where, drawn]), self.neighbours)
        cells, spacing_m = belief.scenario.grid.cells, belief.scenario.grid.spacing_m
        worth = np.where(flyable, belief.posterior().std_db, 0.0).astype(np.float64)
        routes: list[Cells] = []
        for uav in range(swarm.n_uavs):
            way = np.empty(0, dtype=np.int64)
            if swarm.flying[uav]:
                way = road_map.best_path(int(first[uav]), worth.ravel(), steps, self.width)
            routes.append(cells[np.concatenate([here[uav : uav + 1], way])].astype(np.int64))
            if self.apart_m and len(way):
                given = np.ones(flyable.shape, dtype=bool)
                given.ravel()[way] = False
                away_m = ndimage.distance_transform_edt(given) * spacing_m
                worth *= np.minimum(away_m / self.apart_m, 1.0)
        reached = min((len(r) - 1 for r in routes if len(r) > 1), default=1)
        commit = max(1, min(reached, self.commit_steps, horizon))
        return Plan(followed(swarm, routes, min(horizon, self.commit_steps)), commit)
