"""Random flights in Numba: a training batch needs hundreds of them a second.

The paths follow the protocol (a cluster start, then each UAV repeats its last move with probability
p, otherwise draws one of the legal moves; a blocked move is drawn again) and never enter an
obstacle. The evaluation's planners live elsewhere and obey the swarm's full rules; here UAVs ignore
each other, which leaves the set of measured cells all but the same.
"""

from __future__ import annotations

__all__ = ["covering_paths", "lawnmower_cells", "random_waypoints", "scattered_cells"]

import numba
import numpy as np
from numpy.typing import NDArray

from skygain.flight.moves import DCOL, DROW
from skygain.flight.ways import breadth_first

MAX_STARTS = 1000


@numba.njit(cache=True, nogil=True)
def _next(state):  # type: ignore[no-untyped-def]
    # xorshift64*: Numba's own generator is one per thread, so its draws would depend on the
    # scheduler.
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return (x * np.uint64(2685821657736338717)) >> np.uint64(11)


@numba.njit(cache=True, nogil=True)
def _seeded(seed):  # type: ignore[no-untyped-def]
    state = np.empty(1, dtype=np.uint64)
    state[0] = np.uint64(seed) | np.uint64(1)
    for _ in range(8):
        _next(state)
    return state


@numba.njit(cache=True, nogil=True)
def _uniform(state):  # type: ignore[no-untyped-def]
    return _next(state) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, nogil=True)
def _below(state, n):  # type: ignore[no-untyped-def]
    return min(int(_uniform(state) * n), n - 1)


@numba.njit(cache=True, nogil=True)
def _cluster(free, side, n_uavs, state, cells):  # type: ignore[no-untyped-def]
    rows, cols = free.shape
    side = min(side, rows, cols)
    steps, queue = np.empty(side * side, dtype=np.int64), np.empty(side * side, dtype=np.int64)
    unkept = np.empty(0, dtype=np.int64)
    for _ in range(MAX_STARTS):
        r0, c0 = _below(state, rows - side + 1), _below(state, cols - side + 1)
        r, c = _below(state, side), _below(state, side)
        if not free[r0 + r, c0 + c]:
            continue
        square = free[r0 : r0 + side, c0 : c0 + side]
        steps[:] = -1
        count = breadth_first(square, np.array([r * side + c]), -1, steps, unkept, queue)
        if count < n_uavs:
            continue
        for u in range(n_uavs):  # a partial shuffle draws without replacement
            k = u + _below(state, count - u)
            queue[u], queue[k] = queue[k], queue[u]
            cells[u, 0], cells[u, 1] = r0 + queue[u] // side, c0 + queue[u] % side
        return True
    return False


@numba.njit(cache=True, nogil=True)
def _fly(free, lengths, repeat, side, seed, paths):  # type: ignore[no-untyped-def]
    rows, cols = free.shape
    state = _seeded(seed)
    n_uavs = paths.shape[0]
    if not _cluster(free, side, n_uavs, state, paths[:, 0]):
        return False
    for u in range(n_uavs):
        r, c = paths[u, 0]
        last = -1
        for t in range(1, paths.shape[1]):
            if t <= lengths[u]:
                legal = np.zeros(4, dtype=np.bool_)
                count = 0
                for m in range(4):
                    nr, nc = r + DROW[m], c + DCOL[m]
                    if 0 <= nr < rows and 0 <= nc < cols and free[nr, nc]:
                        legal[m] = True
                        count += 1
                if count > 0:
                    if not (last >= 0 and legal[last] and _uniform(state) < repeat):
                        k = _below(state, count)
                        for m in range(4):
                            if legal[m]:
                                if k == 0:
                                    last = m
                                    break
                                k -= 1
                    r, c = r + DROW[last], c + DCOL[last]
            paths[u, t, 0], paths[u, t, 1] = r, c
    return True


def random_waypoints(
    free: NDArray[np.bool_],
    lengths: NDArray[np.int64],
    rng: np.random.Generator,
    *,
    repeat: float = 0.8,
    side: int = 10,
) -> NDArray[np.int64]:
    """``[uav, step, (row, col)]`` random flights through ``free[row, col]``; UAV u makes
    ``lengths[u]`` moves and then stays.

    ``repeat`` is the protocol's p and ``side`` the edge of the starting square in cells (40 m).
    Where no such square holds the UAVs, they start on any free cells.
    """
    lengths = np.asarray(lengths, dtype=np.int64)
    paths = np.zeros((len(lengths), int(lengths.max()) + 1, 2), dtype=np.int64)
    free = np.ascontiguousarray(free)
    while not _fly(free, lengths, float(repeat), int(side), int(rng.integers(2**63)), paths):
        side *= 2
        if side > 4 * max(free.shape):
            cells = np.argwhere(free)
            paths[:] = cells[rng.integers(len(cells), size=len(lengths))][:, None]
            break
    return paths


@numba.njit(cache=True, nogil=True)
def _cover(free, n_steps, reach, thrift, side, seed, paths):  # type: ignore[no-untyped-def]
    rows, cols = free.shape
    state = _seeded(seed)
    n_uavs = paths.shape[0]
    if not _cluster(free, side, n_uavs, state, paths[:, 0]):
        return False
    taken = np.empty(n_uavs * (n_steps + 2) + rows * cols, dtype=np.int64)
    known = 0
    for u in range(n_uavs):
        taken[known] = paths[u, 0, 0] * cols + paths[u, 0, 1]
        known += 1
    away, own = np.empty(rows * cols, dtype=np.int64), np.empty(rows * cols, dtype=np.int64)
    before, queue = np.empty(rows * cols, dtype=np.int64), np.empty(rows * cols, dtype=np.int64)
    route, left = np.empty((n_uavs, rows * cols), dtype=np.int64), np.zeros(n_uavs, dtype=np.int64)
    for t in range(1, n_steps + 1):
        for u in range(n_uavs):
            here = paths[u, t - 1, 0] * cols + paths[u, t - 1, 1]
            if left[u] == 0:
                away[:] = -1
                breadth_first(free, taken[:known], -1, away, before, queue)
                own[:] = -1
                taken[known] = here
                breadth_first(free, taken[known : known + 1], -1, own, before, queue)
                best, goal = -1e9, here
                for k in range(rows * cols):
                    if own[k] > 0 and away[k] > 0:
                        value = min(away[k], reach) - thrift * own[k] + _uniform(state)
                        if value > best:
                            best, goal = value, k
                taken[known] = goal  # nobody else need go there
                known += 1
                while goal != here:
                    route[u, left[u]] = goal
                    left[u] += 1
                    goal = before[goal]
            if left[u] > 0:
                left[u] -= 1
                here = route[u, left[u]]
                taken[known] = here
                known += 1
            paths[u, t, 0], paths[u, t, 1] = here // cols, here % cols
    return True


def covering_paths(
    free: NDArray[np.bool_], n_uavs: int, n_steps: int, rng: np.random.Generator, *, side: int = 10
) -> NDArray[np.int64]:
    """``[uav, step, (row, col)]`` flights as a planner would have them: each UAV goes the shortest
    way to where little has been measured.

    The goal maximises min(moves from the nearest measured cell or goal of another, reach) − thrift
    · moves from here; reach (4 to 16 cells) and thrift (0.05 to 0.6) are drawn. Starts as in
    `random_waypoints`.
    """
    paths = np.zeros((n_uavs, n_steps + 1, 2), dtype=np.int64)
    free = np.ascontiguousarray(free)
    reach, thrift = float(rng.uniform(4, 16)), float(rng.uniform(0.05, 0.6))
    while not _cover(free, n_steps, reach, thrift, int(side), int(rng.integers(2**63)), paths):
        side *= 2
        if side > 4 * max(free.shape):
            return random_waypoints(free, np.full(n_uavs, n_steps), rng)
    return paths


def lawnmower_cells(
    free: NDArray[np.bool_], count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """``[n, (row, col)]`` up to ``count`` free cells along parallel lines of random spacing,
    direction and starting point."""
    spacing, first = int(rng.integers(3, 17)), int(rng.integers(16))
    turned, backwards = bool(rng.integers(2)), bool(rng.integers(2))
    rows, cols = free.shape[::-1] if turned else free.shape
    lines = [
        np.arange(cols) if i % 2 == 0 else np.arange(cols)[::-1]
        for i, _ in enumerate(range(first % spacing, rows, spacing))
    ]
    cells = np.concatenate(
        [
            np.stack([np.full(cols, r), line], axis=-1)
            for r, line in zip(range(first % spacing, rows, spacing), lines, strict=True)
        ]
    )
    cells = cells[::-1] if backwards else cells
    cells = cells[:, ::-1] if turned else cells
    cells = cells[free[cells[:, 0], cells[:, 1]]]
    start = int(rng.integers(max(len(cells) - count, 0) + 1))
    return cells[start : start + count]


def scattered_cells(
    free: NDArray[np.bool_], count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """``[n, (row, col)]`` up to ``count`` distinct free cells drawn from the whole map."""
    cells = np.argwhere(free)
    return cells[rng.permutation(len(cells))[:count]]
