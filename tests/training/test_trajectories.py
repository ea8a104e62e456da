"""Random flights stay legal and follow their law."""

import numpy as np
import pytest

from skygain.training.trajectories import (
    covering_paths,
    lawnmower_cells,
    random_waypoints,
    scattered_cells,
)


@pytest.fixture
def free(rng):
    return rng.random((40, 40)) > 0.25


def test_every_step_is_one_cell_through_free_cells(free, rng):
    paths = random_waypoints(free, np.array([50, 80, 120]), rng)
    assert paths.shape == (3, 121, 2)
    assert free[paths[..., 0], paths[..., 1]].all()
    moves = np.abs(np.diff(paths, axis=1)).sum(-1)
    assert moves.max() == 1
    assert (moves[0, 50:] == 0).all()
    assert (moves[1, 80:] == 0).all()


def test_the_start_is_a_cluster_of_distinct_cells_in_one_square(free, rng):
    for _ in range(20):
        start = random_waypoints(free, np.array([1, 1, 1, 1]), rng)[:, 0]
        assert len({tuple(cell) for cell in start}) == 4
        assert np.ptp(start, axis=0).max() <= 9


def test_moves_are_repeated_as_often_as_asked(rng):
    open_field = np.ones((400, 400), dtype=bool)
    moves = np.diff(random_waypoints(open_field, np.full(50, 150), rng, repeat=0.8), axis=1)
    same = (moves[:, 1:] == moves[:, :-1]).all(-1).mean()
    assert abs(same - (0.8 + 0.2 / 4)) < 0.02  # a fresh draw may pick the same move again


def test_the_same_generator_flies_the_same(free):
    first, second = (
        random_waypoints(free, np.array([60, 60]), np.random.default_rng(5)) for _ in range(2)
    )
    assert np.array_equal(first, second)


def test_a_city_too_tight_for_a_cluster_still_gets_its_flights(rng):
    lone = np.zeros((30, 30), dtype=bool)
    lone[3, 3] = lone[20, 25] = True
    paths = random_waypoints(lone, np.array([10, 10, 10]), rng)
    assert lone[paths[..., 0], paths[..., 1]].all()


def test_planned_flights_are_legal_and_cover_more_than_random_ones(rng):
    free = np.ones((40, 40), dtype=bool)
    free[5:15, 8:20] = free[22:35, 25:33] = False
    ratios = []
    for _ in range(8):
        paths = covering_paths(free, 3, 120, rng)
        assert paths.shape == (3, 121, 2)
        assert free[paths[..., 0], paths[..., 1]].all()
        assert np.abs(np.diff(paths, axis=1)).sum(-1).max() == 1
        assert np.ptp(paths[:, 0], axis=0).max() <= 9
        random = random_waypoints(free, np.full(3, 120), rng)
        ratios.append(
            len(np.unique(paths.reshape(-1, 2), axis=0))
            / len(np.unique(random.reshape(-1, 2), axis=0))
        )
    assert np.mean(ratios) > 1.3
    first, second = (covering_paths(free, 2, 60, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(first, second)


def test_planned_flights_end_where_nothing_is_left_to_measure(rng):
    lane = np.zeros((12, 12), dtype=bool)
    lane[4, 2:9] = True
    paths = covering_paths(lane, 1, 40, rng, side=12)
    assert len(np.unique(paths.reshape(-1, 2), axis=0)) == 7
    assert (paths[0, -10:] == paths[0, -1]).all()


@pytest.mark.parametrize("draw", [lawnmower_cells, scattered_cells])
def test_other_surveys_measure_distinct_free_cells(draw, free, rng):
    for count in (1, 37, 500, 5000):
        cells = draw(free, count, rng)
        assert 0 < len(cells) <= count
        assert free[cells[:, 0], cells[:, 1]].all()
        assert len(np.unique(cells, axis=0)) == len(cells)
