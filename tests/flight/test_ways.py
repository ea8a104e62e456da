from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from skygain.flight.moves import MOVES
from skygain.flight.ways import breadth_first, steps_between


def _free(rng, shape=(13, 17)):
    return rng.random(shape) > 0.3


def _edges(free):
    """Adjacency of the free cells, for an independent search."""
    cells = np.argwhere(free)
    near = cells[:, None] + MOVES
    inside = ((near >= 0) & (near < free.shape)).all(axis=-1)
    near = np.where(inside[..., None], near, 0)
    open_ = inside & free[near[..., 0], near[..., 1]]
    at, _ = np.nonzero(open_)
    here = cells @ (free.shape[1], 1)
    there = near[open_] @ (free.shape[1], 1)
    return coo_matrix((np.ones(len(at)), (here[at], there)), shape=(free.size, free.size))


def test_steps_are_those_of_another_library(rng):
    for _ in range(5):
        free = _free(rng)
        start = tuple(np.argwhere(free)[rng.integers(free.sum())])
        other = dijkstra(_edges(free), indices=np.ravel_multi_index(start, free.shape))
        steps = steps_between(free, start)
        assert np.array_equal(steps.ravel(), np.where(np.isfinite(other), other, -1))


def test_ways_lead_back_one_step_at_a_time(rng):
    free = _free(rng)
    sources = np.flatnonzero(free)[[0, 40, 0, 80]]
    steps, before = np.full(free.size, -1), np.full(free.size, -9)
    queue = np.full(free.size, -9)
    reached = breadth_first(free, sources, -1, steps, before, queue)
    assert sorted(queue[:reached]) == np.flatnonzero(steps >= 0).tolist()
    assert (np.diff(steps[queue[:reached]]) >= 0).all()
    for cell in queue[:reached]:
        if steps[cell] == 0:
            assert cell in sources
            assert before[cell] == cell
        else:
            assert steps[before[cell]] == steps[cell] - 1
            rows, cols = np.unravel_index([cell, before[cell]], free.shape)
            assert abs(rows[0] - rows[1]) + abs(cols[0] - cols[1]) == 1


def test_a_search_may_end_at_its_goal(rng):
    free = np.ones((40, 40), dtype=bool)
    steps, before = np.full(free.size, -1), np.empty(0, dtype=np.int64)
    queue = np.empty(free.size, dtype=np.int64)
    reached = breadth_first(free, np.array([0]), 2, steps, before, queue)
    assert steps[2] == 2
    assert reached < 20
