"""The best path of one UAV, given what the others will measure: a beam search that scores every
path exactly.

The gain of a cell after the cells before it is that of `path_gain`; the rows of the growing factor
are those of the parent.

At every depth the search keeps one survivor per cell (or per cell and last move), the best path
that ends so, and of those the best ``width``. That keeps the beam from filling up with copies of a
single path; it makes the search a dynamic programme whose rewards depend on the path. Short
horizons are searched exhaustively by `exact_path`.
"""

from __future__ import annotations

__all__ = ["beam_path", "exact_path"]

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skygain.flight.airspace import Airspace, may_enter
from skygain.flight.moves import DCOL, DROW
from skygain.ground.kernels import uncounted
from skygain.planners.search.path_gain import (
    Reach,
    Rows,
    copied,
    gain_of,
    gains_alone,
    rows_for,
)
from skygain.planners.search.traffic import Traffic, is_clear


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


@uncounted()
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


@uncounted()
def _grow(
    uav, step, first, end, by_move, order, chain, tree, layer, window, alone, reach, traffic, air
):
    """Fill ``layer`` with the continuations of nodes ``first`` to ``end``; returns how many."""
    count, split, scratch = 0, 1 if by_move else 0, len(layer.line) - 1
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
                gain = gain_of(cell, chain, depth, tree.rows, reach, layer.rows, line)
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


@uncounted()
def _keep(chosen, end, step, tree, layer, objective):
    """Add the ``chosen`` candidates of ``step`` to ``tree`` from node ``end`` on."""
    for k in range(len(chosen)):
        c, node = chosen[k], end + k
        tree.at[node], tree.parent[node] = layer.at[c], layer.parent[c]
        tree.value[node] = layer.value[c]
        before = tree.last[layer.parent[c]]
        tree.last[node] = before
        if layer.cell[c] >= 0:
            tree.last[node], tree.before[node] = node, before
            layer.rows.cell[layer.line[c]] = layer.cell[c]
            copied(layer.rows, layer.line[c], tree.rows, node, step, objective)


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
        rows_for(most, horizon, reach),
    )
    layer = Layer(
        np.full(4 * window.side * window.side, -1),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room),
        np.arange(room + 1),
        rows_for(room + 1, horizon, reach),
    )
    alone, chain = gains_alone(reach), np.empty(horizon, dtype=np.int64)
    tree.at[0] = horizon * window.side + horizon
    first, end = np.int64(0), np.int64(1)  # plain numbers would compile `_grow` and `_keep` twice
    for step in range(1, horizon + 1):
        count = _grow(
            uav,
            step,
            first,
            end,
            by_move,
            order,
            chain,
            tree,
            layer,
            window,
            alone,
            reach,
            traffic,
            air,
        )
        if count == 0:
            break
        chosen = np.argsort(-layer.value[:count], kind="mergesort")[:width]
        _keep(chosen, end, step, tree, layer, reach.objective)
        first, end = end, end + len(chosen)
    best = int(first)
    for node in range(first, end):
        if tree.value[node] > tree.value[best]:
            best = node
    return _path_to(best, tree, window), tree.value[best]


@njit(cache=True)
def exact_path(uav, start, horizon, order, reach: Reach, traffic: Traffic, air: Airspace):
    """Like `beam_path`, over all paths, depth first: up to 4·3^(horizon − 1) of them, more where
    turning back pays."""
    path = np.empty((horizon + 1, 2), dtype=np.int64)
    best = np.empty((horizon + 1, 2), dtype=np.int64)
    path[0, 0], path[0, 1] = start[0], start[1]
    best[0, 0], best[0, 1] = start[0], start[1]
    choice = np.full(horizon + 1, -1)
    values = np.zeros(horizon + 1)
    depths = np.zeros(horizon + 1, dtype=np.int64)  # measured cells up to each step
    rows, chain = rows_for(horizon + 1, horizon + 1, reach), np.arange(horizon + 1)
    best_length, best_value = 0, 0.0
    step = 0
    while step >= 0:
        choice[step] += 1
        if step == horizon or choice[step] > 3:
            if step > best_length or (step == best_length and values[step] > best_value):
                best_length, best_value = step, values[step]
                for k in range(step + 1):
                    best[k, 0], best[k, 1] = path[k, 0], path[k, 1]
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
            gain = gain_of(cell, chain, depth, rows, reach, rows, depth)
        step += 1
        path[step, 0], path[step, 1] = to_row, to_col
        depths[step] = depth
        if gain >= 0:
            rows.cell[depth] = cell
            depths[step] = depth + 1
        values[step] = values[step - 1] + max(gain, 0.0)
    return best[: best_length + 1].copy(), best_value
