from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.moves import MOVES
from skygain.flight.swarm import FlightRules, Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.predictors.kriging.known_source import KrigingPredictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner


def setting(field_predictor, free, cells, steps, rules=None, measured=None):
    free = np.asarray(free, dtype=bool)
    scenario = Scenario(City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32)))
    swarm = Swarm.deployed(scenario, cells, steps, rules)
    measured = swarm.cells if measured is None else np.asarray(measured)
    return swarm, field_predictor.begin(scenario).updated(
        Measurements.at(measured, np.full(len(measured), -100.0))
    )


def step_entropy(covariance, now, then):
    """H(y_then | y_now) in nats straight from its definition; held or repeated cells count once."""
    old = [tuple(c) for c in dict.fromkeys(map(tuple, now))]
    new = [c for c in dict.fromkeys(map(tuple, then)) if c not in old]
    old = [c for c in old if covariance(np.array([c]))[0, 0] > 1e-4]
    new = [c for c in new if covariance(np.array([c]))[0, 0] > 1e-4]

    def log_det(cells):
        return (
            np.linalg.slogdet(2 * np.pi * np.e * covariance(np.array(cells)))[1] if cells else 0.0
        )

    return 0.5 * (log_det(old + new) - log_det(old))


def path_entropy(covariance, paths):
    return sum(
        step_entropy(covariance, paths[:, t], paths[:, t + 1]) for t in range(paths.shape[1] - 1)
    )


def best_by_brute_force(swarm, covariance, steps):
    """The largest P3 objective over all legal joint paths without a hover."""
    best = -np.inf
    stack = [(swarm, 0, 0.0)]
    while stack:
        now, t, value = stack.pop()
        if t == steps:
            best = max(best, value)
            continue
        for moves in itertools.product(MOVES, repeat=swarm.n_uavs):
            then = now.cells + np.array(moves)
            try:
                after = now.advanced(then)
            except ValueError:
                continue
            stack.append((after, t + 1, value + step_entropy(covariance, now.cells, then)))
    return best


WALLED = np.ones((5, 6))
WALLED[2, 1:4] = 0
CASES = [
    ([[1, 1]], 5, None),
    ([[1, 1], [1, 3]], 3, None),
    ([[0, 0], [0, 2]], 3, FlightRules(min_distance_m=8.0)),
    ([[1, 1], [1, 2]], 3, FlightRules(separate=False)),
    ([[0, 1], [1, 2], [3, 3]], 2, None),
    ([[0, 1], [1, 2]], 4, FlightRules(return_to_start=True)),
]


@pytest.mark.parametrize(("cells", "steps", "rules"), CASES)
def test_equals_brute_force_over_all_joint_paths(field_predictor, rng, cells, steps, rules):
    swarm, belief = setting(field_predictor, WALLED, cells, steps, rules)

    def prior(some):
        return belief._prior(some, some)

    plan = create_planner("entropy-vi", horizon=steps).plan(swarm, belief, steps, rng)
    assert plan.n_steps == steps
    assert path_entropy(prior, plan.paths) == pytest.approx(
        best_by_brute_force(swarm, prior, steps), abs=1e-4
    )


@pytest.mark.parametrize(("cells", "steps", "rules"), CASES[:5])
def test_conditioned_equals_brute_force_with_the_posterior(
    field_predictor, rng, cells, steps, rules
):
    measured = [*cells, [0, 4], [4, 4], [2, 5], [3, 0]]
    swarm, belief = setting(field_predictor, WALLED, cells, steps, rules, measured)
    covariance = belief.posterior().covariance
    plan = create_planner("entropy-vi-conditioned", horizon=steps).plan(swarm, belief, steps, rng)
    assert path_entropy(covariance, plan.paths) == pytest.approx(
        best_by_brute_force(swarm, covariance, steps), abs=1e-3
    )


def test_equals_the_dense_reference(rng):
    path = Path(__file__).with_name("dense_value_iteration.py")
    spec = importlib.util.spec_from_file_location("dense_value_iteration", path)
    dense = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(dense)
    free = rng.random((9, 9)) > 0.2
    start = np.argwhere(free)[[3, 9]]
    scenario = Scenario(
        City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32)),
        transmitter_m=(0.0, 0.0, 99.0),
    )
    swarm = Swarm.deployed(scenario, start, 9)
    parameters = KrigingParameters.known_trend(20.0, 60.0, sill_db2=380.0, range_m=57.0)
    belief = KrigingPredictor(parameters=parameters, refit=False).begin(scenario)
    plan = create_planner("entropy-vi").plan(swarm, belief, 9, rng)

    def prior(cells):
        gap = np.hypot(*(cells[:, None] - cells[None]).transpose(2, 0, 1)) * 4.0
        return 380.0 * np.exp(-gap / 57.0)

    assert plan.n_steps == 9
    assert path_entropy(prior, plan.paths) == pytest.approx(
        dense.dense_value(free, start, 9, 380.0, 57.0, 4.0), abs=1e-4
    )


def test_keeps_the_contract(field_predictor, variance_predictor):
    check_planner(
        create_planner("entropy-vi", horizon=5, commit_steps=4), field_predictor, max_uavs=3
    )
    check_planner(
        create_planner("entropy-vi-conditioned", horizon=3, commit_steps=3),
        variance_predictor,
        max_uavs=3,
    )


def test_equal_paths_are_drawn_by_seed(field_predictor):
    # alone in the open every path has the same entropy, so different seeds fly differently
    swarm, belief = setting(field_predictor, np.ones((9, 9)), [[4, 4]], 6)
    planner = create_planner("entropy-vi")
    paths = {
        planner.plan(swarm, belief, 6, np.random.default_rng(seed)).paths.tobytes()
        for seed in range(8)
    }
    assert len(paths) > 4


def test_more_than_three_uavs_are_refused(field_predictor, rng):
    swarm, belief = setting(field_predictor, np.ones((9, 9)), [[0, 0], [0, 2], [0, 4], [0, 6]], 6)
    with pytest.raises(InputError, match="at most 3"):
        create_planner("entropy-vi").plan(swarm, belief, 6, rng)
