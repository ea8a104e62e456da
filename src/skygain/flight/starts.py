"""Where a survey begins: at the UAVs' homes, or in one of the two ways of the protocol."""

from __future__ import annotations

__all__ = ["STARTS", "cluster_start", "home_cells", "spread_start", "start_cells"]

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skygain.flight.ways import steps_between
from skygain.ground.errors import InputError
from skygain.scenario import Scenario

STARTS = ("cluster", "spread")
"""names of the placements"""
_HOME_M = 10.0
"""a home may lie so far from the cell in which its UAV begins"""


def cluster_start(
    scenario: Scenario,
    n_uavs: int,
    rng: np.random.Generator,
    side_m: float = 40.0,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """``[uav, (row, col)]`` distinct random free cells of one connected part of a random square of
    ``side_m``.

    The square is drawn again, up to 1,000 times, while no connected part of it holds ``n_uavs``
    free cells, of those ``among`` if that is given.

    Raises:
        InputError: no such square was found.
    """
    rows, cols = scenario.grid.shape
    side = min(max(1, round(side_m / scenario.grid.spacing_m)), rows, cols)
    for _ in range(1000):
        row, col = int(rng.integers(rows - side + 1)), int(rng.integers(cols - side + 1))
        window = scenario.flyable[row : row + side, col : col + side]
        free = np.argwhere(window)
        if len(free) < n_uavs:
            continue
        joined = steps_between(window, free[rng.integers(len(free))]) >= 0
        if among is not None:
            joined &= among[row : row + side, col : col + side]
        part = np.argwhere(joined)
        if len(part) >= n_uavs:
            return part[rng.choice(len(part), n_uavs, replace=False)] + (row, col)
    raise InputError(
        f"found no {side_m:g} m square with {n_uavs} connected free cells, one per UAV; use fewer "
        "`uavs`, `start=spread` or fly higher (`altitude_m`)"
    )


def spread_start(
    scenario: Scenario,
    n_uavs: int,
    rng: np.random.Generator,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """``[uav, (row, col)]`` distinct random free cells of the whole map, of those ``among`` if that
    is given.

    Raises:
        InputError: there are fewer free cells than UAVs.
    """
    free = np.argwhere(scenario.flyable if among is None else scenario.flyable & among)
    if len(free) < n_uavs:
        raise InputError(
            f"the map has {len(free)} free cells, fewer than {n_uavs} UAVs; use fewer "
            "`uavs` or fly higher (`altitude_m`)"
        )
    return free[rng.choice(len(free), n_uavs, replace=False)]


def home_cells(
    scenario: Scenario, homes_m: Sequence[tuple[float, float]], n_uavs: int, apart_m: float = 0.0
) -> NDArray[np.int64]:
    """``[uav, (row, col)]`` the free cell of each UAV's home; UAVs that share one stand around it,
    by the shortest ways.

    Args:
        scenario: where they fly.
        homes_m: (x, y) of one home for all UAVs, or of one for each.
        n_uavs: how many UAVs.
        apart_m: least distance between two of them.

    Raises:
        InputError: there are other than one or ``n_uavs`` homes, one lies where nobody may fly, or
            there is no room around it.
    """
    if len(homes_m) not in (1, n_uavs):
        raise InputError(
            f"{len(homes_m)} homes for {n_uavs} UAVs; give one `home` for all, or one for each "
            "with semicolons between"
        )
    taken = np.empty((0, 2), dtype=np.int64)
    for home in homes_m if len(homes_m) == n_uavs else list(homes_m) * n_uavs:
        cell = _home_cell(scenario, home)
        way = steps_between(scenario.flyable, cell)
        free = np.argwhere(way >= 0)
        free = free[np.argsort(way[tuple(free.T)], kind="stable")]
        gap = np.hypot(*np.moveaxis(free[:, None] - taken[None], -1, 0)) * scenario.grid.spacing_m
        apart = (gap > 0).all(axis=1) & (gap >= apart_m).all(axis=1)
        if not apart.any():
            raise InputError(
                f"there is no room for {n_uavs} UAVs around the home {_shown(home)}; give fewer "
                "`uavs`, or each a `home` of its own"
            )
        taken = np.concatenate([taken, free[apart][:1]])
    return taken


def _home_cell(scenario: Scenario, home_m: tuple[float, float]) -> NDArray[np.int64]:
    """The free cell nearest to a home, at most `_HOME_M` away."""
    free = np.argwhere(scenario.flyable)
    if len(free):
        away = np.hypot(*(scenario.grid.xy_m(free) - np.asarray(home_m)).T)
        if away.min() <= max(_HOME_M, scenario.grid.spacing_m):
            return free[int(away.argmin())]
    why = "it lies off the map"
    cell = scenario.grid.cells_at(np.array([home_m]))[0]
    if scenario.grid.contains(cell):
        inside = scenario.city.obstructed(scenario.uav_altitude_m)[tuple(cell)]
        why = "it is inside a building" if inside else "nobody may fly there"
    raise InputError(
        f"no UAV can take off at the home {_shown(home_m)}: {why}, and so is everything within "
        f"{_HOME_M:g} m; give another `home`"
    )


def _shown(home_m: tuple[float, float]) -> str:
    return f"x={home_m[0]:.1f} m, y={home_m[1]:.1f} m"


def start_cells(
    kind: str,
    scenario: Scenario,
    n_uavs: int,
    rng: np.random.Generator,
    among: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """Start cells of the placement called ``kind``, one of `STARTS`.

    Args:
        kind: cluster or spread.
        scenario: where they fly.
        n_uavs: how many UAVs.
        rng: draws the cells.
        among: ``[row, col]`` cells to begin in, where enough of them are free: a replay begins
            where something was recorded.

    Raises:
        InputError: unknown placement, fewer than one UAV, or no room.
    """
    if n_uavs < 1:
        raise InputError(f"a swarm needs at least one UAV, got {n_uavs}; give a number from 1")
    free = int(scenario.flyable.sum())
    if free < n_uavs:
        raise InputError(
            f"the map has {free} free cells, fewer than {n_uavs} UAVs; use fewer "
            "`uavs` or fly higher (`altitude_m`)"
        )
    if among is not None and (scenario.flyable & among).sum() < n_uavs:
        among = None
    if kind == "cluster":
        try:
            return cluster_start(scenario, n_uavs, rng, among=among)
        except InputError:
            if among is None:
                raise
            return cluster_start(scenario, n_uavs, rng)
    if kind == "spread":
        return spread_start(scenario, n_uavs, rng, among)
    raise InputError(f"unknown `start` {kind!r}; known: {', '.join(STARTS)}")
