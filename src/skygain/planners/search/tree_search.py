"""Monte-Carlo tree search for the path of one UAV: the published rival of the beam (UCT; Kocsis and
Szepesvári, 2006).

A node is a path from the UAV's cell. Each round walks down the tree by the upper confidence bound,
adds one move, completes the path by random waypoints, and credits the path's value, as a share of
the best seen, to every node on the way. The best complete path of all rounds is flown, which for a
deterministic reward is never worse than the most visited one.
"""

from __future__ import annotations

__all__ = ["tree_path"]

import numpy as np
from numba import njit

from skygain.flight.airspace import Airspace, may_enter
from skygain.flight.moves import DCOL, DROW
from skygain.planners.search.path_gain import Reach, path_value
from skygain.planners.search.traffic import Traffic, is_clear

EXPLORATION = 0.3
"""weight of the confidence bound, for values between 0 and 1"""
STRAIGHT = 0.8
"""probability that a random completion repeats its last move"""


@njit(cache=True)
def _fits(uav, step, row, col, move, traffic, air):
    to_row, to_col = row + DROW[move], col + DCOL[move]
    if not may_enter(uav, to_row, to_col, traffic.left[uav] - step + 1, air):
        return False
    return is_clear(uav, step, row, col, to_row, to_col, traffic, air)


@njit(cache=True)
def tree_path(uav, start, horizon, draws, reach: Reach, traffic: Traffic, air: Airspace):
    """``[k + 1, (row, col)]`` best path seen and its value, after ``len(draws)`` rounds;
    ``draws[round, step, 5]`` are uniform."""
    rounds = len(draws)
    child = np.full((rounds + 1, 4), -1)
    visits = np.zeros(rounds + 1)
    credit = np.zeros(rounds + 1)
    used = 1
    trail = np.empty(horizon + 1, dtype=np.int64)
    path = np.empty((horizon + 1, 2), dtype=np.int64)
    best = np.empty((horizon + 1, 2), dtype=np.int64)
    best[0] = start
    best_length, best_value = 0, 0.0
    for r in range(rounds):
        path[0] = start
        node, step, depth, last = 0, 0, 0, -1
        trail[0] = 0
        inside = True  # still on nodes of the tree
        while step < horizon:
            row, col = path[step]
            chosen, top = -1, -1.0
            for m in range(4):
                if not _fits(uav, step + 1, row, col, m, traffic, air):
                    continue
                if not inside:
                    rank = draws[r, step, m]
                    if m == last and draws[r, step, 4] < STRAIGHT:
                        rank += 1.0
                elif child[node, m] < 0:
                    rank = 1e6 + draws[r, step, m]
                else:
                    k = child[node, m]
                    rank = credit[k] / visits[k] + EXPLORATION * np.sqrt(
                        np.log(visits[node] + 1.0) / visits[k]
                    )
                if rank > top:
                    chosen, top = m, rank
            if chosen < 0:
                break
            if inside:
                if child[node, chosen] < 0:
                    child[node, chosen] = used
                    used += 1
                    inside = False
                node = child[node, chosen]
                depth += 1
                trail[depth] = node
            step += 1
            path[step, 0], path[step, 1] = row + DROW[chosen], col + DCOL[chosen]
            last = chosen
        value = path_value(path[: step + 1], reach)
        if step > best_length or (step == best_length and value > best_value):
            best_length, best_value = step, value
            best[: step + 1] = path[: step + 1]
        for d in range(depth + 1):
            visits[trail[d]] += 1.0
            credit[trail[d]] += value / best_value if best_value > 0 else 0.0
    return best[: best_length + 1].copy(), best_value
