"""Which levels can be: what a quantity allows, and the marks that loggers write for no value.

A mark is a number such as −164 or 100 that stands for "not measured". One that slips through
becomes a hole or a peak of the map, so every level is held against what its quantity can be.
"""

from __future__ import annotations

__all__ = ["MAX_LEVEL_DB", "check_levels", "in_dbm", "limits"]

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.columns import normalised

MAX_LEVEL_DB = 300.0
"""a level beyond this in size is a logger's mark for "no value" (such as 2147483647), not a
reading"""

_MILLIWATTS = {"mw": 1.0, "uw": 1e-3, "nw": 1e-6, "pw": 1e-9, "watt": 1e3, "watts": 1e3}
_LIMITS = {"power": (-160.0, 30.0), "gain": (-MAX_LEVEL_DB, 30.0), "loss": (-30.0, MAX_LEVEL_DB)}
_RSRP = (-156.0, -30.0)
_GAP_DB = 20.0
"""a repeated extreme level this far from all others is a mark"""
_MOST_MARKS = 3
"""so many different impossible levels are marks; more are a column that holds something else"""


def limits(kind: str, column: str) -> tuple[float, float]:
    """Lowest and highest level in dB or dBm that a column can hold.

    Args:
        kind: ``"power"``, ``"gain"`` or ``"loss"``.
        column: its name; an RSRP is narrower than any power.
    """
    return _RSRP if kind == "power" and "rsrp" in normalised(column) else _LIMITS[kind]


def in_dbm(level: NDArray[np.float64], column: str, name: str) -> tuple[NDArray, list[str]]:
    """Levels whose column says that they are in another unit of power, in dBm, and what to tell;
    NaN where there is none.

    Raises:
        InputError: the unit is that of a voltage or a field, which is no power without the antenna.
    """
    unit = normalised(column).replace("μ", "u").removesuffix("_m")
    if unit.endswith(("dbuv", "db_uv")):
        raise InputError(
            f"{name}: column {column!r} is in dBµV or dBµV/m, a voltage or a field; convert it to "
            "dBm (of a voltage at 50 Ω, subtract 107), or name another column with "
            "`columns=level=NAME`"
        )
    last = unit.rpartition("_")[2]
    if last == "dbw":
        return level + 30.0, [f"column {column!r} is in dBW: dBm = dBW + 30"]
    if last in _MILLIWATTS:
        with np.errstate(divide="ignore", invalid="ignore"):
            values = 10.0 * np.log10(level * _MILLIWATTS[last])
        return np.where(level > 0, values, np.nan), [f"column {column!r} is converted to dBm"]
    return level, []


def check_levels(
    level: NDArray[np.float64],
    kind: str,
    column: str,
    name: str,
    line: NDArray[np.int64],
    wanted: tuple[float | None, float | None] = (None, None),
) -> tuple[NDArray[np.bool_], list[str]]:
    """Which levels are readings, and what to tell about the others.

    Args:
        level: ``[n]`` in dB or dBm, as in the file; not NaN.
        kind: ``"power"``, ``"gain"`` or ``"loss"``.
        column: name of the level's column.
        name: of the file, for messages.
        line: ``[n]`` where each stands.
        wanted: lowest and highest level to take, in place of what the quantity allows.

    Raises:
        InputError: the column holds no such quantity, or levels that cannot be and are no marks.
    """
    what = {"power": "dBm", "gain": "dB", "loss": "dB"}[kind]
    low, high = limits(kind, column)
    low, high = (w if w is not None else b for w, b in zip(wanted, (low, high), strict=True))
    keep = (level >= low) & (level <= high)
    if wanted != (None, None):
        told = []
        if not keep.all():
            told = [f"{int((~keep).sum())} levels outside {low:g} … {high:g} {what} left out, "
                    "as asked"]  # fmt: skip
        if not keep.any():
            raise InputError(
                f"{name}: no level of column {column!r} lies between {low:g} and {high:g} {what}; "
                f"they span {level.min():g} … {level.max():g}; give other limits with "
                "`level_min_db` and `level_max_db`"
            )
        return keep, told
    _check_sign(level, kind, column, name)
    if kind == "power":
        keep &= ~_isolated(level, keep)
    if keep.all():
        return keep, []
    values, count = np.unique(level[~keep], return_counts=True)
    first = line[~keep][0]
    if len(values) > _MOST_MARKS:
        raise InputError(
            f"{name}: {count.sum()} levels of column {column!r} cannot be {_called(kind, column)} "
            f"({low:g} … {high:g} {what}), the first in line {first}: "
            f"{level[~keep][0]:g}; leave such lines out with "
            f"`level_min_db={low:g}` or `level_max_db={high:g}`, or name another column with "
            "`columns=level=NAME`"
        )
    if not keep.any():
        raise InputError(
            f"{name}: column {column!r} holds nothing but {', '.join(f'{v:g}' for v in values)}, "
            f"which cannot be {_called(kind, column)}; name another column with "
            "`columns=level=NAME`"
        )
    marks = ", ".join(f"{v:.10g} ({n} times)" for v, n in zip(values, count, strict=True))
    return keep, [
        f"{count.sum()} of {len(level)} readings left out: level {marks} in column {column!r} is "
        f"no {what} but a mark for no value, first in line {first}"
    ]


def _called(kind: str, column: str) -> str:
    return "an RSRP" if limits(kind, column) == _RSRP else f"a {kind}"


def _check_sign(level: NDArray[np.float64], kind: str, column: str, name: str) -> None:
    """Raise where a column as a whole holds another quantity."""
    if kind == "power":
        plain = level[~np.isin(level, (99.0, 100.0, 127.0, 255.0)) & (np.abs(level) < 1e4)]
        if len(plain) and (plain >= 0).mean() > 0.5:
            largest = plain.max()
            guess = (
                "a fraction of full strength"
                if largest <= 1
                else "per cent, or an index such as ASU"
                if largest <= 100
                else "a loss, or a power without its minus sign"
            )
            raise InputError(
                f"{name}: column {column!r} is 0 or more ({plain.min():g} … {largest:g}), which no "
                f"receiver survives as power in dBm; it looks like {guess}: convert it to dBm, "
                "name another column with `columns=level=NAME`, say `quantity=loss`, or if these "
                f"are powers give `level_min_db={plain.min():g}`"
            )
    elif kind == "loss" and (level < 0).mean() > 0.5:
        raise InputError(
            f"{name}: column {column!r} as loss should be positive dB, but holds {level.min():g}; "
            "if it is a gain, say `quantity=gain`"
        )
    elif kind == "gain" and (level > 0).mean() > 0.5:
        raise InputError(
            f"{name}: column {column!r} as gain should be negative dB, but holds {level.max():g}; "
            "if it is a loss, say `quantity=loss`"
        )


def _isolated(level: NDArray[np.float64], keep: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Repeated extreme values far from all others, at the ends of what a power can be."""
    marks = np.zeros(len(level), dtype=bool)
    if not keep.any():
        return marks
    values, count = np.unique(level[keep], return_counts=True)
    if len(values) < 3:
        return marks
    often = count >= 2
    if values[0] <= -130 and values[1] - values[0] >= _GAP_DB and often[0]:
        marks |= level == values[0]
    if values[-1] >= -5 and values[-1] - values[-2] >= _GAP_DB and often[-1]:
        marks |= level == values[-1]
    return marks
