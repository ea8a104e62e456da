from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.planners import create_planner
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner


def open_swarm(side, cells, steps):
    scenario = Scenario(City(Grid((side, side), 4.0), np.zeros((side, side), np.float32)))
    return Swarm.deployed(scenario, cells, steps)


def test_keeps_the_contract(variance_predictor):
    check_planner(create_planner("random-waypoint"), variance_predictor)


def test_repeats_the_last_move_four_times_in_five(rng):
    # far from the rim a move repeats with probability p + (1 − p)/4 = 0.85
    paths = (
        create_planner("random-waypoint")
        .plan(open_swarm(4001, [[2000, 2000]], 20_000), None, 20_000, rng)
        .paths
    )
    moves = np.diff(paths[0], axis=0)
    assert np.mean((moves[1:] == moves[:-1]).all(axis=1)) == pytest.approx(0.85, abs=0.01)


def test_goes_straight_on_across_plans(rng):
    swarm = open_swarm(51, [[25, 20]], 30).advanced([[25, 21]])
    planner = create_planner("random-waypoint", repeat_probability=1.0)
    assert planner.plan(swarm, None, 5, rng).paths[0].tolist() == [[25, 21 + k] for k in range(6)]


def test_a_bad_probability_is_an_input_error():
    with pytest.raises(InputError, match=r"0\.\.1"):
        create_planner("random-waypoint", repeat_probability=1.2)
