"""Covering a city with a coordinated, legal sweep: the common part of lawnmower and spiral.

The reachable cells are split by area into one rectangle per UAV (strips, or cut in halves along the
longer side), rectangles are given to UAVs so that the total transit is least, and each UAV flies a
pattern in its rectangle as dense as its steps allow, round buildings by shortest ways. What steps
remain fill the largest gaps. Of all splits and pattern variants that one is flown whose
tracks leave the outdoor cells closest to a track: a purely geometric choice, for sweeping needs no
belief.
"""

from __future__ import annotations

__all__ = ["Pattern", "Region", "mean_gap_cells", "split_by_area", "sweep"]

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.optimize import linear_sum_assignment

from skygain.flight.airspace import followed
from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.flight.ways import breadth_first, steps_between


class Region(NamedTuple):
    """A rectangle of cells, ends excluded."""

    row: int
    row_end: int
    col: int
    col_end: int


Pattern = Callable[[Region, int, int], Cells | None]
"""``(region, density, variant) -> [k, (row, col)]`` cells to pass in order, free or not; ``None``
past the last variant"""


def split_by_area(free: NDArray[np.bool_], parts: int, how: str) -> list[Region]:
    """``parts`` rectangles with about as many free cells each: ``how`` is ``"rows"``, ``"cols"`` or
    ``"halves"``."""
    rows, cols = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    return _split(
        free, Region(int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1), parts, how
    )


def _split(free: NDArray[np.bool_], region: Region, parts: int, how: str) -> list[Region]:
    if parts == 1:
        return [region]
    row, row_end, col, col_end = region
    by_rows = how == "rows" or (how == "halves" and row_end - row >= col_end - col)
    first = parts // 2
    area = np.cumsum(free[row:row_end, col:col_end].sum(axis=1 if by_rows else 0))
    length = len(area)
    cut = int(np.searchsorted(area, area[-1] * first / parts)) + 1
    cut = min(max(cut, 1), max(length - 1, 1))
    if by_rows:
        one, other = (
            Region(row, row + cut, col, col_end),
            Region(min(row + cut, row_end - 1), row_end, col, col_end),
        )
    else:
        one, other = (
            Region(row, row_end, col, col + cut),
            Region(row, row_end, min(col + cut, col_end - 1), col_end),
        )
    return _split(free, one, first, how) + _split(free, other, parts - first, how)


@njit(cache=True)
def _way(flyable, start, goal, steps, came, queue, out, length):
    """Append the cells of a shortest way between raveled cells to ``out`` from ``length`` on;
    returns the new length.

    ``steps`` and ``queue`` are the search's buffers; ``steps`` is −1 everywhere, before and after.
    """
    cols = flyable.shape[1]
    # searched from the goal, so that the way reads forwards
    reached = breadth_first(flyable, np.array([goal]), start, steps, came, queue)
    if steps[start] >= 0:
        here = start
        while here != goal and length < len(out):
            here = came[here]
            out[length, 0], out[length, 1] = here // cols, here % cols
            length += 1
    for k in range(reached):
        steps[queue[k]] = -1
    return length


@njit(cache=True)
def _route(flyable, reachable, start, passing, limit):
    """Cells of the way from ``start`` past all reachable ``passing`` cells, ``start`` first, cut
    off after ``limit`` moves."""
    out = np.empty((limit + 1, 2), dtype=np.int64)
    out[0] = start
    length = 1
    cols = flyable.shape[1]
    steps = np.full(flyable.size, -1, dtype=np.int64)
    came = np.empty(flyable.size, dtype=np.int64)
    queue = np.empty(flyable.size, dtype=np.int64)
    for k in range(len(passing)):
        row, col = passing[k]
        at_row, at_col = out[length - 1]
        if length > limit:
            break
        if not reachable[row, col] or (row == at_row and col == at_col):
            continue
        here, goal = at_row * cols + at_col, row * cols + col
        length = _way(flyable, here, goal, steps, came, queue, out, length)
    return out[:length]


def mean_gap_cells(free: NDArray[np.bool_], covered: NDArray[np.bool_]) -> float:
    """Mean distance in cells from a free cell to the nearest covered one."""
    return float(np.mean(distance_transform_edt(~covered)[free]))


def _fill_gaps(flyable, reachable, covered, route, limit):  # type: ignore[no-untyped-def]
    """Extend ``route`` to ``limit`` moves, each time to the reachable cell farthest from all
    ``covered`` ones (updated)."""
    covered[route[:, 0], route[:, 1]] = True
    while len(route) <= limit:
        gap = np.where(reachable, distance_transform_edt(~covered), 0.0)
        if gap.max() <= 0:
            break
        goal = np.array(np.unravel_index(int(gap.argmax()), gap.shape))
        more = _route(flyable, reachable, route[-1], goal[None], limit + 1 - len(route))[1:]
        route = np.concatenate([route, more])
        covered[more[:, 0], more[:, 1]] = True
    return route


def _tracks(
    swarm: Swarm,
    reachable: NDArray[np.bool_],
    regions: list[Region],
    pattern: Pattern,
    limits: NDArray[np.int64],
) -> Iterator[list[Cells]]:
    """Candidate routes for the whole swarm: every pattern variant, as dense as fits and one denser,
    cut off."""
    transit = np.empty((swarm.n_uavs, len(regions)))
    for u in range(swarm.n_uavs):
        field = np.where(
            reachable[u], steps_between(swarm.flyable, swarm.cells[u]), swarm.flyable.size
        )
        for g, (row, row_end, col, col_end) in enumerate(regions):
            transit[u, g] = field[row:row_end, col:col_end].min()
    owner = linear_sum_assignment(transit)[1]
    variant = 0
    while pattern(regions[0], 1, variant) is not None:
        fitting, denser = [], []
        for u, limit in enumerate(limits):
            options = []
            for density in range(1, 200):
                passing = pattern(regions[owner[u]], density, variant)
                options.append(
                    _route(swarm.flyable, reachable[u], swarm.cells[u], passing, int(limit))
                )
                if len(options[-1]) > limit or (
                    density > 1 and np.array_equal(options[-1], options[-2])
                ):
                    break
            denser.append(options[-1])
            fitting.append(options[-2] if len(options) > 1 else options[-1])
        yield fitting
        yield denser
        variant += 1


def sweep(swarm: Swarm, pattern: Pattern, horizon: int) -> Cells:
    """``[uav, horizon + 1, (row, col)]`` legal paths of the best coordinated sweep of ``horizon``
    steps."""
    limits = np.minimum(horizon, swarm.steps_left)
    reachable = np.stack([steps_between(swarm.flyable, cell) >= 0 for cell in swarm.cells])
    anywhere = np.asarray(reachable.any(axis=0))
    best: tuple[float, list[Cells]] | None = None
    for how in ("rows", "cols", "halves") if swarm.n_uavs > 1 else ("rows",):
        for routes in _tracks(
            swarm, reachable, split_by_area(anywhere, swarm.n_uavs, how), pattern, limits
        ):
            covered = swarm.visited.copy()
            for route in routes:
                covered[route[:, 0], route[:, 1]] = True
            gap = mean_gap_cells(anywhere, covered)
            if best is None or gap < best[0]:
                best = gap, routes
    assert best is not None
    covered = swarm.visited.copy()
    for route in best[1]:
        covered[route[:, 0], route[:, 1]] = True
    routes = [
        _fill_gaps(swarm.flyable, reachable[u], covered, route, int(limits[u]))
        for u, route in enumerate(best[1])
    ]
    return followed(swarm, routes, horizon)
