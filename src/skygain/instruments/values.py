"""What a field of a log says: a number, a position, a moment, or that there is no value.

Loggers write numbers with decimal commas, with their unit behind them, in degrees, minutes and
seconds, and write a mark where they have none. Columns that hold plain numbers take the fast way.
"""

from __future__ import annotations

__all__ = ["BAD", "FINE", "MISSING", "degrees", "number", "numbers", "pairs", "seconds", "texts"]

import math
import re

import numpy as np
from numpy.typing import NDArray

FINE, MISSING, BAD = 0, 1, 2
"""what a field is: a value, a mark for no value, or not to be understood"""

_NO_VALUE = frozenset(
    (
        "",
        "-",
        "--",
        "---",
        "—",
        "–",
        "?",
        "*",
        "n/a",
        "na",
        "#n/a",
        "nan",
        "null",
        "none",
        "nil",
        "unavailable",
        "not available",
        "unknown",
        "invalid",
        "no signal",
        "no service",
        "no data",
        "nodata",
        "n.a.",
        "n.d.",
        "nd",
        "missing",
        "undefined",
        "not detected",
        "not found",
        "not measured",
        "keine",
        "нет",
        "\\n",
    )
)
_UNITS = r"(?:dbm|db|dbi|m|meters?|metres?|deg|degrees|°|s|sec|ms|м|с|дбм|дб)"
_WITH_UNIT = re.compile(rf"([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*{_UNITS}\.?", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?\d*,\d+(?:e[+-]?\d+)?", re.IGNORECASE)
_DMS = re.compile(
    r"(?P<before>[NSEWO])?\s*(?P<sign>[+-])?\s*(?P<d>\d+(?:[.,]\d+)?)\s*(?:°|º|d|deg|:|\s)\s*"
    r"(?:(?P<m>\d+(?:[.,]\d+)?)\s*(?:'|′|’|m|min|:|\s|$)?\s*)?"
    r"(?:(?P<s>\d+(?:[.,]\d+)?)\s*(?:\"|″|”|''|s|sec)?\s*)?(?P<after>[NSEWO])?",
    re.IGNORECASE,
)
_WITH_LETTER = re.compile(
    r"(?:(?P<before>[NSEW])\s*)?(?P<d>[+-]?\d+(?:[.,]\d+)?)\s*°?\s*(?P<after>[NSEW])?",
    re.IGNORECASE,
)
_PAIR = re.compile(r"\s*\(?\s*([+-]?\d+(?:[.,]\d+)?)\s*(?:[\s;/]|,\s|,(?=[+-]?\d+\.))\s*"
                   r"([+-]?\d+(?:[.,]\d+)?)\b.*")  # fmt: skip
_POINT = re.compile(r"(?:SRID=\d+;)?\s*POINT\s*Z?\s*\(\s*(\S+)\s+(\S+?)[\s)].*", re.IGNORECASE)
_FIRST_DATE_S = 1e9
"""a number of seconds from this on is a date, that of September 2001 or later"""
_ZONE = re.compile(r"(?:Z|[+-]\d\d:?\d\d)$")
_MOMENTS = (
    "%Y.%m.%d_%H.%M.%S",
    "%Y-%m-%d_%H-%M-%S",
    "%Y.%m.%d %H:%M:%S",
    "%Y/%m/%d %H:%M:%S",
    "%d.%m.%Y %H:%M:%S",
    "%H:%M:%S",
)


def number(text: str) -> float:
    """The number a field holds; NaN when it holds none.

    >>> number("-73,2"), number("-73 dBm"), number("−5"), number("42 %")
    (-73.2, -73.0, -5.0, nan)
    """
    plain = text.strip().replace("\u2212", "-")
    found = _WITH_UNIT.fullmatch(plain)
    plain = found[1] if found else plain
    try:
        return float(plain.replace(",", ".") if _COMMA.fullmatch(plain) else plain)
    except ValueError:
        return math.nan


def _degrees(text: str) -> float:
    """An angle as degrees, minutes and seconds, or with the letter of its half; NaN when it is
    none."""
    value = number(text)
    if not math.isnan(value):
        return value
    plain = text.strip().replace("\u2212", "-")
    found = _WITH_LETTER.fullmatch(plain) or _DMS.fullmatch(plain)
    if not found:
        return math.nan
    part = {k: v for k, v in found.groupdict().items() if v}
    whole, minutes, rest = (float(part.get(k, "0").replace(",", ".")) for k in ("d", "m", "s"))
    letters = (part.get("before", "") + part.get("after", "")).upper()
    if minutes >= 60 or rest >= 60 or len(letters) > 1:
        return math.nan
    value = abs(whole) + minutes / 60 + rest / 3600
    south = letters in ("S", "W") or part.get("sign") == "-" or whole < 0
    return -value if south else value


def texts(column: NDArray) -> NDArray:
    """``[n]`` the fields as text without spaces around."""
    if column.dtype != object:
        return column.astype(str).astype(object)
    return np.array([str(text).strip() for text in column.tolist()], dtype=object)


def numbers(column: NDArray, parse=number) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """``[n]`` the numbers of a column (NaN where there is none), and ``[n]`` what each field is:
    `FINE`, `MISSING` or `BAD`."""
    import pandas as pd

    if column.dtype != object:
        values = np.array(column, dtype=np.float64)
        kind = np.where(np.isfinite(values), FINE, np.where(np.isnan(values), MISSING, BAD))
        return values, kind.astype(np.int8)
    values = np.array(pd.to_numeric(pd.Series(column), errors="coerce"), dtype=np.float64)
    kind = np.zeros(len(values), dtype=np.int8)
    odd = np.flatnonzero(~np.isfinite(values))
    if len(odd):
        codes, unique = pd.factorize(column[odd])
        parsed = np.array([parse(str(text)) for text in unique])
        what = np.array([_kind(str(t), v) for t, v in zip(unique, parsed, strict=True)])
        values[odd], kind[odd] = parsed[codes], what[codes]
    return values, kind


def _kind(text: str, value: float) -> int:
    if math.isfinite(value):
        return FINE
    return MISSING if text.strip().casefold() in _NO_VALUE else BAD


def degrees(column: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """As `numbers`, for angles: ``48°12'00.5"N`` is understood too."""
    return numbers(column, _degrees)


def pairs(column: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int8]]:
    """Latitudes and longitudes that stand in one column, ``48.2 16.37`` or ``POINT (16.37 48.2)``,
    and ``[n]`` what each field is."""
    first, second, kind = np.full((2, len(column)), np.nan)[0], np.full(len(column), np.nan), []
    for i, text in enumerate(texts(column).tolist()):
        point, pair = _POINT.fullmatch(text), _PAIR.fullmatch(text)
        if point:
            first[i], second[i] = number(point[2]), number(point[1])
        elif pair:
            first[i], second[i] = number(pair[1]), number(pair[2])
        fine = math.isfinite(first[i]) and math.isfinite(second[i])
        kind.append(FINE if fine else _kind(text, math.nan))
    return first, second, np.array(kind, dtype=np.int8)


def seconds(column: NDArray, name: str) -> tuple[NDArray[np.float64] | None, float | None, str]:
    """``[n]`` seconds since the earliest, or ``None``; the earliest in seconds since 1970, where
    the column states the date; and why the column was not understood.

    Numbers are seconds, or milliseconds by name or by size. Text is ISO 8601 or one of the usual
    notations of loggers, the same in every line.
    """
    values, kind = numbers(column)
    if (kind == FINE).all() and (np.abs(values) < 1e19).all():
        # Seconds since 1970 reach 1e11 in the year 5138, milliseconds 1e14.
        size = values.min()
        scale = 1e9 if size > 1e17 else 1e6 if size > 1e14 else 1e3 if size > 1e11 else 1.0
        if scale == 1.0 and name.casefold().endswith(("ms", "millis")):
            scale = 1e3
        began = float(size) / scale
        return (values - size) / scale, began if began >= _FIRST_DATE_S else None, ""
    fields = texts(column)
    empty = [i for i, text in enumerate(fields.tolist()) if text.casefold() in _NO_VALUE]
    if empty:
        why = f"{len(empty)} of {len(fields)} values are empty or marked as missing"
        return None, None, why
    zoned = np.array([bool(_ZONE.search(text)) for text in fields.tolist()])
    if zoned.any() and not zoned.all():
        why = f"only {int(zoned.sum())} of {len(fields)} values name their time zone"
        return None, None, why
    return _moments(fields)


def _moments(fields: NDArray) -> tuple[NDArray[np.float64] | None, float | None, str]:
    import pandas as pd

    for notation in ("ISO8601", *(f + tail for f in _MOMENTS for tail in ("", ".%f"))):
        try:
            pd.to_datetime(fields[:1], format=notation, utc=True)
            moments = pd.to_datetime(fields, format=notation, utc=True)
            past = (moments - moments.min()).total_seconds()
        except (ValueError, TypeError, OverflowError, AttributeError):
            continue
        values = np.array(past, dtype=np.float64)
        if np.isfinite(values).all():
            dated = "%Y" in notation or notation == "ISO8601"
            return values, moments.min().timestamp() if dated else None, ""
    return None, None, f"{fields[0][:40]!r} is neither seconds nor ISO 8601"
