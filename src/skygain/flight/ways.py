"""Shortest ways through flyable cells: the one breadth-first search.

It is compiled. `skygain.flight.swarm` needs it only for UAVs that must return, and imports it then.
"""

from __future__ import annotations

__all__ = ["breadth_first", "distances_within", "fill_steps", "steps_between"]

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from skygain.flight.moves import DCOL, DROW, Cells


@njit(cache=True, nogil=True)
def breadth_first(flyable, sources, stop, steps, before, queue):
    """Search outwards from the raveled cells ``sources``; return how many cells were reached.

    Cells are raveled; of two cells equally far, the one reached first by the order of the moves
    comes first.

    Args:
        flyable: ``[row, col]`` cells that may be entered.
        sources: ``[k]`` where the search begins; cells may repeat.
        stop: the search ends once this cell is reached; −1 reaches all.
        steps: ``[row * col]`` −1 everywhere; becomes the fewest moves from the nearest source.
        before: ``[row * col]`` becomes the cell before each reached one on its way (a source is its
            own); of size 0 when nobody wants to know.
        queue: ``[row * col]`` becomes the reached cells in their order.
    """
    rows, cols = flyable.shape
    keep = before.size > 0
    tail = 0
    for cell in sources:
        if steps[cell] < 0:
            steps[cell] = 0
            if keep:
                before[cell] = cell
            queue[tail] = cell
            tail += 1
    head = 0
    while head < tail and (stop < 0 or steps[stop] < 0):
        here = queue[head]
        head += 1
        row, col = here // cols, here % cols
        for m in range(4):
            i, j = row + DROW[m], col + DCOL[m]
            if 0 <= i < rows and 0 <= j < cols and flyable[i, j]:
                there = i * cols + j
                if steps[there] < 0:
                    steps[there] = steps[here] + 1
                    if keep:
                        before[there] = here
                    queue[tail] = there
                    tail += 1
    return tail


@njit(cache=True, nogil=True)
def fill_steps(flyable, row, col, out, queue):
    """Fill ``out[row, col]`` with the fewest moves from (row, col), −1 where there is no way;
    return how many cells were reached.

    ``queue`` (int64, one entry per cell) holds the reached cells in breadth-first order afterwards.
    """
    out[:] = -1
    source = np.array([row * flyable.shape[1] + col])
    unkept = np.empty(0, dtype=np.int64)
    return breadth_first(flyable, source, -1, out.reshape(-1), unkept, queue)


def steps_between(flyable: NDArray[np.bool_], start: ArrayLike) -> NDArray[np.int32]:
    """``[row, col]`` fewest moves from ``start`` through flyable cells; −1 where there is no
    way."""
    row, col = (int(k) for k in np.asarray(start))
    steps = np.empty(flyable.shape, dtype=np.int32)
    fill_steps(np.ascontiguousarray(flyable), row, col, steps, np.empty(steps.size, dtype=np.int64))
    return steps


def distances_within(flyable: NDArray[np.bool_], start: Cells, steps: int) -> NDArray[np.int32]:
    """``[row, col]`` fewest moves from ``start``, −1 where ``steps`` moves do not suffice; costs
    the same on a map of any size."""
    top, west = np.maximum(start - steps, 0)
    reach = slice(top, start[0] + steps + 1), slice(west, start[1] + steps + 1)
    inside = steps_between(flyable[reach], (start[0] - top, start[1] - west))
    distance = np.full(flyable.shape, -1, dtype=np.int32)
    distance[reach] = np.where(inside <= steps, inside, -1)
    return distance
