from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.posterior import Posterior
from skygain.predictors.base import Belief
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner


def test_keeps_the_contract(field_predictor, variance_predictor):
    check_planner(
        create_planner("greedy-variance", start_steps=4, commit_steps=15), field_predictor
    )
    check_planner(create_planner("greedy-variance"), variance_predictor)


def test_starts_at_random_then_moves_away_along_the_largest_variances(field_predictor):
    free = np.ones((31, 31), dtype=bool)
    scenario = Scenario(City(Grid(free.shape, 4.0), np.zeros(free.shape, np.float32)))
    swarm = Swarm.deployed(scenario, [[15, 15]], 30)
    readings = np.array([(row, col) for row in range(0, 31, 2) for col in range(31) if col <= 18])
    belief = field_predictor.begin(scenario).updated(
        Measurements.at(readings, np.full(len(readings), -100.0))
    )
    planner = create_planner("greedy-variance", start_steps=4, commit_steps=9)
    first = planner.plan(swarm, belief, 30, np.random.default_rng(0))
    assert first.n_steps == first.commit_steps == 4
    for step in range(1, 5):
        swarm = swarm.advanced(first.paths[:, step])
    plan = planner.plan(swarm, belief, 26, np.random.default_rng(0))
    assert plan.commit_steps == 9
    distance = np.abs(plan.paths[0] - swarm.cells[0]).sum(axis=1)
    away = int(np.argmax(distance))
    assert (
        np.diff(distance[: away + 1]) == 1
    ).all()  # G*: every move leads further, until there is none
    assert plan.paths[0, 10:, 1].min() > 18  # the unknown is in the east


def test_value_iteration_finds_the_best_path_away(rng):
    variance = rng.random((9, 9)) * 100
    scenario = Scenario(City(Grid((9, 9), 4.0), np.zeros((9, 9), np.float32)))
    swarm = Swarm.deployed(scenario, [[4, 4]], 6)

    def best(cell, left):
        options = [
            (int(cell[0] + r), int(cell[1] + c))
            for r, c in ((1, 0), (-1, 0), (0, 1), (0, -1))
            if abs(cell[0] + r - 4) + abs(cell[1] + c - 4) > abs(cell[0] - 4) + abs(cell[1] - 4)
            and 0 <= cell[0] + r < 9
            and 0 <= cell[1] + c < 9
        ]
        return max((variance[o] + best(o, left - 1) for o in options), default=0.0) if left else 0.0

    class Known(Belief):
        def updated(self, measurements):
            return self

        def posterior(self):
            return Posterior(np.zeros((9, 9)), variance)

    path = create_planner("greedy-variance", start_steps=0).plan(swarm, Known(), 6, rng).paths[0]
    assert sum(variance[tuple(cell)] for cell in path[1:]) == pytest.approx(best((4, 4), 6))
