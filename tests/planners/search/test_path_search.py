from __future__ import annotations

import numpy as np
import pytest

from skygain.flight.airspace import Airspace
from skygain.planners.search.objectives import Objective
from skygain.planners.search.path_gain import Reach, path_value
from skygain.planners.search.path_search import beam_path, exact_path
from skygain.planners.search.traffic import Traffic

NOISE = 0.7


def open_reach(rng, side, objective, n_targets=12):
    """A random field on an open square whose cells can all be measured."""
    cells = np.stack(np.indices((side, side)), axis=-1).reshape(-1, 2)
    targets = rng.uniform(0, side, (n_targets, 2))
    both = np.concatenate([cells, targets])
    gram = 50.0 * np.exp(-np.hypot(*(both[:, None] - both[None]).transpose(2, 0, 1)) / 4.0)
    n = len(cells)
    known = gram[n:, n:] + NOISE * np.eye(n_targets)
    given = gram[:n, :n] - gram[:n, n:] @ np.linalg.solve(known, gram[n:, :n])
    number = np.arange(n, dtype=np.int32).reshape(side, side)
    arrays = (
        a.astype(np.float32) for a in (gram[:n, :n], np.ascontiguousarray(gram[:n, n:]), given)
    )
    return Reach(number, *arrays, NOISE, 1e-4, objective), gram


def alone(side, start, steps):
    air = Airspace(
        np.ones((side, side), dtype=bool), np.zeros((0, 0, 0), dtype=np.int32), True, 0.0
    )
    paths = np.repeat(np.array(start)[None, None], steps + 1, axis=1)
    return Traffic.around(
        0, paths, np.zeros(1, dtype=np.int64), np.array([steps]), air.min_cells
    ), air


def objective_of(path, gram, side, objective):
    """The objective from dense matrices."""
    cells = np.unique(path[1:] @ np.array([side, 1]))
    targets = np.arange(side * side, len(gram))
    noisy = gram[np.ix_(cells, cells)] + NOISE * np.eye(len(cells))
    cross = gram[np.ix_(cells, targets)]
    if objective == Objective.VARIANCE:
        return np.trace(cross.T @ np.linalg.solve(noisy, cross))
    if objective == Objective.ENTROPY:
        return 0.5 * np.linalg.slogdet(noisy / NOISE)[1]
    known = gram[np.ix_(targets, targets)] + NOISE * np.eye(len(targets))
    return 0.5 * (
        np.linalg.slogdet(noisy)[1]
        - np.linalg.slogdet(noisy - cross @ np.linalg.solve(known, cross.T))[1]
    )


@pytest.mark.parametrize("objective", list(Objective))
def test_values_equal_dense_algebra(rng, objective):
    reach, gram = open_reach(rng, 7, objective)
    traffic, air = alone(7, (3, 3), 6)
    for search in (
        exact_path(0, np.array([3, 3]), 6, np.arange(4), reach, traffic, air),
        beam_path(0, np.array([3, 3]), 6, 300, False, np.arange(4), reach, traffic, air),
    ):
        path, value = search
        assert len(path) == 7
        assert value == pytest.approx(objective_of(path, gram, 7, objective), rel=1e-3)
        assert value == pytest.approx(path_value(path, reach), rel=1e-5)


@pytest.mark.parametrize("objective", list(Objective))
def test_the_beam_comes_near_the_exact_search(rng, objective):
    for _ in range(5):
        reach, _ = open_reach(rng, 9, objective)
        traffic, air = alone(9, (4, 4), 7)
        _, exact = exact_path(0, np.array([4, 4]), 7, np.arange(4), reach, traffic, air)
        _, beam = beam_path(0, np.array([4, 4]), 7, 200, True, np.arange(4), reach, traffic, air)
        assert 0.93 * exact <= beam <= exact * (1 + 1e-5)


def test_a_cell_measured_twice_counts_once(rng):
    reach, _ = open_reach(rng, 5, Objective.ENTROPY)
    there_and_back = np.array([[2, 2], [2, 3], [2, 2], [2, 3]])
    assert path_value(there_and_back, reach) == pytest.approx(path_value(there_and_back[:3], reach))


@pytest.mark.parametrize("min_cells", [0.0, 3.0])
def test_traffic_leaves_out_only_uavs_that_cannot_come_near(rng, min_cells):
    """Looking out for every other UAV gives the same path."""
    side, steps, n = 25, 5, 12
    reach, _ = open_reach(rng, side, Objective.ENTROPY)
    _, air = alone(side, (12, 12), steps)
    air = air._replace(min_cells=min_cells)
    left_out = 0
    for _ in range(20):
        paths = np.repeat(rng.integers(steps, side - steps, (n, 1, 2)), steps + 1, axis=1)
        paths[1:, 1:] += np.cumsum(
            np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[rng.integers(4, size=(n - 1, steps))],
            axis=1,
        )
        known, left = np.full(n, steps), np.full(n, steps)
        near = Traffic.around(0, paths, known, left, min_cells)
        everyone = near._replace(others=np.arange(1, n))
        left_out += n - 1 - len(near.others)
        found, wanted = (
            beam_path(0, paths[0, 0], steps, 50, True, np.arange(4), reach, traffic, air)[0]
            for traffic in (near, everyone)
        )
        np.testing.assert_array_equal(found, wanted)
    assert left_out > 0
