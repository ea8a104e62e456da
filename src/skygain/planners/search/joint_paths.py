"""Exact value iteration over the joint positions of up to three UAVs, on the reachable set only.

A UAV moves every step, so after t steps it stands on one of the cells of a diamond with the parity
of t. In the turned coordinates a = (t + Δrow + Δcol)/2 and b = (t + Δrow − Δcol)/2 that diamond is
the full square 0 ≤ a, b ≤ t, and the four moves lead to (a, b), (a+1, b), (a, b+1) and (a+1, b+1)
of the next square. The value function after t steps is therefore a dense array over ((t+1)²)^N
joint positions, with no cell in it that cannot be reached in time, and the maximum over moves is a
maximum over neighbouring entries, which compiles to vector instructions.

Rewards come from one function, `step_rewards`: the entropy of the new readings given the present
ones for all 4^N joint moves at once. With a stationary kernel they depend on relative positions
only and are tabulated; otherwise they are computed per joint position. Values are single precision,
relative to the entropy of N unrelated readings, so that they stay small; every value is kept, and
the path is read off forwards with double-precision rewards.
"""

from __future__ import annotations

__all__ = [
    "TURNED_MOVES",
    "Known",
    "Scale",
    "allowed_squares",
    "rewards_by_offset",
    "rewards_by_place",
    "room_for",
    "state_count",
    "values_by_offset",
    "values_by_place",
]

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skygain.flight.airspace import keeps_apart
from skygain.flight.moves import MOVES

TURNED_MOVES = MOVES[[2, 3, 1, 0]]
"""``[move, (row, col)]`` of the moves (0, 0), (0, 1), (1, 0), (1, 1) in turned coordinates: south,
west, east, north"""
LOG_2_PI_E = float(np.log(2 * np.pi * np.e))
NEVER = np.float32(-np.inf)


def state_count(n_uavs: int, horizon: int) -> int:
    """Joint positions whose values are kept: Σ_{t < horizon} ((t + 1)²)^N."""
    return sum((t + 1) ** (2 * n_uavs) for t in range(horizon))


class Scale(NamedTuple):
    """How entropies are counted."""

    floor_db2: float
    """variance below which a cell is known: held already, or held by another UAV; such a cell
    counts once, so adds nothing"""
    shift_nats: float
    """taken off every reward, so that values stay small"""


class Known(NamedTuple):
    """Covariances that depend on the place."""

    number: NDArray[np.int64]
    """``[row, col]`` number of each cell that can be reached, −1 elsewhere"""
    covariance: NDArray[np.float64]
    """``[k, k]`` covariance of the cells by number"""


class Room(NamedTuple):
    """Where the rewards of one joint position of n UAVs are worked out."""

    cells: NDArray[np.int64]
    """``[5n, (row, col)]`` the present cells, then the 4 next ones of UAV 0, of UAV 1, …"""
    cov: NDArray[np.float64]
    """``[5n, 5n]`` their covariance; overwritten"""
    forbidden: NDArray[np.bool_]
    """``[4n, 4n]`` pairs of next cells, of different UAVs, that break the separation rules"""
    rewards: NDArray[np.float64]
    """``[4^n]`` rewards, −∞ where forbidden; the last UAV's move runs fastest"""


@njit(cache=True)
def room_for(n):
    """Room for ``n`` UAVs."""
    return Room(
        np.empty((5 * n, 2), dtype=np.int64),
        np.empty((5 * n, 5 * n)),
        np.zeros((4 * n, 4 * n), dtype=np.bool_),
        np.empty(4**n),
    )


@njit(cache=True)
def cell_of(start, t, a, b):
    """(row, col) of turned coordinates (a, b) after ``t`` steps from ``start``."""
    return start[0] + a + b - t, start[1] + a - b


def allowed_squares(
    flyable: NDArray[np.bool_],
    start: NDArray[np.int64],
    horizon: int,
    home: NDArray[np.int32] | None,
    left: int,
) -> NDArray[np.bool_]:
    """``[step, a, b]`` whether the UAV may be there: on the map, flyable, and not too far from home
    with ``left`` moves now."""
    t, a, b = np.ogrid[: horizon + 1, : horizon + 1, : horizon + 1]
    row, col = start[0] + a + b - t, start[1] + a - b + 0 * t
    inside = (
        (a <= t)
        & (b <= t)
        & (row >= 0)
        & (row < flyable.shape[0])
        & (col >= 0)
        & (col < flyable.shape[1])
    )
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    allowed = inside & flyable[row, col]
    if home is not None:
        allowed &= home[row, col] <= left - t
    allowed[0, 0, 0] = True
    return allowed


@njit(cache=True)
def step_rewards(n, scale, room):
    """Entropy of the new readings given the present ones, for every joint move of ``n`` UAVs.

    Reads ``room.cov`` and ``room.forbidden``, and fills ``room.rewards``.
    """
    cov, forbidden, out = room.cov, room.forbidden, room.rewards
    floor, shift, size = scale.floor_db2, scale.shift_nats, 5 * n
    for k in range(n):  # eliminate the present cells one by one
        pivot = cov[k, k]
        if pivot <= floor:
            continue
        for i in range(k + 1, size):
            factor = cov[i, k] / pivot
            for j in range(i, size):
                cov[i, j] -= factor * cov[j, k]
                cov[j, i] = cov[i, j]
    for m in range(4):
        first = cov[n + m, n + m]
        news = 1 if first > floor else 0
        if n == 1:
            out[m] = 0.5 * (LOG_2_PI_E + np.log(first)) - shift if news else -shift
            continue
        for k in range(4):
            i, j = n + m, n + 4 + k
            cross = cov[i, j] / first if news else 0.0
            second = cov[j, j] - cross * cov[i, j]
            news_2 = news + 1 if second > floor else news
            log_12 = (np.log(first) if news else 0.0) + (np.log(second) if second > floor else 0.0)
            clash = forbidden[m, 4 + k]
            if n == 2:
                out[4 * m + k] = NEVER if clash else 0.5 * (news_2 * LOG_2_PI_E + log_12) - shift
                continue
            for q in range(4):
                index, h = 16 * m + 4 * k + q, n + 8 + q
                if clash or forbidden[m, 8 + q] or forbidden[4 + k, 8 + q]:
                    out[index] = NEVER
                    continue
                third = cov[h, h]
                if news:
                    third -= cov[i, h] * cov[i, h] / first
                if second > floor:
                    rest = cov[j, h] - cross * cov[i, h]
                    third -= rest * rest / second
                if third > floor:
                    out[index] = 0.5 * ((news_2 + 1) * LOG_2_PI_E + log_12 + np.log(third)) - shift
                else:
                    out[index] = 0.5 * (news_2 * LOG_2_PI_E + log_12) - shift


@njit(cache=True)
def find_forbidden(now, air, out):
    """Fill ``out[4n, 4n]`` with the pairs of next cells of UAVs at ``now[n, 2]`` that break the
    separation rules."""
    n = len(now)
    for u in range(n):
        for v in range(u + 1, n):
            for m in range(4):
                for k in range(4):
                    row, col = now[u, 0] + TURNED_MOVES[m, 0], now[u, 1] + TURNED_MOVES[m, 1]
                    other_row, other_col = (
                        now[v, 0] + TURNED_MOVES[k, 0],
                        now[v, 1] + TURNED_MOVES[k, 1],
                    )
                    clash = not keeps_apart(row, col, other_row, other_col, air)
                    there = row == now[v, 0] and col == now[v, 1]
                    back = other_row == now[u, 0] and other_col == now[u, 1]
                    clash = clash or (air.separate and there and back)
                    out[4 * u + m, 4 * v + k] = clash


@njit(cache=True)
def _find_cells(now, cells):
    """Fill ``cells[5n, 2]`` with the present cells of UAVs at ``now[n, 2]``, then the next ones of
    each."""
    n = len(now)
    for u in range(n):
        cells[u] = now[u]
        for m in range(4):
            cells[n + 4 * u + m, 0] = now[u, 0] + TURNED_MOVES[m, 0]
            cells[n + 4 * u + m, 1] = now[u, 1] + TURNED_MOVES[m, 1]


@njit(cache=True)
def rewards_by_offset(now, kernel, air, scale, room):
    """Fill ``room.rewards`` for UAVs at ``now[n, 2]`` under a stationary kernel ``kernel[|row
    offset|, |col offset|]``."""
    cells, cov = room.cells, room.cov
    _find_cells(now, cells)
    for i in range(len(cells)):
        for j in range(i + 1):
            value = kernel[abs(cells[i, 0] - cells[j, 0]), abs(cells[i, 1] - cells[j, 1])]
            cov[i, j] = value
            cov[j, i] = value
    find_forbidden(now, air, room.forbidden)
    step_rewards(len(now), scale, room)


@njit(cache=True)
def _number(cell, known):
    """Number of a cell in ``known``, −1 if it has none."""
    rows, cols = known.number.shape
    if 0 <= cell[0] < rows and 0 <= cell[1] < cols:
        return known.number[cell[0], cell[1]]
    return -1


@njit(cache=True)
def rewards_by_place(now, known, air, scale, room):
    """Fill ``room.rewards`` for UAVs at ``now[n, 2]`` under the covariances ``known``."""
    cells, cov = room.cells, room.cov
    _find_cells(now, cells)
    for i in range(len(cells)):
        here = _number(cells[i], known)
        for j in range(i + 1):
            there = _number(cells[j], known)
            value = known.covariance[here, there] if here >= 0 and there >= 0 else 0.0
            cov[i, j] = value
            cov[j, i] = value
    find_forbidden(now, air, room.forbidden)
    step_rewards(len(now), scale, room)


@njit(cache=True, fastmath={"nnan", "nsz"})
def _best_last_move(best, rewards, at, stride, ahead, side):
    """Raise ``best[side·side]``, over the last UAV's places, to the best of its four moves.

    Move (i, j) from place (a, b) earns ``rewards[2 i + j, at + a·stride + b]`` and leads to the
    value ``ahead`` at (a + i, b + j).
    """
    one, two, three, four = rewards[0], rewards[1], rewards[2], rewards[3]
    next_side = side + 1
    for a in range(side):
        first = at + a * stride
        r00, r01 = one[first : first + side], two[first : first + side]
        r10, r11 = three[first : first + side], four[first : first + side]
        near = ahead[a * next_side : (a + 1) * next_side]
        far = ahead[(a + 1) * next_side : (a + 2) * next_side]
        row = best[a * side : (a + 1) * side]
        for b in range(side):
            low = max(r00[b] + near[b], r01[b] + near[b + 1])
            high = max(r10[b] + far[b], r11[b] + far[b + 1])
            row[b] = max(row[b], max(low, high))


@njit(cache=True)
def _offset_table(start, span, kernel, air, scale):
    """Rewards by relative position, ``[place of UAV 1 (if n = 3), joint move, place of the last
    UAV]``.

    Places are the (2 span + 1)² turned offsets from UAV 0. For a single UAV there is but one row
    per move, of equal entries.
    """
    n = len(start)
    wide = 2 * span + 1
    outer = wide * wide if n == 3 else 1
    table = np.empty((outer, 4**n, wide * wide), dtype=np.float32)
    now, room = start.copy(), room_for(n)
    for o in range(outer):
        if n == 3:
            a, b = o // wide - span, o % wide - span
            now[1, 0], now[1, 1] = start[1, 0] + a + b, start[1, 1] + a - b
        for place in range(wide * wide):
            if n > 1:
                a, b = place // wide - span, place % wide - span
                now[n - 1, 0], now[n - 1, 1] = start[n - 1, 0] + a + b, start[n - 1, 1] + a - b
            rewards_by_offset(now, kernel, air, scale, room)
            for m in range(4**n):
                table[o, m, place] = room.rewards[m]
    return table


@njit(cache=True)
def _begin_of_layers(n, horizon):
    begin = np.zeros(horizon + 1, dtype=np.int64)
    for t in range(horizon):
        begin[t + 1] = begin[t] + (t + 1) ** (2 * n)
    return begin


@njit(cache=True)
def _last_rows(values, begin, masks, step, horizon, before, n):
    """Values of step ``step`` as a flat array over the last UAV's places, given the flat place
    ``before`` of the other UAVs."""
    size = (step + 1) * (step + 1)
    if step == horizon:
        return masks[n - 1, step, :size]
    first = begin[step] + before * size
    return values[first : first + size]


@njit(cache=True)
def _masks(allowed):
    """``[uav, step, place]`` 0 where allowed and −∞ elsewhere, places of a step packed to (step +
    1)²."""
    n, steps, side, _ = allowed.shape
    masks = np.full((n, steps, side * side), NEVER, dtype=np.float32)
    for u in range(n):
        for t in range(steps):
            for a in range(t + 1):
                for b in range(t + 1):
                    if allowed[u, t, a, b]:
                        masks[u, t, a * (t + 1) + b] = 0.0
    return masks


@njit(cache=True)
def values_by_offset(start, horizon, allowed, kernel, air, scale):
    """All values under a stationary kernel: (flat values, first index of each step's layer).

    ``start[n, 2]`` are the UAVs, ``allowed[n, step, a, b]`` where they may be, ``kernel[|row
    offset|, |col offset|]`` the covariance.
    """
    n = len(start)
    begin, masks = _begin_of_layers(n, horizon), _masks(allowed)
    values = np.empty(begin[horizon], dtype=np.float32)
    span = max(horizon - 1, 0)
    table = _offset_table(start, span, kernel, air, scale)
    wide = 2 * span + 1
    best = np.empty(horizon * horizon, dtype=np.float32)
    for t in range(horizon - 1, -1, -1):
        side, next_side = t + 1, t + 2
        size, next_size = side * side, next_side * next_side
        for before in range(size ** (n - 1)):  # joint places of all UAVs but the last
            p1 = before if n < 3 else before // size
            p2 = before % size
            if (n > 1 and masks[0, t, p1] < 0) or (n > 2 and masks[1, t, p2] < 0):
                continue  # nobody reads these entries
            a1, b1 = (p1 // side, p1 % side) if n > 1 else (0, 0)
            a2, b2 = (p2 // side, p2 % side) if n > 2 else (0, 0)
            outer = (a2 - a1 + span) * wide + b2 - b1 + span if n == 3 else 0
            best[:size] = NEVER
            for m in range(4 ** (n - 1)):
                m1, m2 = (m // 4, m % 4) if n == 3 else (m, 0)
                to_1 = (a1 + m1 // 2) * next_side + b1 + m1 % 2
                to_2 = (a2 + m2 // 2) * next_side + b2 + m2 % 2
                if (n > 1 and masks[0, t + 1, to_1] < 0) or (n > 2 and masks[1, t + 1, to_2] < 0):
                    continue
                to = 0 if n == 1 else (to_1 if n == 2 else to_1 * next_size + to_2)
                ahead = _last_rows(values, begin, masks, t + 1, horizon, to, n)
                at = (span - a1) * wide + span - b1 if n > 1 else 0
                _best_last_move(
                    best, table[outer, 4 * m : 4 * m + 4], at, wide if n > 1 else side, ahead, side
                )
            first = begin[t] + before * size
            values[first : first + size] = best[:size] + masks[n - 1, t, :size]
    return values, begin


@njit(cache=True)
def values_by_place(start, horizon, allowed, known, air, scale):
    """Like `values_by_offset` under covariances that depend on the place."""
    n = len(start)
    begin, masks = _begin_of_layers(n, horizon), _masks(allowed)
    values = np.empty(begin[horizon], dtype=np.float32)
    now, room = np.empty((n, 2), dtype=np.int64), room_for(n)
    place, to = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for t in range(horizon - 1, -1, -1):
        side, next_side = t + 1, t + 2
        size, next_size = side * side, next_side * next_side
        for state in range(size**n):
            rest, fits = state, True
            for u in range(n - 1, -1, -1):
                place[u] = rest % size
                rest //= size
                fits = fits and masks[u, t, place[u]] == 0
            best = NEVER
            if fits:
                for u in range(n):
                    now[u, 0], now[u, 1] = cell_of(start[u], t, place[u] // side, place[u] % side)
                rewards_by_place(now, known, air, scale, room)
                rewards = room.rewards
                for m in range(4**n):
                    rest, index, fits = m, 0, True
                    for u in range(n - 1, -1, -1):
                        move = rest % 4
                        rest //= 4
                        to[u] = (
                            (place[u] // side + move // 2) * next_side + place[u] % side + move % 2
                        )
                        fits = fits and masks[u, t + 1, to[u]] == 0
                    if not fits or rewards[m] == NEVER:
                        continue
                    for u in range(n):
                        index = index * next_size + to[u]
                    value = np.float32(rewards[m])
                    if t + 1 < horizon:
                        value += values[begin[t + 1] + index]
                    best = max(best, value)
            values[begin[t] + state] = best
    return values, begin
