"""Recorded readings of one transmitter: the noun that every reader returns and every map begins
from."""

from __future__ import annotations

__all__ = ["FLOOR_STD_DB", "Recording", "joined"]

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError

FLOOR_STD_DB = 1.0
"""a cell's value is never taken to be surer than this, however many readings agree: phones report
whole dB, and readings taken together share their error"""


@dataclass(frozen=True, eq=False)
class Recording:
    """Readings as recorded, in the order of the file. Exactly one of ``latlon`` and ``xy_m`` is
    set; arrays are read-only."""

    level_db: NDArray[np.float64]
    """``[n]`` gain in dB, or power in dBm when ``quantity`` says so"""
    quantity: str
    """``"gain"``: channel gain in dB; ``"power"``: received power in dBm, which is the gain plus an
    unknown constant"""
    source: str
    """where it was read from, for titles and messages"""
    latlon: NDArray[np.float64] | None = None
    """``[n, (latitude, longitude)]`` in degrees, WGS 84"""
    xy_m: NDArray[np.float64] | None = None
    """``[n, (x, y)]`` in metres"""
    crs: str | None = None
    """projected coordinate reference system of ``xy_m``; ``None`` for a frame of its own"""
    time_s: NDArray[np.float64] | None = None
    """``[n]`` seconds since the earliest reading"""
    began_s: float | None = None
    """when that was, in seconds since 1970 (UTC unless the log names a zone), if the log says"""
    noise_std_db: NDArray[np.float64] | None = None
    """``[n]`` standard deviation of each reading's noise, when the file states it"""
    censored: NDArray[np.bool_] | None = None
    """``[n]`` whether the receiver was at its floor, when the file states it"""
    line: NDArray[np.int64] | None = None
    """``[n]`` line of the file, or number of the point, from 1"""
    columns: Mapping[str, str] = field(default_factory=dict)
    """name of the column that was taken for each role"""
    skipped: int = 0
    """lines that could not be read and were left out on request"""
    notes: tuple[str, ...] = ()
    """what the reader mended, assumed or left out, a line each"""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                object.__setattr__(self, f.name, view)

    def __len__(self) -> int:
        return len(self.level_db)

    def taken(self, index: ArrayLike) -> Recording:
        """The readings selected by an integer index or boolean mask."""
        index = np.asarray(index)
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return Recording(
            **{k: v[index] if isinstance(v, np.ndarray) else v for k, v in values.items()}
        )


def joined(recordings: Sequence[Recording]) -> Recording:
    """Several recordings of one transmitter as one, in the order given.

    A column (time, noise, censored) that one of them lacks is left out. Times of different files
    are not brought to a common clock, so they are left out too when there are several.

    Raises:
        InputError: they differ in what they hold (gain or power), or in how they say where.
    """
    first = recordings[0]
    if len(recordings) == 1:
        return first
    for other in recordings[1:]:
        for what, a, b in (
            ("the quantity", first.quantity, other.quantity),
            ("positions", _frame(first), _frame(other)),
        ):
            if a != b:
                raise InputError(
                    f"{first.source} and {other.source} cannot be one map: {what} differ ({a} "
                    f"against {b}); map them one by one"
                )

    def column(name: str) -> Any:
        parts = [getattr(r, name) for r in recordings]
        return None if any(p is None for p in parts) else np.concatenate(parts)

    notes = [f"{r.source}: {note}" for r in recordings for note in r.notes]
    return replace(
        first,
        **{
            name: column(name)
            for name in ("level_db", "latlon", "xy_m", "noise_std_db", "censored", "line")
        },
        time_s=None,
        began_s=None,
        source=f"{first.source} and {len(recordings) - 1} more",
        skipped=sum(r.skipped for r in recordings),
        notes=tuple(notes),
    )


def _frame(recording: Recording) -> str:
    if recording.latlon is not None:
        return "degrees"
    return f"metres of {recording.crs or 'a frame of their own'}"
