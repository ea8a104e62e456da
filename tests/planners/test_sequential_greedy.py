from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
import pytest

from skygain.city import City
from skygain.fields.planning import planning_field
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.planners.search.certificate import information
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner

OBJECTIVES = ["variance", "entropy", "mutual-information"]


def setting(field_predictor, free, cells, steps, measured=()):
    free = np.asarray(free, dtype=bool)
    scenario = Scenario(City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32)))
    swarm = Swarm.deployed(scenario, cells, steps)
    cells = np.concatenate([swarm.cells, np.array(measured, dtype=np.int64).reshape(-1, 2)])
    return swarm, field_predictor.begin(scenario).updated(
        Measurements.at(cells, np.full(len(cells), -100.0))
    )


def joint_paths(swarm, steps):
    """All legal joint paths ``[uav, steps + 1, 2]``, hovering left out."""
    moves = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    stack = [swarm]
    while stack:
        now = stack.pop()
        if now.steps_flown == steps:
            yield now.history
            continue
        for choice in itertools.product(moves, repeat=now.n_uavs):
            try:
                stack.append(now.advanced(now.cells + np.array(choice)))
            except ValueError:
                continue


@lru_cache(maxsize=8)
def conditioned(belief):
    return planning_field(belief).conditioned()


def plan_information(belief, paths, noise_db2=1.0):
    cells = np.unique(paths[:, 1:].reshape(-1, 2), axis=0)
    return information(conditioned(belief), cells, noise_db2)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_keeps_the_contract(objective, field_predictor, variance_predictor):
    options = {
        "objective": objective,
        "horizon": 9,
        "commit_steps": 6,
        "width": 30,
        "most_targets": 60,
    }
    check_planner(create_planner("sequential-greedy", **options), field_predictor)
    if objective == "variance":
        check_planner(create_planner("sequential-greedy", **options), variance_predictor)
        check_planner(create_planner("independent-greedy", **options, stride=2), field_predictor)
        check_planner(create_planner("mcts", **options | {"tree_rounds": 40}), field_predictor)


def test_no_plan_beats_its_certificate(field_predictor, rng):
    # the bound must hold for the best joint path of all, found by exhaustion
    for trial in range(2):
        free = rng.random((6, 6)) > 0.15
        free[2:4, 1:4] = True
        swarm, belief = setting(field_predictor, free, [[2, 1], [3, 3]], 3, [[0, 0], [5, 5]])
        plan = create_planner("sequential-greedy", objective="entropy").plan(
            swarm, belief, 3, np.random.default_rng(trial)
        )
        best = max(plan_information(belief, paths) for paths in joint_paths(swarm, 3))
        assert plan.certificate.value_nats == pytest.approx(
            plan_information(belief, plan.paths), abs=1e-6
        )
        assert plan.certificate.value_nats <= best + 1e-9
        assert best <= plan.certificate.upper_bound_nats + 1e-9
        assert plan.certificate.random_nats < plan.certificate.value_nats
        assert plan.certificate.value_nats >= 0.999 * best


def test_one_uav_on_a_short_horizon_is_exact(field_predictor, rng):
    swarm, belief = setting(field_predictor, np.ones((9, 9)), [[4, 4]], 5, [[4, 7], [7, 4], [2, 2]])
    best = max(plan_information(belief, paths) for paths in joint_paths(swarm, 5))
    for options in ({"exact_horizon": 6}, {"exact_horizon": 0, "width": 500}):
        plan = create_planner("sequential-greedy", objective="entropy", **options).plan(
            swarm, belief, 5, rng
        )
        assert plan_information(belief, plan.paths) == pytest.approx(best, rel=2e-3)


def test_tree_search_finds_the_best_short_path(field_predictor, rng):
    swarm, belief = setting(field_predictor, np.ones((9, 9)), [[4, 4]], 3, [[4, 7], [7, 4], [2, 2]])
    best = max(plan_information(belief, paths) for paths in joint_paths(swarm, 3))
    plan = create_planner("mcts", objective="entropy", tree_rounds=600).plan(swarm, belief, 3, rng)
    assert plan_information(belief, plan.paths) == pytest.approx(best, rel=1e-6)


def test_uavs_share_the_work(field_predictor):
    # the west is known, so two UAVs that plan alone chase the same cells in the east; planned
    # together they part
    west = [(row, col) for row in range(0, 25, 2) for col in range(0, 11, 2)]
    together, alone = [], []
    for seed in range(4):
        swarm, belief = setting(field_predictor, np.ones((25, 25)), [[12, 11], [13, 11]], 14, west)
        for name, values in (("sequential-greedy", together), ("independent-greedy", alone)):
            plan = create_planner(name, objective="entropy", horizon=14).plan(
                swarm, belief, 14, np.random.default_rng(seed)
            )
            values.append(plan_information(belief, plan.paths))
    assert min(together) > max(alone)


def test_uses_exactly_the_posterior_covariance(field_predictor, rng):
    _swarm, belief = setting(
        field_predictor, np.ones((8, 8)), [[1, 1]], 5, [[3, 3], [5, 2], [2, 6]]
    )
    cells = np.argwhere(np.ones((8, 8)))
    ours = planning_field(belief).conditioned().covariance(cells, cells)
    np.testing.assert_allclose(ours, belief.posterior().covariance(cells), atol=0.01)


def test_bad_settings_are_input_errors():
    for options in ({"objective": "luck"}, {"horizon": 0}, {"stride": 3}, {"noise_db2": 0.0}):
        with pytest.raises(InputError):
            create_planner("sequential-greedy", **options)
