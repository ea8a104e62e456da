"""What the UAVs have measured so far: immutable columns that only grow."""

from __future__ import annotations

__all__ = ["Measurements"]

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError


@dataclass(frozen=True, eq=False)
class Measurements:
    """Columns of equal length, one row per reading, in the order they were taken. Arrays are
    read-only.

    Raises:
        InputError: the columns differ in length, a gain is not finite, or a noise standard
            deviation is negative.

    >>> first = Measurements.at([[0, 1]], gain_db=[-90.0])
    >>> both = first.extended(Measurements.at([[2, 2]], gain_db=[-95.0], noise_std_db=1.0))
    >>> len(first), len(both), both.noise_std_db.tolist()
    (1, 2, [0.0, 1.0])
    """

    cell: NDArray[np.int64]
    """``[n, (row, col)]`` where"""
    gain_db: NDArray[np.float64]
    """``[n]`` measured channel gain"""
    noise_std_db: NDArray[np.float64]
    """``[n]`` standard deviation of the measurement noise, 0 for an exact reading"""
    time_s: NDArray[np.float64]
    """``[n]`` when, in seconds since the survey began"""
    uav: NDArray[np.int64]
    """``[n]`` which UAV"""
    censored: NDArray[np.bool_]
    """``[n]`` the receiver was at its floor: the true gain is ``gain_db`` or less"""

    def __post_init__(self) -> None:
        dtypes = {
            "cell": np.int64,
            "gain_db": float,
            "noise_std_db": float,
            "time_s": float,
            "uav": np.int64,
            "censored": bool,
        }
        length = len(np.asarray(self.gain_db))
        for name, dtype in dtypes.items():
            column = np.array(getattr(self, name), dtype=dtype)
            if name == "cell":
                column = column.reshape(-1, 2)
            if len(column) != length:
                raise InputError(
                    f"measurement columns must be of equal length: gain_db has {length} rows, "
                    f"{name} has {len(column)}"
                )
            column.flags.writeable = False
            object.__setattr__(self, name, column)
        if not np.isfinite(self.gain_db).all():
            raise InputError(
                "a measured gain is NaN or infinite; drop such readings before they enter a survey"
            )
        if not (np.isfinite(self.noise_std_db).all() and (self.noise_std_db >= 0).all()):
            raise InputError(
                "a noise standard deviation is negative or not finite; give 0 for an exact reading"
            )

    @classmethod
    def at(
        cls,
        cell: ArrayLike,
        gain_db: ArrayLike,
        *,
        noise_std_db: ArrayLike = 0.0,
        time_s: ArrayLike = 0.0,
        uav: ArrayLike = 0,
        censored: ArrayLike = False,
    ) -> Measurements:
        """Readings of ``gain_db[n]`` at ``cell[n, (row, col)]``; scalar columns are repeated."""
        n = len(np.asarray(gain_db))
        spread = (
            np.broadcast_to(np.asarray(c), (n,)) for c in (noise_std_db, time_s, uav, censored)
        )
        noise, time, which, floor = spread
        return cls(
            np.asarray(cell, dtype=np.int64).reshape(-1, 2),
            np.asarray(gain_db, dtype=float),
            noise,
            time,
            which,
            floor,
        )

    @classmethod
    def none(cls) -> Measurements:
        """No readings yet."""
        return cls.at(np.empty((0, 2), dtype=np.int64), np.empty(0))

    def __len__(self) -> int:
        return len(self.gain_db)

    def extended(self, more: Measurements) -> Measurements:
        """These readings followed by ``more``."""
        return Measurements(
            *(np.concatenate([getattr(self, f.name), getattr(more, f.name)]) for f in fields(self))
        )

    def taken(self, index: ArrayLike) -> Measurements:
        """The readings selected by an integer index or boolean mask."""
        index = np.asarray(index)
        if index.size == 0:
            index = index.astype(np.int64)  # an empty list arrives as floats
        return Measurements(*(getattr(self, f.name)[index] for f in fields(self)))

    def visited(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """``[row, col]`` cells with at least one reading."""
        mask = np.zeros(shape, dtype=bool)
        mask[self.cell[:, 0], self.cell[:, 1]] = True
        return mask
