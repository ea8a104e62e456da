"""A log as named columns, before anyone knows what they mean.

Every file format is brought to this one form; what the columns mean is decided once, in
`skygain.instruments.reading`.
"""

from __future__ import annotations

__all__ = ["Columns", "Table", "quoted_list"]

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Columns: TypeAlias = tuple[list[NDArray], NDArray[np.int64]]
"""the columns asked for, each ``[n]`` numbers or text, and ``[n]`` lines they stand in"""


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of a log."""

    name: str
    """of the file, for titles and messages"""
    header: tuple[str, ...]
    """the columns' names"""
    load: Callable[[Sequence[int]], Columns]
    """reads the columns with these indices; rows without any value among them are passed over"""
    roles: Mapping[str, str] = field(default_factory=dict)
    """roles that the format itself gives: ``{role: column name}``"""
    crs: str | None = None
    """coordinate reference system of x and y, where the format states it"""
    quantity: str | None = None
    """what the level is, where the format states it"""
    notes: tuple[str, ...] = ()
    """what had to be assumed to read the columns"""


def quoted_list(names: Sequence[str], most: int = 30) -> str:
    """Names for a message: quoted, shortened, and at most so many.

    >>> quoted_list(["lat", "lon", "rsrp"], most=2)
    "'lat', 'lon' and 1 more"
    """
    shown = ", ".join(repr(str(name)[:40]) for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")
