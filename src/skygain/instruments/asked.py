"""What every instrument checks before it answers: that the cells asked for are cells of its map,
and who asks."""

from __future__ import annotations

__all__ = ["asked_cells", "asked_uavs"]

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError


def asked_cells(cells: ArrayLike, shape: tuple[int, int]) -> NDArray[np.int64]:
    """``[n, (row, col)]`` a copy of ``cells``, all on a map of ``shape``.

    Raises:
        InputError: they are not integer pairs, or one lies off the map.
    """
    given = np.asarray(cells)
    if given.size == 0:
        return np.empty((0, 2), dtype=np.int64)
    if given.ndim != 2 or given.shape[1] != 2 or not np.issubdtype(given.dtype, np.integer):
        raise InputError(
            f"cells to measure are integers of shape [n, 2], got {given.dtype} of shape "
            f"{given.shape}; give [[row, col], …]"
        )
    asked = given.astype(np.int64)
    off = ~np.all((asked >= 0) & (asked < np.asarray(shape)), axis=1)
    if off.any():
        raise InputError(
            f"cannot measure at {tuple(asked[off][0].tolist())}: the map has {shape} cells; ask "
            "for cells on the map"
        )
    return asked


def asked_uavs(uav: ArrayLike | None, n: int) -> NDArray[np.int64]:
    """``[n]`` which UAV stands at each cell; 0, 1, 2, … when left out.

    Raises:
        InputError: there is not one for each cell.
    """
    if uav is None:
        return np.arange(n)
    which = np.array(uav, dtype=np.int64)
    if which.shape != (n,):
        raise InputError(
            f"uav must name one UAV for each of the {n} cells, got shape {which.shape}; leave it "
            "out for 0, 1, 2, …"
        )
    return which
