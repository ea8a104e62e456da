"""Lawnmower and spiral: legal, thorough, shared between the UAVs, and blind to what is believed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.planners import create_planner
from skygain.planners.search.sweep import mean_gap_cells, split_by_area
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner

NAMES = ["lawnmower", "spiral"]


def _swarm(free, cells, steps):
    free = np.asarray(free, dtype=bool)
    city = City(Grid(free.shape, 4.0), np.where(free, 0.0, 30.0))
    return Swarm.deployed(Scenario(city), cells, steps)


def _covered(paths, shape):
    covered = np.zeros(shape, dtype=bool)
    covered[paths[..., 0], paths[..., 1]] = True
    return covered


def _paths(name, swarm, steps):
    return create_planner(name).plan(swarm, None, steps, np.random.default_rng(0)).paths


@pytest.mark.parametrize("name", NAMES)
def test_keeps_the_contract(name, variance_predictor):
    check_planner(create_planner(name), variance_predictor)


@pytest.mark.parametrize("name", NAMES)
def test_no_seed_and_no_belief_changes_a_sweep(name):
    swarm = _swarm(np.ones((15, 21)), [[0, 0], [7, 9]], 60)
    plans = [
        create_planner(name).plan(swarm, None, 60, np.random.default_rng(seed)) for seed in (0, 1)
    ]
    assert np.array_equal(plans[0].paths, plans[1].paths)
    assert plans[0].commit_steps == 60


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("starts", [[[0, 0]], [[0, 0], [11, 11]], [[5, 5], [5, 6], [6, 5]]])
def test_enough_steps_cover_an_open_map(name, starts):
    swarm = _swarm(np.ones((12, 12)), starts, 300)
    assert _covered(_paths(name, swarm, 300), (12, 12)).all()


@pytest.mark.parametrize("name", NAMES)
def test_sweeps_leave_smaller_gaps_than_random_flights(name, rng):
    free = rng.random((40, 40)) > 0.1
    free[18:23, 18:23] = True
    swarm = _swarm(free, [[20, 20], [20, 21], [21, 20]], 120)
    random = create_planner("random-waypoint")
    gaps = [
        mean_gap_cells(free, _covered(random.plan(swarm, None, 120, rng).paths, free.shape))
        for _ in range(5)
    ]
    swept = mean_gap_cells(free, _covered(_paths(name, swarm, 120), free.shape))
    assert swept < 0.6 * min(gaps)


@pytest.mark.parametrize("name", NAMES)
def test_uavs_share_the_map(name):
    swarm = _swarm(np.ones((30, 30)), [[14, 14], [14, 15], [15, 14]], 90)
    own = [_covered(path[None], (30, 30)) for path in _paths(name, swarm, 90)]
    for one, other in itertools.combinations(own, 2):
        assert (one & other).sum() < 0.4 * min(one.sum(), other.sum())


@pytest.mark.parametrize("name", NAMES)
def test_what_cannot_be_reached_is_left_alone(name):
    free = np.ones((20, 20), dtype=bool)
    free[:, 10] = False
    covered = _covered(_paths(name, _swarm(free, [[3, 3], [9, 2]], 150), 150), free.shape)
    assert not covered[:, 11:].any()
    assert covered[:, :10].mean() > 0.9


@pytest.mark.parametrize("how", ["rows", "cols", "halves"])
@pytest.mark.parametrize("parts", [1, 2, 3, 5])
def test_regions_hold_all_free_cells_in_like_shares(how, parts, rng):
    free = rng.random((40, 50)) > 0.3
    regions = split_by_area(free, parts, how)
    assert len(regions) == parts
    areas = [free[r.row : r.row_end, r.col : r.col_end].sum() for r in regions]
    assert sum(areas) == free.sum()
    assert max(areas) < 1.5 * min(areas)
