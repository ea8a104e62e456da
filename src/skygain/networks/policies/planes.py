"""What a policy sees, and how little memory it takes.

The paper's observation of UAV n is (μ, Σ, M, P, p_n): predicted mean, predicted variance, city
heights, all UAV positions and the own position (section VI-C), as five planes. The first three are
kept as bytes, which is what the replay memory holds: the mean in steps of 0.63 dB, the standard
deviation (the same information as the variance, but evenly spread) in steps of 0.2 dB, heights in
half metres. The environment shows a policy exactly what the replay will show it.
"""

from __future__ import annotations

__all__ = ["PLANES", "action_masks", "packed_height", "packed_mean", "packed_std", "planes"]

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.flight.moves import MOVES

PLANES = ("mean", "std", "height", "positions", "own")
"""names of the planes, in order"""
LOWEST_DB, HIGHEST_DB = -200.0, -40.0
LARGEST_STD_DB = 51.0
LARGEST_HEIGHT_M = 127.5


def packed_mean(mean_db: ArrayLike) -> NDArray[np.uint8]:
    """Gains from −200 to −40 dB as bytes; beyond, the nearest of these."""
    return _packed((np.asarray(mean_db) - LOWEST_DB) / (HIGHEST_DB - LOWEST_DB))


def packed_std(variance_db2: ArrayLike) -> NDArray[np.uint8]:
    """Standard deviations up to 51 dB as bytes; any doubt at all is at least one step, so that 0
    means measured."""
    std = np.sqrt(np.asarray(variance_db2))
    return np.where(std > 0, np.maximum(_packed(std / LARGEST_STD_DB), 1), 0).astype(np.uint8)


def packed_height(height_m: ArrayLike) -> NDArray[np.uint8]:
    """Heights up to 127.5 m as bytes."""
    return _packed(np.asarray(height_m) / LARGEST_HEIGHT_M)


def _packed(share: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)


def planes(
    mean: NDArray[np.uint8],
    std: NDArray[np.uint8],
    height: NDArray[np.uint8],
    cells: ArrayLike,
    uav: ArrayLike,
) -> NDArray[np.float32]:
    """``[sample, plane, row, col]`` in 0..1 from packed maps ``[sample, row, col]``.

    ``cells[sample, uav, (row, col)]`` are all UAVs, rows of −1 none; ``uav[sample]`` says which one
    looks.
    """
    cells, uav = np.asarray(cells), np.asarray(uav)
    count = np.arange(len(mean))
    out = np.zeros((len(mean), len(PLANES), *mean.shape[1:]), dtype=np.float32)
    for k, packed in enumerate((mean, std, height)):
        np.multiply(packed, np.float32(1 / 255), out=out[:, k])
    sample, who = np.nonzero(cells[..., 0] >= 0)
    out[sample, 3, cells[sample, who, 0], cells[sample, who, 1]] = 1.0
    own = cells[count, uav]
    out[count, 4, own[:, 0], own[:, 1]] = 1.0
    return out


def action_masks(flyable: NDArray[np.bool_], cells: ArrayLike) -> NDArray[np.bool_]:
    """``[sample, uav, move]`` moves that stay on the map and out of buildings and no-fly cells; all
    of them where none does.

    ``flyable`` is ``[sample, row, col]``, ``cells`` is ``[sample, uav, (row, col)]``. A UAV without
    a legal move hovers whatever it asks.
    """
    near = np.asarray(cells)[:, :, None] + MOVES
    inside = np.all((near >= 0) & (near < flyable.shape[1:]), axis=-1)
    row, col = (
        np.clip(near[..., 0], 0, flyable.shape[1] - 1),
        np.clip(near[..., 1], 0, flyable.shape[2] - 1),
    )
    legal = inside & flyable[np.arange(len(flyable))[:, None, None], row, col]
    return legal | ~legal.any(axis=-1, keepdims=True)
