"""Flying a swarm step by step inside its rules, at compiled speed.

`skygain.flight.swarm.Swarm` says what is legal; planners ask that question hundreds of thousands of
times per plan. This module holds
the same rules in Numba and the two ways planners turn wishes into legal steps: scores per move
(`resolve_step`), and routes that ignore the other UAVs (`followed`). Both keep to one order of
decision: if all first wishes fit together they are flown; otherwise the UAVs choose one after
another, each leaving alone the cells that undecided UAVs hold, so that hovering stays possible.

Cells are assigned number by number: Numba takes a second longer to compile each assignment of a
whole row.
"""

from __future__ import annotations

__all__ = [
    "Airspace",
    "blocked_home",
    "followed",
    "home_margins",
    "is_free_step",
    "keeps_apart",
    "legal_moves",
    "may_enter",
    "resolve_step",
]

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skygain.flight.moves import DCOL, DROW, Cells
from skygain.flight.swarm import Swarm
from skygain.flight.ways import fill_steps
from skygain.ground.errors import InputError
from skygain.ground.kernels import uncounted

_SEARCH_LIMIT = (
    20_000  # joint choices tried when every UAV must still get home; met only in crowded corridors
)
# cost of a step of slack missing on the way home, above any score and fine enough to keep their
# order
_HOMESICK = 1e12
_MARGINS = (2, 4, 8, 16, 32)  # steps of slack per UAV kept for the way home, tried in this order


class Airspace(NamedTuple):
    """The rules of a swarm as plain arrays, for compiled code."""

    flyable: NDArray[np.bool_]
    """``[row, col]`` cells a UAV may enter"""
    home: NDArray[np.int32]
    """``[uav, row, col]`` moves back to the start; of size 0 when nobody has to return"""
    separate: bool
    """whether cells may neither be shared nor swapped"""
    min_cells: float
    """least distance between two flying UAVs, in cells"""

    @classmethod
    def of(cls, swarm: Swarm) -> Airspace:
        """The airspace of ``swarm``."""
        home = (
            np.zeros((0, 0, 0), dtype=np.int32)
            if swarm.home_steps is None
            else np.ascontiguousarray(swarm.home_steps)
        )
        flyable = np.ascontiguousarray(swarm.flyable).copy()
        return cls(
            flyable,
            home,
            bool(swarm.rules.separate),
            float(swarm.rules.min_distance_m / swarm.spacing_m),
        )


@uncounted()
def keeps_apart(row, col, other_row, other_col, air):
    """Whether two UAVs in these cells respect the distance rules."""
    if air.separate and row == other_row and col == other_col:
        return False
    if air.min_cells > 0:
        return np.sqrt((row - other_row) ** 2.0 + (col - other_col) ** 2.0) >= air.min_cells - 1e-9
    return True


@uncounted()
def may_enter(uav, row, col, left, air):
    """Whether obstacles, the map's edge and the way home let ``uav`` enter (row, col) with ``left``
    moves before this one."""
    rows, cols = air.flyable.shape
    if not (0 <= row < rows and 0 <= col < cols) or not air.flyable[row, col]:
        return False
    return air.home.size == 0 or air.home[uav, row, col] <= left - 1


@njit(cache=True)
def legal_moves(uav, now, then, decided, left, air, legal):
    """Set ``legal[4]`` to the moves of ``uav`` while ``decided`` UAVs go to ``then`` and others
    hold ``now``; return how many."""
    count = 0
    for m in range(4):
        legal[m] = False
        if left[uav] <= 0:
            continue
        row, col = now[uav, 0] + DROW[m], now[uav, 1] + DCOL[m]
        if not may_enter(uav, row, col, left[uav], air):
            continue
        fits = True
        for other in range(len(now)):
            if other == uav or left[other] <= 0:
                continue
            held_row, held_col = (
                (then[other, 0], then[other, 1])
                if decided[other]
                else (now[other, 0], now[other, 1])
            )
            swaps = (
                held_row == now[uav, 0]
                and held_col == now[uav, 1]
                and row == now[other, 0]
                and col == now[other, 1]
            )
            if (air.separate and swaps) or not keeps_apart(row, col, held_row, held_col, air):
                fits = False
                break
        legal[m] = fits
        count += fits
    return count


@njit(cache=True)
def is_free_step(now, then, left, air):
    """Whether no two flying UAVs share or swap cells or come too close in the step from ``now[uav,
    2]`` to ``then[uav, 2]``."""
    for a in range(len(now)):
        if left[a] <= 0:
            continue
        for b in range(a + 1, len(now)):
            if left[b] <= 0:
                continue
            if not keeps_apart(then[a, 0], then[a, 1], then[b, 0], then[b, 1], air):
                return False
            there = then[a, 0] == now[b, 0] and then[a, 1] == now[b, 1]
            back = then[b, 0] == now[a, 0] and then[b, 1] == now[a, 1]
            if air.separate and there and back:
                return False
    return True


@njit(cache=True)
def _is_boxed_in(uav, now, then, left, air):
    """Whether ``uav`` may hover: every move is blocked by obstacles, the way home, or another UAV
    before or after the step."""
    for m in range(4):
        row, col = now[uav, 0] + DROW[m], now[uav, 1] + DCOL[m]
        if not may_enter(uav, row, col, left[uav], air):
            continue
        blocked = False
        for other in range(len(now)):
            if other != uav and left[other] > 0 and (air.separate or air.min_cells > 0):
                apart_now = keeps_apart(row, col, now[other, 0], now[other, 1], air)
                if not (apart_now and keeps_apart(row, col, then[other, 0], then[other, 1], air)):
                    blocked = True
                    break
        if not blocked:
            return False
    return True


@njit(cache=True)
def _search_step(now, ranks, left, air, then):
    """Depth-first search for any legal joint step, best wishes first; used when choosing in turn
    leaves a UAV no way home."""
    n = len(now)
    choice = np.full(n, -1, dtype=np.int64)
    k, tried = 0, 0
    while k >= 0:
        if k == n:
            legal = True
            for uav in range(n):
                if (
                    left[uav] > 0
                    and choice[uav] == 4
                    and not _is_boxed_in(uav, now, then, left, air)
                ):
                    legal = False
            if legal:
                return True
            k -= 1
            continue
        tried += 1
        if tried > _SEARCH_LIMIT:
            return False
        choice[k] += 1
        if choice[k] > 4 or (left[k] <= 0 and choice[k] > 0):
            choice[k] = -1
            k -= 1
            continue
        then[k, 0], then[k, 1] = now[k, 0], now[k, 1]
        if left[k] > 0:
            if choice[k] < 4:
                then[k, 0] += DROW[ranks[k, choice[k]]]
                then[k, 1] += DCOL[ranks[k, choice[k]]]
            if not may_enter(k, then[k, 0], then[k, 1], left[k], air) or not is_free_step(
                now[: k + 1], then[: k + 1], left, air
            ):
                continue
        k += 1
    return False


@njit(cache=True)
def resolve_step(now, score, left, margin, air, then):
    """Write the next cell of every UAV to ``then``, its highest ``score[uav, 4]`` first; False if
    no legal step exists.

    ``margin`` is the slack in steps that a UAV keeps on its way home while it has the choice.
    """
    n = len(now)
    wish = score.copy()
    if air.home.size > 0:
        for uav in range(n):
            for m in range(4):
                row, col = now[uav, 0] + DROW[m], now[uav, 1] + DCOL[m]
                if may_enter(uav, row, col, left[uav], air):
                    wish[uav, m] -= _HOMESICK * max(
                        0, margin - (left[uav] - 1 - air.home[uav, row, col])
                    )
    ranks = np.empty((n, 4), dtype=np.int64)
    for uav in range(n):
        for m in range(4):  # sorted by insertion: equals keep their order
            k = m
            while k > 0 and wish[uav, ranks[uav, k - 1]] < wish[uav, m]:
                ranks[uav, k] = ranks[uav, k - 1]
                k -= 1
            ranks[uav, k] = m
        then[uav, 0], then[uav, 1] = now[uav, 0], now[uav, 1]
        if left[uav] > 0:
            for k in range(4):
                m = ranks[uav, k]
                row, col = now[uav, 0] + DROW[m], now[uav, 1] + DCOL[m]
                if may_enter(uav, row, col, left[uav], air):
                    then[uav, 0], then[uav, 1] = row, col
                    break
    # a UAV walled in on all sides hovers, which is legal as such; anyone else has a wish by now
    if is_free_step(now, then, left, air):
        homeward = True
        for uav in range(n):
            stays = then[uav, 0] == now[uav, 0] and then[uav, 1] == now[uav, 1]
            if (
                left[uav] > 0
                and stays
                and not may_enter(uav, now[uav, 0], now[uav, 1], left[uav], air)
            ):
                homeward = False
        if homeward:
            return True
    decided = np.zeros(n, dtype=np.bool_)
    legal = np.zeros(4, dtype=np.bool_)
    stranded = False
    for uav in range(n):
        then[uav, 0], then[uav, 1] = now[uav, 0], now[uav, 1]
        if legal_moves(uav, now, then, decided, left, air, legal) > 0:
            for k in range(4):
                if legal[ranks[uav, k]]:
                    then[uav, 0] += DROW[ranks[uav, k]]
                    then[uav, 1] += DCOL[ranks[uav, k]]
                    break
        elif left[uav] > 0 and not may_enter(uav, now[uav, 0], now[uav, 1], left[uav], air):
            stranded = True  # hovering would cost the way home
        decided[uav] = True
    return not stranded or _search_step(now, ranks, left, air, then)


@njit(cache=True)
def _fly_routes(start, left, horizon, route, begin, margin, air):
    """Follow ``route[begin[u]:begin[u + 1]]`` with every UAV; see `followed`. Returns the paths and
    how many steps succeeded."""
    n = len(start)
    rows, cols = air.flyable.shape
    paths = np.empty((n, horizon + 1, 2), dtype=np.int64)
    for u in range(n):
        paths[u, 0, 0], paths[u, 0, 1] = start[u, 0], start[u, 1]
    left = left.copy()
    at = begin[:-1].copy()  # index into route of the last route cell reached
    target = np.full(n, -1)  # where a UAV off its route means to rejoin it
    fields = np.empty((n, rows, cols), dtype=np.int32)
    scratch = np.empty((rows, cols), dtype=np.int32)
    queue = np.empty(rows * cols, dtype=np.int64)
    seen = np.full((rows, cols), -1, dtype=np.int64)  # step of the last visit
    now, then = start.copy(), start.copy()
    score = np.empty((n, 4))
    for step in range(horizon):
        for u in range(n):
            seen[now[u, 0], now[u, 1]] = step
            on_route = route[at[u], 0] == now[u, 0] and route[at[u], 1] == now[u, 1]
            if on_route:
                target[u] = -1
            elif target[u] < 0 and at[u] + 1 < begin[u + 1]:
                # rejoin where the least time is lost, a few cells ahead
                fill_steps(air.flyable, now[u, 0], now[u, 1], scratch, queue)
                best = 1 << 30
                for k in range(at[u] + 1, min(at[u] + 9, begin[u + 1])):
                    delay = scratch[route[k, 0], route[k, 1]] - (k - at[u])
                    if delay < best:
                        best, target[u] = delay, k
                fill_steps(air.flyable, route[target[u], 0], route[target[u], 1], fields[u], queue)
            for m in range(4):
                row, col = now[u, 0] + DROW[m], now[u, 1] + DCOL[m]
                score[u, m] = -1e9
                if not (0 <= row < rows and 0 <= col < cols):
                    continue
                if (
                    on_route
                    and at[u] + 1 < begin[u + 1]
                    and route[at[u] + 1, 0] == row
                    and route[at[u] + 1, 1] == col
                ):
                    score[u, m] = 1.0
                elif target[u] >= 0:
                    score[u, m] = -float(fields[u, row, col])
                else:
                    score[u, m] = -float(
                        seen[row, col] + 2
                    )  # off the end of the route: where nobody was for longest
        if not resolve_step(now, score, left, margin, air, then):
            return paths, step
        for u in range(n):
            for k in range(at[u] + 1, begin[u + 1] if target[u] < 0 else target[u] + 1):
                if (
                    route[k, 0] == then[u, 0]
                    and route[k, 1] == then[u, 1]
                    and (k == at[u] + 1 or k == target[u])
                ):
                    at[u], target[u] = k, -1
                    break
            paths[u, step + 1, 0], paths[u, step + 1, 1] = then[u, 0], then[u, 1]
            now[u, 0], now[u, 1] = then[u, 0], then[u, 1]
            left[u] = max(left[u] - 1, 0)
    return paths, horizon


def followed(swarm: Swarm, routes: Sequence[Cells], horizon: int) -> Cells:
    """``[uav, horizon + 1, (row, col)]`` legal paths along ``routes``, one ``[k, (row, col)]`` per
    UAV from its current cell on.

    Consecutive cells of a route are neighbours and flyable. Where another UAV or the way home is in
    the way, the UAV takes the best legal move and rejoins its route a few cells on; after the end
    of its route it goes where nobody has been for longest.

    Raises:
        InputError: UAVs that must return block each other's way home.
    """
    air = Airspace.of(swarm)
    begin = np.concatenate([[0], np.cumsum([len(r) for r in routes])]).astype(np.int64)
    cells = np.ascontiguousarray(np.concatenate(list(routes)), dtype=np.int64)
    start = np.ascontiguousarray(swarm.cells)
    for margin in home_margins(swarm):
        paths, flown = _fly_routes(start, swarm.steps_left, horizon, cells, begin, margin, air)
        if flown == horizon:
            return paths
    raise blocked_home()


def home_margins(swarm: Swarm) -> tuple[int, ...]:
    """Slacks in steps to try for the way home, smallest first; a single 0 when nobody has to return
    or nobody is in the way."""
    if swarm.home_steps is None or swarm.n_uavs == 1:
        return (0,)
    return tuple(margin * swarm.n_uavs for margin in _MARGINS)


def blocked_home() -> InputError:
    """The error for UAVs that can no longer all return to their starts."""
    return InputError(
        "the UAVs block each other's way home, so no legal step is left; start them further apart, "
        "give more `steps`, "
        "or do not ask them to return"
    )
