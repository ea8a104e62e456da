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
from skygain.planners.search.objectives import Objective


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
    objective: Objective
    """what a path is paid for"""


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
        if traffic.known[other] == 0:
            # undecided: leave the cell it holds now alone, so that it can hover
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


class Rows(NamedTuple):
    """Measured cells with their rows of a growing Cholesky factor, one per line."""

    cell: NDArray[np.int64]
    """``[line]`` measurable cell"""
    factor: NDArray[np.float32]
    """``[line, depth]`` its row of the factor"""
    given: NDArray[np.float32]
    """``[line, depth]`` the same given the targets, for mutual information; else one line"""
    image: NDArray[np.float32]
    """``[line, x]`` its whitened covariance with the targets, for the variance; else no columns"""


class Tree(NamedTuple):
    """Paths kept by the beam: node k is the path that ends there."""

    at: NDArray[np.int64]
    """``[node]`` cell, numbered in the window that can be reached"""
    parent: NDArray[np.int64]
    """``[node]`` the path without its last cell, −1 for the start"""
    last: NDArray[np.int64]
    """``[node]`` the latest measured node on the way, the node itself included; −1 for none"""
    before: NDArray[np.int64]
    """``[node]`` for a measured node, the one measured before it"""
    value: NDArray[np.float64]
    """``[node]`` the objective so far"""
    rows: Rows
    """of the measured nodes"""


class Layer(NamedTuple):
    """Candidates for the next depth: at most one per cell, or per cell and last move."""

    slot: NDArray[np.int64]
    """``[4 * cell + move]`` the candidate that ends so, −1 for none"""
    at: NDArray[np.int64]
    """``[candidate]`` cell, numbered in the window"""
    parent: NDArray[np.int64]
    """``[candidate]`` node it continues"""
    move: NDArray[np.int64]
    """``[candidate]`` move it was first found by"""
    cell: NDArray[np.int64]
    """``[candidate]`` measurable cell, −1 if nothing new is measured"""
    value: NDArray[np.float64]
    """``[candidate]`` the objective with it"""
    line: NDArray[np.int64]
    """``[candidate]`` its line of ``rows``; the last entry is a line to work in"""
    rows: Rows
    """of the candidates"""


class Window(NamedTuple):
    """The square of cells that can be reached, numbered row by row."""

    top: int
    """row of its first cell"""
    west: int
    """column of its first cell"""
    side: int
    """cells along a side"""


@njit(cache=True)
def _rows(lines, depth, reach):
    """Room for ``lines`` rows of up to ``depth`` entries."""
    targets = reach.targets.shape[1] if reach.objective == Objective.VARIANCE else 0
    both = reach.objective == Objective.MUTUAL_INFORMATION
    return Rows(
        np.full(lines, -1),
        np.empty((lines, depth), dtype=np.float32),
        np.empty((lines if both else 1, depth), dtype=np.float32),
        np.empty((lines, targets), dtype=np.float32),
    )


@njit(cache=True, fastmath={"reassoc", "contract"})
def _gain(cell, chain, depth, rows, reach, out, line):
    """Gain of measuring ``cell`` after the ``depth`` lines ``chain`` of ``rows``; fills its own
    ``line`` of ``out``. −1 if the cell is known or on the path already."""
    row = out.factor[line]
    variance = reach.among[cell, cell]
    for j in range(depth):
        if rows.cell[chain[j]] == cell:
            return -1.0
        value = reach.among[cell, rows.cell[chain[j]]]
        above = rows.factor[chain[j]]
        for i in range(j):
            value -= row[i] * above[i]
        row[j] = value / above[j]
        variance -= row[j] * row[j]
    if variance <= reach.floor_db2:
        return -1.0
    total = variance + reach.noise_db2
    row[depth] = np.sqrt(total)
    if reach.objective == Objective.ENTROPY:
        return 0.5 * np.log(total / reach.noise_db2)
    if reach.objective == Objective.MUTUAL_INFORMATION:
        row_given = out.given[line]
        given = reach.given_targets[cell, cell]
        for j in range(depth):
            value = reach.given_targets[cell, rows.cell[chain[j]]]
            above = rows.given[chain[j]]
            for i in range(j):
                value -= row_given[i] * above[i]
            row_given[j] = value / above[j]
            given -= row_given[j] * row_given[j]
        given = max(given, 0.0) + reach.noise_db2
        row_given[depth] = np.sqrt(given)
        return 0.5 * np.log(total / given)
    image = out.image[line]
    n = reach.targets.shape[1]
    source = reach.targets[cell]
    for x in range(n):
        image[x] = source[x]
    for j in range(depth):
        weight, above = row[j], rows.image[chain[j]]
        for x in range(n):
            image[x] -= weight * above[x]
    scale = np.float32(1.0) / row[depth]
    gain = np.float32(0.0)
    for x in range(n):
        image[x] *= scale
        gain += image[x] * image[x]
    return float(gain)


@njit(cache=True)
def _copied(source, line, to, node, objective):
    """Copy one line of rows to another."""
    to.cell[node] = source.cell[line]
    to.factor[node] = source.factor[line]
    if objective == Objective.MUTUAL_INFORMATION:
        to.given[node] = source.given[line]
    if objective == Objective.VARIANCE:
        to.image[node] = source.image[line]


@njit(cache=True)
def _chain_of(node, before, chain):
    """Nodes measured on the way to the measured ``node``, earliest first, in ``chain``; returns how
    many."""
    depth, k = 0, node
    while k >= 0:
        depth += 1
        k = before[k]
    k = node
    for j in range(depth - 1, -1, -1):
        chain[j] = k
        k = before[k]
    return depth


@njit(cache=True)
def _gains_alone(reach: Reach):
    """``[m]`` gain of each measurable cell on its own.

    Entropy gains only shrink along a path. Variance gains nearly always do; the search may lose a
    path where they grow.
    """
    out = np.full(len(reach.among), np.inf)
    if reach.objective == Objective.MUTUAL_INFORMATION:
        return out
    for cell in range(len(out)):
        variance = reach.among[cell, cell]
        if reach.objective == Objective.ENTROPY:
            out[cell] = 0.5 * np.log(1.0 + max(variance, 0.0) / reach.noise_db2)
        else:
            image = reach.targets[cell]
            out[cell] = np.dot(image, image) / max(variance + reach.noise_db2, reach.floor_db2)
    return out


@njit(cache=True)
def _grow(uav, step, first, end, by_move, order, tree, layer, window, alone, reach, traffic, air):
    """Fill ``layer`` with the continuations of nodes ``first`` to ``end``; returns how many."""
    count, split, scratch = 0, 1 if by_move else 0, len(layer.line) - 1
    chain = np.empty(step, dtype=np.int64)
    for node in range(first, end):
        row = window.top + tree.at[node] // window.side
        col = window.west + tree.at[node] % window.side
        depth = _chain_of(tree.last[node], tree.before, chain)
        for move in order:
            to_row, to_col = row + DROW[move], col + DCOL[move]
            if not may_enter(uav, to_row, to_col, traffic.left[uav] - step + 1, air):
                continue
            if not is_clear(uav, step, row, col, to_row, to_col, traffic, air):
                continue
            there = (to_row - window.top) * window.side + to_col - window.west
            cell, gain = reach.number[to_row, to_col], -1.0
            mine = layer.slot[4 * there + split * move]
            if mine >= 0:
                most = tree.value[node] + (alone[cell] if cell >= 0 else 0.0)
                if most <= layer.value[mine]:
                    continue  # it cannot win
            if cell >= 0:
                line = layer.line[scratch]
                gain = _gain(cell, chain, depth, tree.rows, reach, layer.rows, line)
            total = tree.value[node] + max(gain, 0.0)
            if mine < 0:
                mine = count
                layer.slot[4 * there + split * move] = mine
                layer.move[mine] = move
                count += 1
            elif total <= layer.value[mine]:
                continue
            layer.at[mine], layer.parent[mine], layer.value[mine] = there, node, total
            layer.cell[mine] = cell if gain >= 0 else -1
            layer.line[mine], layer.line[scratch] = layer.line[scratch], layer.line[mine]
    for c in range(count):
        layer.slot[4 * layer.at[c] + split * layer.move[c]] = -1
    return count


@njit(cache=True)
def _keep(chosen, end, tree, layer, objective):
    """Add the ``chosen`` candidates to ``tree`` from node ``end`` on."""
    for k in range(len(chosen)):
        c, node = chosen[k], end + k
        tree.at[node], tree.parent[node] = layer.at[c], layer.parent[c]
        tree.value[node] = layer.value[c]
        before = tree.last[layer.parent[c]]
        tree.last[node] = before
        if layer.cell[c] >= 0:
            tree.last[node], tree.before[node] = node, before
            layer.rows.cell[layer.line[c]] = layer.cell[c]
            _copied(layer.rows, layer.line[c], tree.rows, node, objective)


@njit(cache=True)
def _path_to(node, tree, window):
    """``[k + 1, (row, col)]`` cells on the way to ``node``."""
    length, k = 0, node
    while tree.parent[k] >= 0:
        length += 1
        k = tree.parent[k]
    path = np.empty((length + 1, 2), dtype=np.int64)
    k = node
    for j in range(length, -1, -1):
        path[j, 0] = window.top + tree.at[k] // window.side
        path[j, 1] = window.west + tree.at[k] % window.side
        k = tree.parent[k]
    return path


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
    window = Window(start[0] - horizon, start[1] - horizon, 2 * horizon + 1)
    most, room = horizon * width + 1, 4 * width
    tree = Tree(
        np.empty(most, dtype=np.int64),
        np.full(most, -1),
        np.full(most, -1),
        np.full(most, -1),
        np.zeros(most),
        _rows(most, horizon, reach),
    )
    layer = Layer(
        np.full(4 * window.side * window.side, -1),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room),
        np.arange(room + 1),
        _rows(room + 1, horizon, reach),
    )
    alone = _gains_alone(reach)
    tree.at[0] = horizon * window.side + horizon
    first, end = 0, 1
    for step in range(1, horizon + 1):
        count = _grow(
            uav, step, first, end, by_move, order, tree, layer, window, alone, reach, traffic, air
        )
        if count == 0:
            break
        chosen = np.argsort(-layer.value[:count], kind="mergesort")[:width]
        _keep(chosen, end, tree, layer, reach.objective)
        first, end = end, end + len(chosen)
    best = first
    for node in range(first, end):
        if tree.value[node] > tree.value[best]:
            best = node
    return _path_to(best, tree, window), tree.value[best]


@njit(cache=True)
def path_value(path, reach: Reach):
    """Objective of one path ``[k + 1, (row, col)]``, its first cell not counted."""
    n = len(path)
    rows, chain = _rows(n, n, reach), np.arange(n)
    depth, total = 0, 0.0
    for k in range(1, n):
        cell = reach.number[path[k, 0], path[k, 1]]
        if cell < 0:
            continue
        gain = _gain(cell, chain, depth, rows, reach, rows, depth)
        if gain >= 0:
            rows.cell[depth] = cell
            total += gain
            depth += 1
    return total


@njit(cache=True)
def exact_path(uav, start, horizon, order, reach: Reach, traffic: Traffic, air: Airspace):
    """Like `beam_path`, over all paths, depth first: up to 4·3^(horizon − 1) of them, more where
    turning back pays."""
    path = np.empty((horizon + 1, 2), dtype=np.int64)
    best = np.empty((horizon + 1, 2), dtype=np.int64)
    path[0] = start
    best[0] = start
    choice = np.full(horizon + 1, -1)
    values = np.zeros(horizon + 1)
    depths = np.zeros(horizon + 1, dtype=np.int64)  # measured cells up to each step
    rows, chain = _rows(horizon + 1, horizon + 1, reach), np.arange(horizon + 1)
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
            gain = _gain(cell, chain, depth, rows, reach, rows, depth)
        step += 1
        path[step, 0], path[step, 1] = to_row, to_col
        depths[step] = depth
        if gain >= 0:
            rows.cell[depth] = cell
            depths[step] = depth + 1
        values[step] = values[step - 1] + max(gain, 0.0)
    return best[: best_length + 1].copy(), best_value
