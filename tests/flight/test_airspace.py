from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.airspace import (
    Airspace,
    followed,
    is_free_step,
    legal_moves,
    resolve_step,
)
from skygain.flight.moves import MOVES
from skygain.flight.starts import spread_start
from skygain.flight.swarm import FlightRules, Swarm
from skygain.flight.ways import distances_within, steps_between
from skygain.grid import Grid
from skygain.scenario import Scenario

RULES = [
    FlightRules(),
    FlightRules(separate=False),
    FlightRules(min_distance_m=9.0),
    FlightRules(return_to_start=True),
]


def swarm_in(free, cells, steps, rules=None):
    free = np.asarray(free, dtype=bool)
    return Swarm.deployed(
        Scenario(City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32))),
        cells,
        steps,
        rules,
    )


def random_swarms(rng, rules, n=40):
    """Crowded little maps."""
    while n:
        free = rng.random((7, 7)) > 0.25
        try:
            scenario = Scenario(
                City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32))
            )
            cells = spread_start(scenario, 4, rng)
            yield Swarm.deployed(scenario, cells, rng.integers(0, 12, 4), rules)
        except ValueError:
            continue
        n -= 1


@pytest.mark.parametrize("rules", RULES)
def test_legal_moves_are_those_of_the_swarm(rng, rules):
    for swarm in random_swarms(rng, rules):
        air, then, decided = Airspace.of(swarm), swarm.cells.copy(), np.zeros(4, dtype=bool)
        chosen = {}
        for uav in range(4):
            legal = np.zeros(4, dtype=bool)
            legal_moves(uav, swarm.cells, then, decided, swarm.steps_left, air, legal)
            expected = swarm.next_cells(uav, decided=chosen)
            assert sorted(map(tuple, (swarm.cells[uav] + MOVES[legal]).tolist())) == sorted(
                map(tuple, expected.tolist())
            )
            if len(expected):
                then[uav] = expected[rng.integers(len(expected))]
            decided[uav] = True
            if swarm.flying[uav]:
                chosen[uav] = tuple(then[uav].tolist())


@pytest.mark.parametrize("rules", RULES)
def test_resolved_steps_are_legal(rng, rules):
    for swarm in random_swarms(rng, rules):
        then = swarm.cells.copy()
        if resolve_step(
            swarm.cells, rng.random((4, 4)), swarm.steps_left, 0, Airspace.of(swarm), then
        ):
            swarm.check(np.stack([swarm.cells, then], axis=1))
            assert is_free_step(swarm.cells, then, swarm.steps_left, Airspace.of(swarm))


def test_wishes_that_fit_together_are_granted():
    # each UAV moves into the cell the next one leaves, which choosing one after another would
    # forbid
    swarm = swarm_in(np.ones((1, 6)), [[0, 0], [0, 1], [0, 2]], 5)
    east, then = np.tile([0.0, 1.0, 0.0, 0.5], (3, 1)), swarm.cells.copy()
    assert resolve_step(swarm.cells, east, swarm.steps_left, 0, Airspace.of(swarm), then)
    assert then.tolist() == [[0, 1], [0, 2], [0, 3]]


def test_routes_that_cross_are_flown_round_each_other():
    swarm = swarm_in(np.ones((3, 9)), [[1, 0], [1, 8]], 14)
    there = np.array([(1, col) for col in range(9)])
    paths = followed(swarm, [there, there[::-1]], 14)
    swarm.check(paths)
    visited = [set(map(tuple, path.tolist())) for path in paths]
    assert (1, 8) in visited[0]
    assert (1, 0) in visited[1]


def test_everyone_gets_home_from_a_narrow_start():
    # all three must end on neighbouring cells of a street, each on its own
    free = np.zeros((9, 20))
    free[4], free[:, 10] = 1, 1
    swarm = swarm_in(free, [[4, 8], [4, 9], [4, 10]], 24, FlightRules(return_to_start=True))
    routes = [np.array([(4, col) for col in range(8 + u, -1, -1)]) for u in range(3)]
    paths = followed(swarm, routes, 24)
    swarm.check(paths)
    assert (paths[:, -1] == swarm.cells).all()


def test_distances_within_a_few_steps_are_those_of_the_whole_map(rng):
    """Looking only at the window that can be reached changes nothing, at the map's edge either."""
    for _ in range(20):
        free = rng.random((15, 20)) > 0.3
        start = rng.integers([15, 20])
        free[tuple(start)] = True
        steps = int(rng.integers(1, 9))
        whole = steps_between(free, start)
        np.testing.assert_array_equal(
            distances_within(free, start, steps), np.where(whole <= steps, whole, -1)
        )
