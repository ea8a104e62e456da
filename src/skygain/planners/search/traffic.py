"""Where the other UAVs will be, and whether a move keeps clear of them."""

from __future__ import annotations

__all__ = ["Traffic", "is_clear"]

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skygain.flight.airspace import keeps_apart
from skygain.ground.kernels import uncounted


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


@uncounted()
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
