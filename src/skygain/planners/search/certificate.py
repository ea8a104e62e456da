"""How far from optimal a plan can be: a proof for the information of a set of readings.

For the cells S of a plan, F(S) = ½ log det(I + K_SS/σ²), K the covariance given the readings so
far, is the information in nats of noisy readings there. F is monotone and submodular, so for the
best plan, whose paths are P_1 … P_N,

    F(OPT) ≤ F(S ∪ OPT) ≤ F(S) + Σᵢ F(Pᵢ | S) ≤ F(S) + Σᵢ max_P F(P | S).

The same holds with any part of S in its place. With none of it, F(OPT) ≤ Σᵢ max_P F(P), which is
the tighter one while the UAVs have room to stay out of each other's way; the certificate takes the
smaller of the two.

Each maximum is bounded by the chain rule, in which leaving out conditions can only add information:
along a path v_1, v_2, …

    F(P | S) ≤ Σ_t F(v_t | S ∪ {v_{t−1}, v_{t−2}}),

and the right-hand side is maximised exactly over all walks, by dynamic programming over the last
two cells. Walks may come back to cells left three or more steps ago and ignore the other UAVs, so
the bound holds a fortiori for legal paths. Conditioning on fewer cells of S or fewer readings, the
nearest, adds too; that keeps the bound's cost per UAV constant.
"""

from __future__ import annotations

__all__ = ["certified", "information", "walk_bound"]

from dataclasses import replace

import numpy as np
from numba import njit

from skygain.fields.planning import Conditioned, PlanningField
from skygain.flight.moves import DCOL, DROW, Cells
from skygain.flight.swarm import Swarm
from skygain.flight.ways import distances_within
from skygain.ground.errors import InputError
from skygain.planners.base import Certificate
from skygain.planners.random_waypoint import RandomWaypointPlanner

MOST_CONDITIONS = 300
"""readings, and cells of S, that a UAV's bound is conditioned on"""
CONDITION_RANGE_M = 60.0
"""how far beyond the UAV's reach they may lie"""
RANDOM_PLANS = 5
"""random-waypoint plans whose mean information is the certificate's zero"""


def information(source: Conditioned, cells: Cells, noise_db2: float) -> float:
    """F of distinct ``cells[n, (row, col)]`` in nats."""
    gram = source.covariance(cells, cells) / noise_db2
    gram[np.diag_indices_from(gram)] += 1.0
    return float(np.sum(np.log(np.diag(np.linalg.cholesky(gram)))))


def _planned(swarm: Swarm, paths: Cells) -> Cells:
    """Distinct cells that flying UAVs come to on ``paths[uav, step, (row, col)]``; a hovering UAV
    reads nothing new."""
    return np.unique(paths[swarm.flying, 1:].reshape(-1, 2), axis=0)


@njit(cache=True)
def _news(variance, noise, counts):
    return 0.5 * np.log(1.0 + max(variance, 0.0) / noise) if counts else 0.0


@njit(cache=True)
def _rewards(spot, after, among, counts, noise):
    """``[m, 4, 4]`` information of w after stepping from u in direction d to v and from there in
    direction e to w, given u and v."""
    reward = np.zeros((len(spot), 4, 4))
    for u in range(len(spot)):
        left_u = among[u, u] + noise
        for d in range(4):
            v = after[u, d]
            if v < 0:
                continue
            slope = among[v, u] / left_u
            left_v = among[v, v] + noise - slope * among[v, u]
            for e in range(4):
                w = after[v, e]
                if w < 0 or w == u:  # a cell measured two steps ago counts nothing
                    continue
                cross = among[w, v] - slope * among[w, u]
                given = among[w, w] - among[w, u] ** 2 / left_u - cross * cross / left_v
                reward[u, d, e] = _news(given, noise, counts[w])
    return reward


@njit(cache=True)
def walk_bound(start, steps, index, among, counts, noise):
    """Largest Σ_t F(v_t | v_{t−1}, v_{t−2}) over walks v_1, v_2, … of ``steps`` moves from
    ``start``.

    ``index[row, col]`` numbers the m cells that can be reached, −1 elsewhere; ``among[m, m]`` is
    their covariance given everything else; ``counts[m]`` is false for cells that are in S already.
    """
    rows, cols = index.shape
    m = len(among)
    spot = np.empty((m, 2), dtype=np.int64)
    for row in range(rows):
        for col in range(cols):
            if index[row, col] >= 0:
                spot[index[row, col], 0], spot[index[row, col], 1] = row, col
    after = np.full((m, 4), -1)
    for k in range(m):
        for d in range(4):
            row, col = spot[k, 0] + DROW[d], spot[k, 1] + DCOL[d]
            if 0 <= row < rows and 0 <= col < cols:
                after[k, d] = index[row, col]
    reward = _rewards(spot, after, among, counts, noise)
    value = np.zeros(
        (m, 4)
    )  # best sum still to come, the last step having gone from cell u in direction d
    ahead = np.zeros((m, 4))
    for _ in range(steps - 2):
        ahead[:] = value
        for u in range(m):
            for d in range(4):
                v, best = after[u, d], 0.0
                if v >= 0:
                    for e in range(4):
                        if after[v, e] >= 0:
                            best = max(best, reward[u, d, e] + ahead[v, e])
                value[u, d] = best
    total = 0.0
    for d in range(4):  # nothing is conditioned on the start, which is no part of the walk
        v = after[index[start[0], start[1]], d]
        if v < 0 or steps < 1:
            continue
        rest = 0.0
        for e in range(4):
            w = after[v, e]
            if w >= 0 and steps > 1:
                given = among[w, w] - among[w, v] ** 2 / (among[v, v] + noise)
                rest = max(rest, _news(given, noise, counts[w]) + value[v, e])
        total = max(total, _news(among[v, v], noise, counts[v]) + rest)
    return total


def _path_bound(
    swarm: Swarm, field: PlanningField, planned: Cells, uav: int, steps: int, noise_db2: float
) -> float:
    """An upper bound of F(P | ``planned``) over all paths P of ``uav``."""
    here = swarm.cells[uav]
    distance = distances_within(swarm.flyable, here, steps)
    near = (distance >= 0) & (distance <= steps)
    cells = np.argwhere(near)
    index = np.full(distance.shape, -1, dtype=np.int32)
    index[near] = np.arange(len(cells))
    taken = np.zeros(distance.shape, dtype=bool)
    taken[planned[:, 0], planned[:, 1]] = True
    local = field.near(
        here[None], MOST_CONDITIONS, steps + CONDITION_RANGE_M / field.grid.spacing_m
    )
    gap = np.sum((planned - here) ** 2, axis=1)
    close = np.argsort(gap, kind="stable")[:MOST_CONDITIONS]
    close = planned[close[gap[close] <= (steps + CONDITION_RANGE_M / field.grid.spacing_m) ** 2]]
    source = replace(
        local,
        cells=np.concatenate([local.cells, close]),
        noise_db2=np.concatenate([local.noise_db2, np.full(len(close), noise_db2)]),
    ).conditioned()
    counts = ~taken[cells[:, 0], cells[:, 1]]
    white = source.whitened(cells)
    return float(
        walk_bound(
            here, steps, index, source.covariance(cells, cells, white, white), counts, noise_db2
        )
    )


def certified(
    swarm: Swarm,
    field: PlanningField,
    paths: Cells,
    noise_db2: float,
    most_readings: int,
    rng: np.random.Generator,
) -> Certificate:
    """The certificate of ``paths[uav, step, (row, col)]`` among all legal plans of as many steps.

    K is conditioned on the ``most_readings`` readings nearest to the swarm.
    """
    steps = paths.shape[1] - 1
    field = field.near(swarm.cells, most_readings)
    source, planned = field.conditioned(), _planned(swarm, paths)
    value = information(source, planned, noise_db2)
    nothing = np.empty((0, 2), dtype=np.int64)
    given_plan, given_nothing = (
        sum(
            _path_bound(
                swarm, field, known, int(u), min(steps, int(swarm.steps_left[u])), noise_db2
            )
            for u in np.flatnonzero(swarm.flying)
        )
        for known in (planned, nothing)
    )
    try:
        random = [RandomWaypointPlanner().paths(swarm, steps, rng) for _ in range(RANDOM_PLANS)]
        at_random = float(
            np.mean([information(source, _planned(swarm, p), noise_db2) for p in random])
        )
    except InputError:  # a random walk may find no common way home where a plan does
        at_random = None
    return Certificate(
        objective=(
            f"½ log det(I + K/σ²), σ² = {noise_db2:g} dB², K given the {len(field.cells)} readings "
            "nearest the UAVs"
        ),
        value_nats=value,
        upper_bound_nats=max(
            value, min(value + given_plan, given_nothing)
        ),  # the plan itself is legal; only rounding can differ
        random_nats=at_random,
    )
