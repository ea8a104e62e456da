"""Where a survey begins: the two ways the protocol places the UAVs."""

from __future__ import annotations

__all__ = ["STARTS", "cluster_start", "spread_start", "start_cells"]

import numpy as np
from numpy.typing import NDArray

from skygain.flight.ways import steps_between
from skygain.ground.errors import InputError
from skygain.scenario import Scenario

STARTS = ("cluster", "spread")
"""names of the placements"""


def cluster_start(
    scenario: Scenario, n_uavs: int, rng: np.random.Generator, side_m: float = 40.0
) -> NDArray[np.int64]:
    """``[uav, (row, col)]`` distinct random free cells of one connected part of a random square of
    ``side_m``.

    The square is drawn again, up to 1,000 times, while no connected part of it holds ``n_uavs``
    free cells.

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
        part = np.argwhere(steps_between(window, free[rng.integers(len(free))]) >= 0)
        if len(part) >= n_uavs:
            return part[rng.choice(len(part), n_uavs, replace=False)] + (row, col)
    raise InputError(
        f"found no {side_m:g} m square with {n_uavs} connected free cells, one per UAV; use fewer "
        "UAVs, start 'spread' or fly higher"
    )


def spread_start(scenario: Scenario, n_uavs: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """``[uav, (row, col)]`` distinct random free cells of the whole map.

    Raises:
        InputError: there are fewer free cells than UAVs.
    """
    free = np.argwhere(scenario.flyable)
    if len(free) < n_uavs:
        raise InputError(
            f"the map has {len(free)} free cells, fewer than {n_uavs} UAVs; use fewer UAVs or fly "
            "higher"
        )
    return free[rng.choice(len(free), n_uavs, replace=False)]


def start_cells(
    kind: str, scenario: Scenario, n_uavs: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Start cells of the placement called ``kind``, one of `STARTS`.

    Raises:
        InputError: unknown placement, fewer than one UAV, or no room.
    """
    if n_uavs < 1:
        raise InputError(f"a swarm needs at least one UAV, got {n_uavs}; give a number from 1")
    free = int(scenario.flyable.sum())
    if free < n_uavs:
        raise InputError(
            f"the map has {free} free cells, fewer than {n_uavs} UAVs; use fewer UAVs or fly higher"
        )
    if kind == "cluster":
        return cluster_start(scenario, n_uavs, rng)
    if kind == "spread":
        return spread_start(scenario, n_uavs, rng)
    raise InputError(f"unknown start {kind!r}; known: {', '.join(STARTS)}")
