"""Problem P3 of the paper for two UAVs, written straight from its text with dense NumPy arrays: the
reference for value.

Every pair of free cells is a state, every pair of moves an action. The reward H(y_{t+1} | y_t) of
all states and actions is computed once, −∞ for illegal actions, and V(P) = max_u r(P, u) + V(T(P,
u)) is iterated over all states, whether or not the UAVs can be there. Tests import
`dense_value`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOVES = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])


def dense_value(
    flyable: NDArray[np.bool_],
    start: NDArray[np.int64],
    horizon: int,
    sill_db2: float,
    range_m: float,
    spacing_m: float,
) -> float:
    """Largest Σ H(y_{t+1} | y_t) in nats over ``horizon`` steps of two UAVs from ``start[2, (row,
    col)]``, never sharing or swapping."""
    cells = np.argwhere(flyable)
    number = np.full(flyable.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    to = cells[:, None] + MOVES  # [cell, move, row/col]
    inside = ((to >= 0) & (to < flyable.shape)).all(axis=2)
    after = np.where(
        inside, number[tuple(np.where(inside[..., None], to, 0).transpose(2, 0, 1))], -1
    )  # [cell, move]
    gap = np.hypot(*(cells[:, None] - cells[None]).transpose(2, 0, 1)) * spacing_m
    kernel = sill_db2 * np.exp(-gap / range_m)

    n = len(cells)
    first, second = (
        grid.ravel() for grid in np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    )
    reward = np.full((n * n, 4, 4), -np.inf)
    for m in range(4):
        for k in range(4):
            a, b = after[first, m], after[second, k]
            legal = (
                (a >= 0) & (b >= 0) & (a != b) & ~((a == second) & (b == first)) & (first != second)
            )
            reward[legal, m, k] = _entropy(kernel, first[legal], second[legal], a[legal], b[legal])
    value = np.zeros(n * n)
    for _ in range(horizon):
        best = np.full(n * n, -np.inf)
        for m in range(4):
            for k in range(4):
                a, b = after[first, m], after[second, k]
                ahead = np.where((a >= 0) & (b >= 0), value[a * n + b], -np.inf)
                best = np.maximum(best, reward[:, m, k] + ahead)
        value = best
    return float(value[number[tuple(start[0])] * n + number[tuple(start[1])]])


def _entropy(kernel, p, q, a, b):  # type: ignore[no-untyped-def]
    """H of the readings at cells a, b given those at p, q; a cell among p, q counts once, so it
    adds nothing."""
    old = np.stack([p, q], axis=1)
    joint = np.concatenate([old, np.stack([a, b], axis=1)], axis=1)
    gram = kernel[joint[:, :, None], joint[:, None, :]]
    held_a, held_b = a == q, b == p  # a UAV cannot stay, so only the other's cell can be met
    # a held cell is replaced by an independent one of entropy 0
    for column, held in ((2, held_a), (3, held_b)):
        gram[held, column, :] = 0.0
        gram[held, :, column] = 0.0
        gram[held, column, column] = 1.0 / (2 * np.pi * np.e)
    known = kernel[old[:, :, None], old[:, None, :]]
    scale = 2 * np.pi * np.e
    return 0.5 * (np.linalg.slogdet(scale * gram)[1] - np.linalg.slogdet(scale * known)[1])
