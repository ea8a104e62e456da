"""The four moves of a UAV, in the one order that everything keeps.

Ties between equally good plans fall by this order, so it is part of the answer.
"""

from __future__ import annotations

__all__ = ["DCOL", "DROW", "MOVES", "N_MOVES", "Cells"]

import numpy as np
from numpy.typing import NDArray

Cells = NDArray[np.int64]
"""cells, ``[..., (row, col)]``"""

MOVES: Cells = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
"""``[4, (row, col)]`` the moves north, east, south, west"""
N_MOVES = len(MOVES)
"""how many moves there are"""
DROW: NDArray[np.int64] = np.ascontiguousarray(MOVES[:, 0])
"""``[4]`` row offset of each move, for compiled code"""
DCOL: NDArray[np.int64] = np.ascontiguousarray(MOVES[:, 1])
"""``[4]`` column offset of each move, for compiled code"""
