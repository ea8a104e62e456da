from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners import create_planner
from skygain.planners.min_cost_path import FLOOR
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


def test_keeps_the_contract(field_predictor):
    check_planner(create_planner("min-cost-path"), field_predictor)


def test_the_way_is_the_one_of_least_cost(rng):
    """The same cost as networkx finds, to the cell of the largest standard deviation."""
    scenario = planner_scenarios()[2].scenario
    std = rng.uniform(1.0, 10.0, scenario.grid.shape)
    free = np.argwhere(scenario.flyable)
    start, goal = free[0], free[40]
    std[tuple(goal)] = 20.0
    swarm = Swarm.deployed(scenario, [start], 200)
    planner = create_planner("min-cost-path", commit_steps=200)
    plan = planner.plan(swarm, Doubt(scenario, std), 200, rng)
    path = plan.paths[0, : plan.commit_steps + 1]
    assert (path[-1] == goal).all()
    cost = 1.0 / (std / std[scenario.flyable].max() + FLOOR)
    graph = nx.DiGraph()
    cells = set(map(tuple, free.tolist()))
    for row, col in cells:
        for there in ((row + 1, col), (row - 1, col), (row, col + 1), (row, col - 1)):
            if there in cells:
                graph.add_edge((row, col), there, weight=cost[there])
    least = nx.dijkstra_path_length(graph, tuple(start.tolist()), tuple(goal.tolist()))
    assert np.isclose(cost[tuple(path[1:].T)].sum(), least)


def test_goals_of_several_uavs_lie_apart(rng):
    scenario = planner_scenarios()[1].scenario
    std = np.ones(scenario.grid.shape)
    std[2, 2:5], std[13, 17] = (9.0, 8.0, 7.0), 5.0
    free = np.argwhere(scenario.flyable)[:2]
    swarm = Swarm.deployed(scenario, free + np.array([7, 9]), 60)
    planner = create_planner("min-cost-path", commit_steps=60, apart_m=20.0)
    plan = planner.plan(swarm, Doubt(scenario, std), 60, rng)
    reached = [set(map(tuple, path.tolist())) for path in plan.paths]
    assert {(2, 2), (13, 17)} <= reached[0] | reached[1]
    assert not any({(2, 2), (13, 17)} <= cells for cells in reached)


def test_no_step_to_fly_is_told():
    with pytest.raises(InputError, match="`commit_steps` of 1 or more"):
        create_planner("min-cost-path", commit_steps=0)
