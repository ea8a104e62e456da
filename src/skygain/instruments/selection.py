"""Which lines of a log are read, and that they are one signal at one altitude.

Readings of different cells, networks or altitudes are different maps. Averaged into one they give
a map of nothing, so a log that mixes them is refused until one is chosen.
"""

from __future__ import annotations

__all__ = [
    "Condition",
    "conditions",
    "nothing_passes",
    "refuse_altitudes",
    "refuse_series",
]

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.columns import column_for, metres_each, normalised
from skygain.instruments.tables import quoted_list
from skygain.instruments.values import numbers, texts

_ALTITUDE_SPREAD_M = 10.0
"""readings of one place further apart than this are of several altitudes"""
_PLACE_M = 30.0
_MOST_MIXED = 0.5
"""a log with several signals at more than this share of its places mixes them"""
_UNNAMED = ("", "-", "unavailable", "null", "nan", "none", "n/a")
_RANGE = re.compile(r"\s*([+-]?[\d.]+?(?:e[+-]?\d+)?)?\s*\.\.\s*([+-]?[\d.]+(?:e[+-]?\d+)?)?\s*")


@dataclass(frozen=True)
class Condition:
    """What a line must hold in one column to be read."""

    column: int
    """index of the column"""
    name: str
    """its name"""
    value: str
    """the text or number asked for, ``low..high``, or ``*`` for any"""

    def holds(self, column: NDArray) -> NDArray[np.bool_]:
        """``[n]`` which of the fields pass.

        Raises:
            InputError: a range whose ends are no numbers, or the wrong way round.
        """
        if self.value == "*":
            return np.ones(len(column), dtype=bool)
        if ".." in self.value and not (texts(column) == self.value).any():
            low, high = self._ends()
            values, _ = numbers(column)
            with np.errstate(invalid="ignore"):
                return (values >= low) & (values <= high)
        if column.dtype != object:
            try:
                return column == float(self.value)
            except ValueError:
                return np.zeros(len(column), dtype=bool)
        return texts(column) == self.value

    def _ends(self) -> tuple[float, float]:
        found = _RANGE.fullmatch(self.value)
        try:
            low, high = (float(v) if v else None for v in found.groups()) if found else (1, 0)
        except ValueError:
            low, high = 1, 0
        ends = -np.inf if low is None else low, np.inf if high is None else high
        if not ends[0] <= ends[1]:
            raise InputError(
                f"cannot read the range {self.name}={self.value}; write low..high, for example "
                f"{self.name}=25..35"
            )
        return ends


def conditions(header: Sequence[str], where: Mapping[str, Any]) -> list[Condition]:
    """The conditions of a filter ``{column name: value}``.

    Raises:
        InputError: a column does not exist.
    """
    found = [(column_for(header, name, "filter"), value) for name, value in where.items()]
    return [Condition(i, header[i], str(value).strip()) for i, value in found]


def refuse_series(
    name: str,
    header: Sequence[str],
    columns: Mapping[int, NDArray],
    chosen: Sequence[Condition],
    place_m: NDArray[np.float64],
) -> list[str]:
    """Raise if several cells, networks or channels were measured at the same places; say so where
    they take turns from place to place, as a serving cell does.

    Args:
        name: of the file.
        header: column names.
        columns: the columns that tell signals apart, of the lines read.
        chosen: the filter; a column it names is settled.
        place_m: ``[n, 2]`` in metres, on any frame.

    Raises:
        InputError: naming the column and its values.
    """
    told = []
    settled = {condition.column for condition in chosen}
    for i, column in columns.items():
        if i in settled:
            continue
        values, code, count = _values(column)
        named = np.array([v.casefold() not in _UNNAMED for v in values.tolist()])
        if named.sum() < 2:
            continue
        order = [k for k in np.argsort(-count, kind="stable") if named[k]]
        shown = ", ".join(f"{values[k][:30]} ({count[k]} lines)" for k in order[:6])
        more = f" and {len(order) - 6} more" if len(order) > 6 else ""
        held = f"{len(order)} values of {header[i]!r}: {shown}{more}"
        key = _quoted(header[i])
        help_ = (
            f"choose one with `where={key}={_quoted(values[order[0]])}`, or make a map of each "
            f"with skygain map --by {key}"
        )
        group = _places(place_m)
        pairs = np.unique(np.column_stack([group, code.ravel()])[named[code.ravel()]], axis=0)
        several = np.bincount(pairs[:, 0], minlength=group.max() + 1) > 1
        if several[group].mean() > _MOST_MIXED:
            raise InputError(
                f"{name} holds {held}, measured at the same places; they are different signals: "
                f"{help_}, or take all as one with `where={key}=*`"
            )
        told.append(f"{held}, mostly at different places, read as one map; {help_}")
    return told


def _values(column: NDArray) -> tuple[NDArray, NDArray[np.int64], NDArray[np.int64]]:
    """The different values of a column as text, ``[n]`` which of them each line has, and how often
    each occurs."""
    if column.dtype != object and len(column) and (column == column[0]).all():
        return (
            column[:1].astype(str),
            np.zeros(len(column), dtype=np.int64),
            np.array([len(column)]),
        )
    plain = texts(column).astype(str) if column.dtype == object else column
    values, code, count = np.unique(plain, return_inverse=True, return_counts=True)
    return values.astype(str), code.ravel(), count


def _places(place_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """``[n]`` number of the square that each reading lies in."""
    square = np.floor(np.clip(place_m - place_m.min(axis=0), 0, 1e9) / _PLACE_M)
    key = square[:, 0] * (square[:, 1].max() + 1.0) + square[:, 1]
    return np.unique(key, return_inverse=True)[1].ravel()


def _quoted(text: str) -> str:
    return f'"{text}"' if re.search(r"[,=\s]", text) else text


def refuse_altitudes(
    name: str,
    column: str,
    altitudes: NDArray[np.float64],
    place_m: NDArray[np.float64],
) -> list[str]:
    """Raise if places were visited at several altitudes; say so where altitudes differ from place
    to place.

    Args:
        name: of the file.
        column: of the altitudes.
        altitudes: ``[n]`` in the column's unit, NaN where it is not known.
        place_m: ``[n, 2]`` in metres, on any frame.

    Raises:
        InputError: naming the column and its values.
    """
    known = np.isfinite(altitudes)
    if known.sum() < 2:
        return []
    altitude, unit_m = altitudes[known], metres_each(column)
    spread, unit = _ALTITUDE_SPREAD_M / unit_m, "m" if unit_m == 1.0 else "ft"
    low, high = np.percentile(altitude, (2, 98))
    if high - low <= spread:
        return []
    group = _places(place_m[known])
    lows, highs = (np.full(group.max() + 1, v) for v in (np.inf, -np.inf))
    np.minimum.at(lows, group, altitude)
    np.maximum.at(highs, group, altitude)
    relative = any(w in normalised(column) for w in ("agl", "rel", "above_ground", "takeoff"))
    mixed = float((highs - lows > spread).mean())
    if not relative and mixed < 0.05:
        return [
            f"altitudes (column {column!r}) run from {low:g} to {high:g} {unit} from place to place"
        ]
    values, count = np.unique(np.rint(altitude), return_counts=True)
    order = np.argsort(-count, kind="stable")[:6]
    shown = ", ".join(f"{values[k]:g} {unit} ({count[k]} lines)" for k in sorted(order))
    common, beside = values[order[0]], np.rint(spread / 2)
    raise InputError(
        f"{name} holds several altitudes in column {column!r}, {low:g} to {high:g} {unit}: {shown}"
        f"{' …' if len(values) > 6 else ''}; they are different maps: choose one with "
        f"`where={_quoted(column)}={common - beside:g}..{common + beside:g}`, or take all as one "
        f"with `where={_quoted(column)}=*`"
    )


def nothing_passes(
    name: str, chosen: Sequence[Condition], columns: Mapping[int, NDArray]
) -> InputError:
    """Why no line passed a filter."""
    asked = " and ".join(f"{c.name}={c.value}" for c in chosen)
    held = []
    for c in chosen:
        values = np.unique(texts(columns[c.column]).astype(str)).tolist()
        held.append(f"{c.name} has {quoted_list(values, 12)}")
    return InputError(f"no line of {name} has {asked}; choose other values ({'; '.join(held)})")
