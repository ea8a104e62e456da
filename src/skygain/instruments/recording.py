"""A recorded campaign: real readings of one transmitter, read from a CSV file.

The reader is strict about what could silently spoil a map (a level that is not a number, a swapped
latitude, a loss taken for a gain, two columns that would both do) and easy about the rest
(delimiter, byte-order mark, decimal commas, column names, extra columns). What it had to guess
stands in the result. See docs/instruments.md.
"""

from __future__ import annotations

__all__ = ["MAX_BYTES", "MAX_LEVEL_DB", "Recording", "read_recording"]

import csv
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.frames import parse_crs
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments.columns import find_columns, level_quantity, named_column
from skygain.instruments.gridded import FLOOR_STD_DB, GriddedRecording, gridded

MAX_BYTES = 1_000_000_000
"""largest file read without being asked to; about 20 million readings"""

MAX_LEVEL_DB = 300.0
"""a level beyond this in size is a logger's mark for "no value" (such as 2147483647), not a
reading"""

_STRONGEST_POWER_DBM = 30.0
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_TRUE, _FALSE = {"1", "true", "yes", "1.0"}, {"", "0", "false", "no", "0.0"}


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
    noise_std_db: NDArray[np.float64] | None = None
    """``[n]`` standard deviation of each reading's noise, when the file states it"""
    censored: NDArray[np.bool_] | None = None
    """``[n]`` whether the receiver was at its floor, when the file states it"""
    line: NDArray[np.int64] | None = None
    """``[n]`` line of the file, from 1"""
    columns: Mapping[str, str] = field(default_factory=dict)
    """name of the column that was taken for each role"""
    skipped: int = 0
    """bad lines left out on request"""

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

    def on(self, grid: Grid, *, floor_std_db: float = FLOOR_STD_DB) -> GriddedRecording:
        """One value per cell of ``grid``: see `skygain.instruments.gridded.gridded`."""
        return gridded(self, grid, floor_std_db=floor_std_db)


def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    where: Mapping[str, Any] | None = None,
    quantity: str | None = None,
    eirp_dbm: float | None = None,
    crs: str | None = None,
    skip_bad: bool = False,
    max_bytes: int = MAX_BYTES,
) -> Recording:
    """Read a campaign from a CSV file whose first line names the columns.

    The delimiter (comma, semicolon or tab) is the one that splits the first line into most columns.
    Text is UTF-8, with or without byte-order mark. In files that are not split by commas a decimal
    comma is understood. Empty lines are passed over.

    Args:
        path: the file.
        columns: ``{role: column name}``, role one of `skygain.instruments.columns.ROLES`; other
            columns are guessed by name.
        where: ``{column name: value}``; only lines that have these values (compared as text) are
            read.
        quantity: what the level column holds: ``"power"`` in dBm, ``"gain"`` in dB (negative), or
            ``"loss"`` in dB (positive); told from the column's name when left out. A loss is turned
            into a gain.
        eirp_dbm: radiated power of the transmitter towards the receiver, antenna gains included;
            gain = power − EIRP. Without it a power stays a power.
        crs: projected coordinate reference system of x and y, e.g. ``"EPSG:32617"``; a frame of
            their own when left out.
        skip_bad: leave out lines without a usable level and position and count them, instead of
            refusing the file.
        max_bytes: refuse larger files.

    Raises:
        InputError: the file cannot be used; the message names the line or the columns.
    """
    path = Path(path)
    eirp = _checked_eirp(eirp_dbm)
    if quantity not in (None, "power", "gain", "loss"):
        raise InputError(
            f"quantity is 'power', 'gain' or 'loss', got {quantity!r}; leave it out to tell it "
            "from the column's name"
        )
    with _opened(path, max_bytes) as file:
        try:
            found = _read(file, path.name, columns or {}, where or {}, skip_bad)
        except UnicodeDecodeError as error:
            raise InputError(
                f"{path.name} is not UTF-8 text (byte 0x{error.object[error.start]:02x}); save it "
                "as CSV in UTF-8"
            ) from error
        except csv.Error as error:
            raise InputError(
                f"{path.name} is no readable CSV ({error}); check for a quotation mark that is "
                "never closed"
            ) from error
    names = found["columns"]
    level, kind = _as_gain(
        found.pop("level"),
        quantity or level_quantity(names["level"]),
        names["level"],
        eirp,
        path.name,
    )
    position = np.column_stack([found.pop("first"), found.pop("second")])
    geographic = "latitude" in names
    return Recording(
        level_db=level,
        quantity=kind,
        source=path.name,
        latlon=position if geographic else None,
        xy_m=None if geographic else position,
        crs=_checked_crs(crs, geographic, path.name),
        **found,
    )


def _opened(path: Path, max_bytes: int) -> Any:
    """The file as text, once its size and first bytes look like a CSV file's."""
    if not path.is_file():
        raise InputError(f"no file {str(path)!r}; give the path of a CSV file")
    try:
        size = path.stat().st_size
        with path.open("rb") as raw:
            head = raw.read(65536)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if size > max_bytes:
        raise InputError(
            f"{path.name} has {size / 1e6:,.0f} MB, more than {max_bytes / 1e6:,.0f} MB; split it, "
            "or raise max_bytes"
        )
    if not head.strip():
        raise InputError(
            f"{path.name} is empty; expected a line of column names and one line per reading"
        )
    if head.startswith(_UTF16_MARKS):
        raise InputError(f"{path.name} is UTF-16 text; save it as CSV in UTF-8")
    if b"\0" in head:
        raise InputError(
            f"{path.name} is not text (a spreadsheet or an archive?); export the sheet as CSV in "
            "UTF-8"
        )
    return path.open(encoding="utf-8-sig", newline="")


def _rows(file: Any) -> Iterator[tuple[int, list[str], str]]:
    """(line number, fields, delimiter) of each line that is not empty, the header first."""
    header = ""
    before = 0
    for header in file:
        before += 1
        if header.strip():
            break
    delimiter = max(",;\t", key=lambda d: len(next(csv.reader([header], delimiter=d), [])))
    yield before, next(csv.reader([header], delimiter=delimiter)), delimiter
    reader = csv.reader(file, delimiter=delimiter)
    for row in reader:
        if any(text.strip() for text in row):
            yield before + reader.line_num, row, delimiter


def _number(text: str, decimal_comma: bool) -> float:
    """The number a field holds; NaN when it holds none."""
    try:
        return float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        return math.nan


def _read(
    file: Any, name: str, columns: Mapping[str, str], where: Mapping[str, Any], skip_bad: bool
) -> dict[str, Any]:
    """The columns of a recording as arrays; the level as it stands in the file, the position as
    ``first`` and ``second``."""
    rows = _rows(file)
    _, header, delimiter = next(rows)
    header = [text.strip() for text in header]
    if len(header) < 3:
        raise InputError(
            f"the first line of {name} has {len(header)} column(s), "
            f"{', '.join(repr(h[:40]) for h in header)}; expected the "
            "names of at least three (two for the position, one for the level), split by commas, "
            "semicolons or tabs"
        )
    if all(math.isfinite(_number(text, delimiter != ",")) for text in header):
        raise InputError(
            f"the first line of {name} holds numbers; put a line of column names, such as "
            "latitude,longitude,rsrp, above it"
        )
    index = find_columns(header, columns)
    wanted = {
        named_column(header, column, "filter"): str(value).strip()
        for column, value in where.items()
    }
    first, second = ("latitude", "longitude") if "latitude" in index else ("x", "y")
    kept: dict[str, list[Any]] = {
        role: [] for role in (first, second, "level", "noise", "censored", "time", "line")
    }
    seen: dict[int, set[str]] = {i: set() for i in wanted}
    read, skipped, complaint = 0, 0, ""
    for line, row, _ in rows:
        read += 1
        if not _matches(row, wanted, seen):
            continue
        values, problem = _parsed(row, header, index, delimiter != ",", (first, second))
        if problem:
            complaint = complaint or f"{name} line {line}: {problem}"
            if not skip_bad:
                raise InputError(
                    f"{complaint}; mend or delete the line, or skip bad lines (skip_bad)"
                )
            skipped += 1
            continue
        for role, value in values.items():
            kept[role].append(value)
        kept["line"].append(line)
    if not kept["line"]:
        raise InputError(_nothing_read(name, header, read, skipped, complaint, wanted, seen))
    time_s = (
        _seconds(kept["time"], header[index["time"]], explicit="time" in columns)
        if "time" in index
        else None
    )
    if time_s is None:
        index.pop("time", None)
    return {
        "level": np.array(kept["level"]),
        "first": np.array(kept[first]),
        "second": np.array(kept[second]),
        "noise_std_db": np.array(kept["noise"]) if "noise" in index else None,
        "censored": np.array(kept["censored"], dtype=bool) if "censored" in index else None,
        "time_s": time_s,
        "line": np.array(kept["line"], dtype=np.int64),
        "columns": {role: header[i] for role, i in index.items()},
        "skipped": skipped,
    }


def _matches(row: Sequence[str], wanted: Mapping[int, str], seen: Mapping[int, set[str]]) -> bool:
    """Whether a line passes the filter; remembers a few values met, for the message when none
    does."""
    passes = True
    for i, value in wanted.items():
        text = row[i].strip() if i < len(row) else ""
        if len(seen[i]) < 12:
            seen[i].add(text)
        passes &= text == value
    return passes


def _parsed(
    row: Sequence[str],
    header: Sequence[str],
    index: Mapping[str, int],
    decimal_comma: bool,
    pair: tuple[str, str],
) -> tuple[dict[str, Any], str]:
    """What a line says for each role, and what is wrong with it (empty if nothing)."""
    if any(text.strip() for text in row[len(header) :]):
        return {}, f"has {len(row)} fields, the first line has {len(header)}"
    values: dict[str, Any] = {}
    for role, i in index.items():
        text = row[i].strip() if i < len(row) else ""
        what = f"the {role} ({header[i]}) is"
        if role == "time":
            values[role] = text
        elif role == "censored":
            if text.casefold() not in _TRUE | _FALSE:
                return {}, f"{what} {text[:40]!r}, expected 0 or 1"
            values[role] = text.casefold() in _TRUE
        else:
            values[role] = _number(text, decimal_comma)
            if not math.isfinite(values[role]):
                return {}, f"{what} {text[:40]!r}, expected a finite number"
    if abs(values["level"]) > MAX_LEVEL_DB:
        return (
            {},
            f"the level ({header[index['level']]}) is {values['level']:g} dB, beyond anything a "
            "receiver reports",
        )
    if "noise" in values and not 0 <= values["noise"] <= MAX_LEVEL_DB:
        return {}, f"the noise is {values['noise']:g} dB, expected a standard deviation from 0"
    return values, _position_problem(values[pair[0]], values[pair[1]]) if pair[
        0
    ] == "latitude" else ""


def _position_problem(latitude: float, longitude: float) -> str:
    """What is wrong with a position in degrees, empty if nothing."""
    if abs(latitude) > 90:
        if abs(longitude) <= 90 and abs(latitude) <= 180:
            return (
                f"the latitude is {latitude:g}, beyond 90 degrees, so latitude and longitude look "
                "swapped"
            )
        return f"the latitude is {latitude:g}, expected −90 to 90 degrees"
    if not -180 <= longitude <= 360:
        return f"the longitude is {longitude:g}, expected −180 to 180 degrees"
    if latitude == 0 and longitude == 0:
        return "the position is 0, 0, which a receiver writes before it knows where it is"
    return ""


def _nothing_read(
    name: str,
    header: Sequence[str],
    read: int,
    skipped: int,
    complaint: str,
    wanted: Mapping[int, str],
    seen: Mapping[int, set[str]],
) -> str:
    """Why a file gave no reading at all."""
    if read == 0:
        return f"{name} holds a header but no readings; expected one line per reading below it"
    if skipped:
        return f"all {skipped} lines of {name} are bad, the first because: {complaint}"
    filters = " and ".join(f"{header[i]}={value}" for i, value in wanted.items())
    values = "; ".join(
        f"{header[i]} has {', '.join(repr(v[:40]) for v in sorted(seen[i]))}" for i in wanted
    )
    more = " …" if any(len(met) >= 12 for met in seen.values()) else ""
    return f"no line of {name} has {filters}; choose other values ({values}{more})"


def _as_gain(
    level: NDArray[np.float64], kind: str, column: str, eirp_dbm: float | None, name: str
) -> tuple[NDArray[np.float64], str]:
    """The level with its sign and reference put right, and whether it is now a ``"gain"`` or still
    a ``"power"``."""
    if kind == "power":
        if level.min() > _STRONGEST_POWER_DBM:
            raise InputError(
                f"{name}: column {column!r} as power is at least {level.min():+g} dBm, which no "
                "receiver survives; if it is a "
                "loss in dB, say quantity='loss'; if it is an index such as ASU, or has lost its "
                "minus sign, convert it to dBm"
            )
        return (level, "power") if eirp_dbm is None else (level - eirp_dbm, "gain")
    if eirp_dbm is not None:
        raise InputError(
            f"{name}: column {column!r} is a {kind} in dB, which has no EIRP to take off; leave "
            "the EIRP out"
        )
    if kind == "loss":
        if level.min() < 0:
            raise InputError(
                f"{name}: column {column!r} as loss should be positive dB, but holds "
                f"{level.min():g}; "
                "if it is a gain, say quantity='gain'"
            )
        return 0.0 - level, "gain"
    if level.min() > 0:
        raise InputError(
            f"{name}: column {column!r} as gain should be negative dB, but is at least "
            f"{level.min():g}; "
            "if it is a loss, say quantity='loss'"
        )
    return level, "gain"


def _checked_eirp(eirp_dbm: float | None) -> float | None:
    if eirp_dbm is not None and not (math.isfinite(eirp_dbm) and abs(eirp_dbm) <= MAX_LEVEL_DB):
        raise InputError(f"eirp_dbm must be a power in dBm, got {eirp_dbm}; 47 is 50 W")
    return eirp_dbm


def _checked_crs(crs: str | None, geographic: bool, name: str) -> str | None:
    """The text of a projected CRS in metres for x and y, or ``None``."""
    parsed = parse_crs(crs)
    if parsed is None:
        return None
    if geographic:
        if parsed.to_epsg() == 4326:
            return None
        raise InputError(
            f"{name} has latitudes and longitudes, which are taken as WGS 84; leave the CRS "
            f"{crs!r} out, or name x and y columns"
        )
    if parsed.is_geographic:
        raise InputError(
            f"{crs!r} is in degrees, but {name} is read by x and y; name its columns as latitude "
            "and longitude"
        )
    if not parsed.is_projected or any(axis.unit_name != "metre" for axis in parsed.axis_info):
        raise InputError(
            f"{crs!r} is not a projection in metres; give one for x and y, e.g. 'EPSG:32617'"
        )
    return crs


def _seconds(texts: Sequence[str], column: str, *, explicit: bool) -> NDArray[np.float64] | None:
    """Seconds since the earliest, from numbers (milliseconds by name or size) or ISO 8601; ``None``
    if a guess cannot be read."""
    numbers = np.array([_number(text, False) for text in texts])
    if (np.abs(numbers) < 1e15).all():  # NaN, where a text is no number, fails this too
        # Seconds since 1970 reach 1e11 in the year 5138.
        in_ms = column.casefold().endswith(("ms", "millis")) or numbers.min() > 1e11
        return (numbers - numbers.min()) / (1000.0 if in_ms else 1.0)
    try:
        moments = [datetime.fromisoformat(text) for text in texts]
        earliest = min(moments)
        return np.array([(moment - earliest).total_seconds() for moment in moments])
    except (ValueError, TypeError) as error:
        if explicit:
            raise InputError(
                f"column {column!r} is not time: expected seconds or ISO 8601, such as "
                f"2024-05-01T12:00:00Z ({error})"
            ) from error
        return None
