"""The best path of one UAV, given what the others will measure: a beam search that scores every
path exactly.

Let b_v be the whitened covariance of a new cell v with the target cells x, given the cells of the
path so far. Appending v to a path of k cells costs k products, because only the new row of the
growing Cholesky factor is computed; the rows before it are those of the parent. With d_v the
variance of v given the path, and σ² the noise variance of a reading, the gain of v is

- variance:            Σ_x b_v(x)², the fall of the (weighted) posterior variance summed over the
  targets;
- entropy:             ½ log(1 + d_v/σ²);
- mutual information:  ½ log((d_v + σ²)/(d_v|X + σ²)), d_v|X the variance given all targets as well.

At every depth the search keeps one survivor per cell (or per cell and last move), the best path
that ends so, and of those the best ``width``. That keeps the beam from filling up with copies of a
single path; it makes the search a dynamic programme whose rewards depend on the path. Short
horizons are searched exhaustively by `exact_path`.
"""

from __future__ import annotations

__all__ = [
    "ENTROPY",
    "MUTUAL_INFORMATION",
    "VARIANCE",
    "Reach",
    "Traffic",
    "beam_path",
    "exact_path",
    "is_clear",
    "path_value",
]

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skygain.flight.airspace import Airspace, keeps_apart, may_enter
from skygain.flight.moves import DCOL, DROW

VARIANCE, ENTROPY, MUTUAL_INFORMATION = 0, 1, 2


class Reach(NamedTuple):
    """Covariances of the cells that one UAV can measure, given everything already measured or
    planned; single precision."""

    number: NDArray[np.int32]
    """``[row, col]`` position of a cell among the m measurable cells, −1 for a cell that is passed
    without counting it"""
    among: NDArray[np.float32]
    """``[m, m]`` covariance of the measurable cells"""
    targets: NDArray[np.float32]
    """``[m, x]`` covariance of measurable and target cells, columns times the square root of the
    target's weight"""
    given_targets: NDArray[np.float32]
    """``[m, m]`` covariance of the measurable cells given the targets too, for mutual information;
    else of size 0"""
    noise_db2: float
    """σ², noise variance of a reading"""
    floor_db2: float
    """variance below which a cell counts as known: measuring it again gains nothing"""
    objective: int
    """`VARIANCE`, `ENTROPY` or `MUTUAL_INFORMATION`"""


class Traffic(NamedTuple):
    """Where the other UAVs will be."""

    paths: NDArray[np.int64]
    """``[uav, step, (row, col)]``; row ``uav`` of the planning UAV itself is not looked at"""
    known: NDArray[np.int64]
    """``[uav]`` last step up to which each path is settled; later the UAV is ignored"""
    left: NDArray[np.int64]
    """``[uav]`` moves each battery allows"""
    others: NDArray[np.int64]
    """UAVs that can come near the planning one"""

    @classmethod
    def around(
        cls,
        uav: int,
        paths: NDArray[np.int64],
        known: NDArray[np.int64],
        left: NDArray[np.int64],
        min_cells: float,
    ) -> Traffic:
        """The traffic that ``uav`` has to look out for within the steps of ``paths``; its cost does
        not grow with the swarm."""
        moves = np.abs(paths[:, 0] - paths[uav, 0]).sum(axis=1)
        near = moves <= 2 * (paths.shape[1] - 1) + np.sqrt(2.0) * min_cells
        near[uav] = False
        return cls(paths, known, left, np.flatnonzero(near))


@njit(cache=True)
def is_clear(uav, step, row, col, to_row, to_col, traffic, air):
    """Whether moving from (row, col) to (to_row, to_col) as move number ``step`` (from 1) keeps
    clear of the settled paths."""
    for other in traffic.others:
        if traffic.left[other] < step:
            continue
        if (
            traffic.known[other] == 0
        ):  # undecided: leave the cell it holds now alone, so that it can hover
            if step == 1 and not keeps_apart(
                to_row, to_col, traffic.paths[other, 0, 0], traffic.paths[other, 0, 1], air
            ):
                return False
            continue
        if traffic.known[other] < step:
            continue
        then_row, then_col = traffic.paths[other, step, 0], traffic.paths[other, step, 1]
        if not keeps_apart(to_row, to_col, then_row, then_col, air):
            return False
        now_row, now_col = traffic.paths[other, step - 1, 0], traffic.paths[other, step - 1, 1]
        swaps = then_row == row and then_col == col and now_row == to_row and now_col == to_col
        if air.separate and swaps:
            return False
    return True


@njit(cache=True, fastmath={"reassoc", "contract"})
def _gain(cell, chain, depth, row_of, rows, rows_given, maps, reach, row, row_given, image):
    """Gain of measuring ``cell`` after the ``depth`` nodes of ``chain``; fills its factor rows and
    its ``image`` on the targets.

    ``row_of[node]`` is the measurable cell of a node, ``rows[node]`` its row of the Cholesky
    factor, ``maps[node]`` its image. Returns −1 if the cell is known or on the path already.
    """
    variance = reach.among[cell, cell]
    for j in range(depth):
        if row_of[chain[j]] == cell:
            return -1.0
        value = reach.among[cell, row_of[chain[j]]]
        above = rows[chain[j]]
        for i in range(j):
            value -= row[i] * above[i]
        row[j] = value / above[j]
        variance -= row[j] * row[j]
    if variance <= reach.floor_db2:
        return -1.0
    total = variance + reach.noise_db2
    row[depth] = np.sqrt(total)
    if reach.objective == ENTROPY:
        return 0.5 * np.log(total / reach.noise_db2)
    if reach.objective == MUTUAL_INFORMATION:
        given = reach.given_targets[cell, cell]
        for j in range(depth):
            value = reach.given_targets[cell, row_of[chain[j]]]
            above = rows_given[chain[j]]
            for i in range(j):
                value -= row_given[i] * above[i]
            row_given[j] = value / above[j]
            given -= row_given[j] * row_given[j]
        given = max(given, 0.0) + reach.noise_db2
        row_given[depth] = np.sqrt(given)
        return 0.5 * np.log(total / given)
    n = reach.targets.shape[1]
    source = reach.targets[cell]
    for x in range(n):
        image[x] = source[x]
    for j in range(depth):
        weight, above = row[j], maps[chain[j]]
        for x in range(n):
            image[x] -= weight * above[x]
    scale = np.float32(1.0) / row[depth]
    gain = np.float32(0.0)
    for x in range(n):
        image[x] *= scale
        gain += image[x] * image[x]
    return float(gain)


@njit(cache=True)
def _chain_of(node, measured_parent, chain):
    """Nodes measured on the way to ``node``, earliest first, in ``chain``; returns how many."""
    depth, k = 0, node
    while k >= 0:
        depth += 1
        k = measured_parent[k]
    k = node
    for j in range(depth - 1, -1, -1):
        chain[j] = k
        k = measured_parent[k]
    return depth


@njit(cache=True)
def _gains_alone(reach: Reach):
    """``[m]`` gain of each measurable cell on its own.

    Entropy gains only shrink along a path. Variance gains nearly always do; the search may lose a
    path where they grow.
    """
    out = np.full(len(reach.among), np.inf)
    if reach.objective == MUTUAL_INFORMATION:
        return out
    for cell in range(len(out)):
        variance = reach.among[cell, cell]
        if reach.objective == ENTROPY:
            out[cell] = 0.5 * np.log(1.0 + max(variance, 0.0) / reach.noise_db2)
        else:
            image = reach.targets[cell]
            out[cell] = np.dot(image, image) / max(variance + reach.noise_db2, reach.floor_db2)
    return out


@njit(cache=True)
def beam_path(
    uav, start, horizon, width, by_move, order, reach: Reach, traffic: Traffic, air: Airspace
):
    """``[k + 1, (row, col)]`` best path found from ``start``, k <= horizon (shorter if it got
    stuck), and its value.

    ``by_move`` keeps one survivor per cell and last move instead of one per cell: better over short
    horizons, where the beam is wide enough to hold them. ``order`` is the order in which the four
    moves are tried; among equals the first wins.
    """
    side = (
        2 * horizon + 1
    )  # of the window that can be reached, in which cells are numbered row by row
    top, west = start[0] - horizon, start[1] - horizon
    split = 1 if by_move else 0
    n_targets = reach.targets.shape[1] if reach.objective == VARIANCE else 0
    most = horizon * width + 1
    at = np.empty(most, dtype=np.int64)  # cell of each node, numbered in the window
    parent = np.full(most, -1)
    last = np.full(most, -1)  # the latest measured node on the way, the node itself included
    measured_parent = np.full(most, -1)  # for measured nodes: the one measured before
    row_of = np.full(most, -1)
    value = np.zeros(most)
    factor = np.empty((most, horizon), dtype=np.float32)
    factor_given = np.empty(
        (most if reach.objective == MUTUAL_INFORMATION else 1, horizon), dtype=np.float32
    )
    maps = np.empty((most if n_targets else 1, n_targets), dtype=np.float32)
    # candidates of one layer: at most one per cell and last move
    slot = np.full(4 * side * side, -1)
    room = 4 * width
    c_at = np.empty(room, dtype=np.int64)
    c_parent = np.empty(room, dtype=np.int64)
    c_move = np.empty(room, dtype=np.int64)
    c_cell = np.empty(room, dtype=np.int64)  # measurable cell, −1 if nothing new is measured
    c_value = np.empty(room)
    c_row = np.empty((room + 1, horizon), dtype=np.float32)
    c_given = np.empty((room + 1, horizon), dtype=np.float32)
    c_map = np.empty((room + 1, n_targets), dtype=np.float32)
    place = np.arange(
        room + 1
    )  # candidate -> line of the three buffers above; the last line is scratch
    chain = np.empty(horizon, dtype=np.int64)
    alone = _gains_alone(reach)
    at[0] = horizon * side + horizon
    first, end = 0, 1
    for step in range(1, horizon + 1):
        count = 0
        for node in range(first, end):
            row, col = top + at[node] // side, west + at[node] % side
            depth = _chain_of(last[node], measured_parent, chain)
            for k in range(4):
                to_row, to_col = row + DROW[order[k]], col + DCOL[order[k]]
                if not may_enter(uav, to_row, to_col, traffic.left[uav] - step + 1, air):
                    continue
                if not is_clear(uav, step, row, col, to_row, to_col, traffic, air):
                    continue
                there, cell, gain = (
                    (to_row - top) * side + to_col - west,
                    reach.number[to_row, to_col],
                    -1.0,
                )
                mine = slot[4 * there + split * order[k]]
                if mine >= 0 and value[node] + (alone[cell] if cell >= 0 else 0.0) <= c_value[mine]:
                    continue  # it cannot win
                if cell >= 0:
                    line = place[room]
                    gain = _gain(
                        cell,
                        chain,
                        depth,
                        row_of,
                        factor,
                        factor_given,
                        maps,
                        reach,
                        c_row[line],
                        c_given[line],
                        c_map[line],
                    )
                total = value[node] + max(gain, 0.0)
                if mine < 0:
                    mine = count
                    slot[4 * there + split * order[k]] = mine
                    c_move[mine] = order[k]
                    count += 1
                elif total <= c_value[mine]:
                    continue
                c_at[mine], c_parent[mine], c_value[mine] = there, node, total
                c_cell[mine] = cell if gain >= 0 else -1
                place[mine], place[room] = place[room], place[mine]
        if count == 0:
            break
        chosen = np.argsort(-c_value[:count], kind="mergesort")[:width]
        first = end
        for c in chosen:
            node, line = end, place[c]
            at[node], parent[node], value[node] = c_at[c], c_parent[c], c_value[c]
            before = last[c_parent[c]]
            last[node] = before
            if c_cell[c] >= 0:
                last[node], measured_parent[node], row_of[node] = node, before, c_cell[c]
                factor[node] = c_row[line]
                if reach.objective == MUTUAL_INFORMATION:
                    factor_given[node] = c_given[line]
                if n_targets:
                    maps[node] = c_map[line]
            end += 1
        for c in range(count):
            slot[4 * c_at[c] + split * c_move[c]] = -1
    best = first
    for node in range(first, end):
        if value[node] > value[best]:
            best = node
    length, k = 0, best
    while parent[k] >= 0:
        length += 1
        k = parent[k]
    path = np.empty((length + 1, 2), dtype=np.int64)
    k = best
    for j in range(length, -1, -1):
        path[j, 0], path[j, 1] = top + at[k] // side, west + at[k] % side
        k = parent[k]
    return path, value[best]


@njit(cache=True)
def path_value(path, reach: Reach):
    """Objective of one path ``[k + 1, (row, col)]``, its first cell not counted."""
    n = len(path)
    n_targets = reach.targets.shape[1] if reach.objective == VARIANCE else 0
    factor = np.empty((n, n), dtype=np.float32)
    given = np.empty((n, n), dtype=np.float32)
    maps = np.empty((n, n_targets), dtype=np.float32)
    row_of, chain = np.empty(n, dtype=np.int64), np.arange(n)
    depth, total = 0, 0.0
    for k in range(1, n):
        cell = reach.number[path[k, 0], path[k, 1]]
        if cell < 0:
            continue
        gain = _gain(
            cell,
            chain,
            depth,
            row_of,
            factor,
            given,
            maps,
            reach,
            factor[depth],
            given[depth],
            maps[depth],
        )
        if gain >= 0:
            row_of[depth] = cell
            total += gain
            depth += 1
    return total


@njit(cache=True)
def exact_path(uav, start, horizon, order, reach: Reach, traffic: Traffic, air: Airspace):
    """Like `beam_path`, over all paths, depth first: up to 4·3^(horizon − 1) of them, more where
    turning back pays."""
    n_targets = reach.targets.shape[1] if reach.objective == VARIANCE else 0
    path = np.empty((horizon + 1, 2), dtype=np.int64)
    best = np.empty((horizon + 1, 2), dtype=np.int64)
    path[0] = start
    best[0] = start
    choice = np.full(horizon + 1, -1)
    values = np.zeros(horizon + 1)
    depths = np.zeros(horizon + 1, dtype=np.int64)  # measured cells up to each step
    factor = np.empty((horizon + 1, horizon + 1), dtype=np.float32)
    given = np.empty((horizon + 1, horizon + 1), dtype=np.float32)
    maps = np.empty((horizon + 1, n_targets), dtype=np.float32)
    row_of, chain = np.empty(horizon + 1, dtype=np.int64), np.arange(horizon + 1)
    best_length, best_value = 0, 0.0
    step = 0
    while step >= 0:
        choice[step] += 1
        if step == horizon or choice[step] > 3:
            if step > best_length or (step == best_length and values[step] > best_value):
                best_length, best_value = step, values[step]
                best[: step + 1] = path[: step + 1]
            choice[step] = -1
            step -= 1
            continue
        row, col = path[step]
        to_row, to_col = row + DROW[order[choice[step]]], col + DCOL[order[choice[step]]]
        if not may_enter(uav, to_row, to_col, traffic.left[uav] - step, air):
            continue
        if not is_clear(uav, step + 1, row, col, to_row, to_col, traffic, air):
            continue
        cell, gain, depth = reach.number[to_row, to_col], -1.0, depths[step]
        if cell >= 0:
            gain = _gain(
                cell,
                chain,
                depth,
                row_of,
                factor,
                given,
                maps,
                reach,
                factor[depth],
                given[depth],
                maps[depth],
            )
        step += 1
        path[step, 0], path[step, 1] = to_row, to_col
        depths[step] = depth
        if gain >= 0:
            row_of[depth] = cell
            depths[step] = depth + 1
        values[step] = values[step - 1] + max(gain, 0.0)
    return best[: best_length + 1].copy(), best_value
