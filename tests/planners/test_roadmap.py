from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest

from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners import create_planner
from skygain.planners.roadmap import RoadMap
from skygain.posterior import Posterior
from skygain.predictors.base import Belief
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner, planner_scenarios


class Doubt(Belief):
    """A belief with given standard deviations."""

    def __init__(self, scenario: Scenario, std_db: np.ndarray) -> None:
        self.scenario, self._std = scenario, std_db

    def updated(self, measurements):
        return self

    def posterior(self) -> Posterior:
        return Posterior(np.zeros(self._std.shape), self._std**2)


@pytest.fixture
def streets() -> np.ndarray:
    return planner_scenarios()[2].scenario.flyable


def _drawn(flyable: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return rng.choice(np.flatnonzero(flyable), count, replace=False)


def test_keeps_the_contract(field_predictor):
    check_planner(create_planner("roadmap", junctions=30), field_predictor)


def test_roads_are_shortest_ways_around_the_buildings(streets, rng):
    junctions = _drawn(streets, 12, rng)
    road_map = RoadMap.joined(streets, junctions, 3)
    grid = nx.grid_2d_graph(*streets.shape)
    grid.remove_nodes_from(map(tuple, np.argwhere(~streets).tolist()))
    assert all(len(roads) >= 3 for roads in road_map.roads)
    for start, roads in enumerate(road_map.roads):
        for end, road in roads.items():
            way = [junctions[start], *road]
            cells = [tuple(map(int, np.unravel_index(cell, streets.shape))) for cell in way]
            assert way[-1] == junctions[end]
            assert all(grid.has_edge(*pair) for pair in pairwise(cells))
            assert len(road) == nx.shortest_path_length(grid, cells[0], cells[-1])


def _every_path(road_map: RoadMap, path: list[int], moves: int, steps: int) -> Iterator[list[int]]:
    on = [
        (end, len(road))
        for end, road in road_map.roads[path[-1]].items()
        if end not in path and moves + len(road) <= steps
    ]
    if not on:
        yield path
    for end, length in on:
        yield from _every_path(road_map, [*path, end], moves + length, steps)


def test_a_wide_beam_finds_the_best_of_all_paths(streets, rng):
    road_map = RoadMap.joined(streets, _drawn(streets, 8, rng), 2)
    worth = rng.random(streets.size)

    def per_move(path: list[int]) -> float:
        roads = [road_map.roads[a][b] for a, b in pairwise(path)]
        entered = set(np.concatenate(roads).tolist()) - {int(road_map.junctions[path[0]])}
        return worth[sorted(entered)].sum() / sum(map(len, roads))

    best = max(map(per_move, (p for p in _every_path(road_map, [0], 0, 40) if len(p) > 1)))
    found = road_map.best_path(0, worth, 40, width=10_000)
    assert len(found) <= 40
    entered = sorted(set(found.tolist()) - {int(road_map.junctions[0])})
    assert worth[entered].sum() / len(found) == pytest.approx(best)
    narrow = road_map.best_path(0, worth, 40, width=1)
    entered = sorted(set(narrow.tolist()) - {int(road_map.junctions[0])})
    assert worth[entered].sum() / len(narrow) <= best + 1e-12


def test_several_uavs_share_what_is_unsure(rng):
    """Two far corners are unsure; with a stage of its own for each UAV both are flown to."""
    scenario = planner_scenarios()[1].scenario
    std = np.full(scenario.grid.shape, 0.01)
    std[:4, :4], std[-4:, -4:] = 10.0, 9.0
    middle = np.array([[7, 9], [8, 10]])
    swarm = Swarm.deployed(scenario, middle, 40)
    planner = create_planner("roadmap", junctions=150, commit_steps=40, apart_m=40.0)
    plan = planner.plan(swarm, Doubt(scenario, std), 40, rng)
    seen = [
        {bool(std[tuple(c)] == level) for c in path} for path in plan.paths for level in (10, 9)
    ]
    corners = [True in cells for cells in seen]
    assert sorted([corners[0], corners[2]]) == sorted([corners[1], corners[3]]) == [False, True]


def test_numbers_that_make_no_road_map_are_told():
    with pytest.raises(InputError, match="`junctions` must be 1 or more, got 0"):
        create_planner("roadmap", junctions=0)
    with pytest.raises(InputError, match="`apart_m` must be 0 or more"):
        create_planner("roadmap", apart_m=-1.0)
