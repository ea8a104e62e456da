"""What policy networks are fed with: the paper's five planes, or a view centred on the UAV.

The centred view has two scales: the 33 × 33 cells around the UAV as they are, and everything up to
94 cells away in 27 × 27 blocks of 7 × 7 cells. It knows no absolute place, so what is learned in
one corner serves in all others, on maps of any size, and turns and
mirror images of it are exact. A few numbers go with it: the last move, the share of steps left, the
size of the swarm.
"""

from __future__ import annotations

__all__ = [
    "FAR",
    "FAR_CHANNELS",
    "NEAR",
    "NEAR_CHANNELS",
    "NUMBERS",
    "Seen",
    "centred_view",
    "last_moves",
    "moves_of",
    "paper_view",
    "policy_views",
    "turned_moves",
    "turned_view",
]

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skygain.flight.moves import MOVES
from skygain.flight.swarm import Swarm
from skygain.grid import turned, turned_cells
from skygain.ground.errors import InputError
from skygain.networks.policies.planes import planes

NEAR, FAR, BLOCK = 33, 27, 7
NEAR_CHANNELS = ("std", "mean", "flyable", "height", "measured", "others")
FAR_CHANNELS = ("std", "mean", "flyable", "others")
NUMBERS = 6
"""last move (4, one of them 1), steps left / 200, UAVs / 6"""
STEPS_SCALE, SWARM_SCALE = 200.0, 6.0


View = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Seen:
    """What one UAV each of many surveys sees; maps packed as in
    `skygain.networks.policies.planes`."""

    mean: NDArray[np.uint8]
    """``[sample, row, col]``"""
    std: NDArray[np.uint8]
    """``[sample, row, col]``"""
    height: NDArray[np.uint8]
    """``[sample, row, col]``"""
    flyable: NDArray[np.bool_]
    """``[sample, row, col]``"""
    cells: NDArray[np.int64]
    """``[sample, uav, (row, col)]`` all UAVs"""
    uav: NDArray[np.int64]
    """``[sample]`` which of them looks"""
    last: NDArray[np.int64]
    """``[sample]`` its last move, −1 if it has made none"""
    left: NDArray[np.int64]
    """``[sample]`` steps it has left"""


def moves_of(delta: NDArray[np.int64]) -> NDArray[np.int64]:
    """``[...]`` the move that each ``delta[..., (row, col)]`` is, −1 where it is none."""
    match = (delta[..., None, :] == MOVES).all(axis=-1)
    return np.where(match.any(axis=-1), match.argmax(axis=-1), -1)


def last_moves(swarm: Swarm) -> NDArray[np.int64]:
    """``[uav]`` the last move of each, −1 if it has made none or hovered."""
    if swarm.steps_flown == 0:
        return np.full(swarm.n_uavs, -1)
    return moves_of(swarm.history[:, -1] - swarm.history[:, -2])


@njit(cache=True, nogil=True)
def _fill(mean, std, height, flyable, cells, uav, near, far):
    rows, cols = mean.shape[1:]
    half, reach = near.shape[2] // 2, far.shape[2] * 7 // 2
    share = np.float32(1.0 / 255.0)
    for b in range(len(mean)):
        row, col = cells[b, uav[b], 0], cells[b, uav[b], 1]
        for i in range(max(0, row - reach), min(rows, row + reach + 1)):
            y = (i - row + reach) // 7
            for j in range(max(0, col - reach), min(cols, col + reach + 1)):
                x = (j - col + reach) // 7
                if flyable[b, i, j]:
                    far[b, 0, y, x] += std[b, i, j] * share
                    far[b, 1, y, x] += mean[b, i, j] * share
                    far[b, 2, y, x] += 1.0
        for y in range(far.shape[2]):
            for x in range(far.shape[3]):
                count = far[b, 2, y, x]
                if count > 0:
                    far[b, 0, y, x] /= count
                    far[b, 1, y, x] /= count
                    far[b, 2, y, x] = count / 49.0
        for i in range(max(0, row - half), min(rows, row + half + 1)):
            y = i - row + half
            for j in range(max(0, col - half), min(cols, col + half + 1)):
                x = j - col + half
                near[b, 3, y, x] = height[b, i, j] * share
                if flyable[b, i, j]:
                    near[b, 0, y, x] = std[b, i, j] * share
                    near[b, 1, y, x] = mean[b, i, j] * share
                    near[b, 2, y, x] = 1.0
                    near[b, 4, y, x] = 1.0 if std[b, i, j] == 0 else 0.0
        for u in range(cells.shape[1]):
            if u == uav[b] or cells[b, u, 0] < 0:
                continue
            y, x = cells[b, u, 0] - row, cells[b, u, 1] - col
            if abs(y) <= half and abs(x) <= half:
                near[b, 5, y + half, x + half] = 1.0
            if abs(y) <= reach and abs(x) <= reach:
                far[b, 3, (y + reach) // 7, (x + reach) // 7] += 1.0


def centred_view(seen: Seen) -> View:
    """(near ``[sample, channel, 33, 33]``, far ``[sample, channel, 27, 27]``, numbers ``[sample,
    6]``).

    Rows of ``seen.cells`` with −1 are UAVs that do not exist, so that swarms of different size fit
    into one batch.
    """
    count = len(seen.mean)
    near = np.zeros((count, len(NEAR_CHANNELS), NEAR, NEAR), dtype=np.float32)
    far = np.zeros((count, len(FAR_CHANNELS), FAR, FAR), dtype=np.float32)
    _fill(
        seen.mean,
        seen.std,
        seen.height,
        seen.flyable,
        seen.cells.astype(np.int64),
        seen.uav.astype(np.int64),
        near,
        far,
    )
    numbers = np.zeros((count, NUMBERS), dtype=np.float32)
    moved = np.flatnonzero(seen.last >= 0)
    numbers[moved, seen.last[moved]] = 1.0
    numbers[:, 4] = seen.left / STEPS_SCALE
    numbers[:, 5] = (seen.cells[:, :, 0] >= 0).sum(axis=1) / SWARM_SCALE
    return near, far, numbers


def turned_moves(symmetry: int) -> NDArray[np.int64]:
    """``[move]`` what each move becomes under ``symmetry``."""
    return moves_of(turned_cells(MOVES, (0, 0), symmetry))


def turned_view(view: View, symmetry: int) -> View:
    """The view of the same survey under ``symmetry``: what was move m there is move
    ``turned_moves(symmetry)[m]`` here."""
    near, far, numbers = view
    turned_numbers = numbers.copy()
    turned_numbers[:, turned_moves(symmetry)] = numbers[:, :4]
    near, far = (np.ascontiguousarray(turned(maps, symmetry)) for maps in (near, far))
    return near, far, turned_numbers


def paper_view(seen: Seen, side: int, symmetry: int = 0) -> NDArray[np.float32]:
    """``[sample, plane, side, side]`` of the paper's network under a symmetry of the square;
    smaller maps are embedded in ground without doubt.

    Raises:
        InputError: the map is larger than the network's.
    """
    room = side - np.array(seen.mean.shape[1:])
    if room.min() < 0:
        raise InputError(
            f"this policy network sees maps of up to {side} × {side} cells, got "
            f"{seen.mean.shape[1:]}; crop the city or use a policy with a centred view"
        )
    mean, std, height = (
        np.pad(m, ((0, 0), (0, room[0]), (0, room[1]))) for m in (seen.mean, seen.std, seen.height)
    )
    x = planes(mean, std, height, seen.cells, seen.uav)
    return np.ascontiguousarray(turned(x, symmetry))


def policy_views(
    shape: dict[str, Any], seen: Seen, count: int
) -> list[tuple[NDArray[np.float32], ...]]:
    """What the network that ``shape`` describes is called with, under the first ``count``
    symmetries; the paper's, whose view is not centred, under the first alone."""
    if shape["network"] == "paper":
        return [(paper_view(seen, shape["side"]),)]
    view = centred_view(seen)
    return [turned_view(view, symmetry) for symmetry in range(count)]
