"""From a log's file to a recording: opens it, tells its columns, and checks every place and level.

The reader is strict about what could silently spoil a map (a level that cannot be, several cells in
one log, a swapped latitude) and easy about the rest (delimiter, preamble, units, column names).
Whatever it mended, assumed or left out stands in `Recording.notes`. See docs/instruments.md.
"""

from __future__ import annotations

__all__ = ["MAX_BYTES", "read_recording", "read_series"]

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.instruments.columns import (
    column_for,
    find_columns,
    level_quantity,
    metres_each,
    series_columns,
)
from skygain.instruments.levels import MAX_LEVEL_DB, check_levels, in_dbm
from skygain.instruments.lines import Lines, keep_lines, nothing_left, too_many, without_empty
from skygain.instruments.placing import check_degrees, placed, rough_metres, turn_degrees
from skygain.instruments.recording import Recording
from skygain.instruments.selection import (
    conditions,
    nothing_passes,
    refuse_altitudes,
    refuse_series,
)
from skygain.instruments.tables import Table
from skygain.instruments.values import BAD, FINE, MISSING, degrees, numbers, pairs, seconds, texts

MAX_BYTES = 1_000_000_000
"""largest file read without being asked to; about 20 million readings"""

_TRUE, _FALSE = ("1", "true", "yes", "1.0"), ("", "0", "false", "no", "0.0")
_MOST_BAD, _FEW_BAD = 0.9, 5
"""a column with more fields, by share and number, that are not understood holds something else"""


def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    where: Mapping[str, Any] | None = None,
    quantity: str | None = None,
    eirp_dbm: float | None = None,
    recording_crs: str | None = None,
    skip_bad: bool = False,
    level_min_db: float | None = None,
    level_max_db: float | None = None,
    max_bytes: int = MAX_BYTES,
) -> Recording:
    """Read a campaign of one transmitter from a log.

    Text logs are split by commas, semicolons, tabs or bars, in UTF-8; a preamble, comment lines and
    a row of units are passed over, decimal commas are understood. Points are read from GeoPackage,
    GeoJSON, Shapefile, FlatGeobuf, KML and GPX, levels of flights from ``.ulg``, ``.bin`` and
    ``.tlog``, and those of Wireless InSite from ``.p2m``.

    Args:
        path: the file.
        columns: ``{role: column name}``, role one of `skygain.instruments.columns.ROLES`; other
            columns are guessed by name. For a flight log the level is ``MESSAGE.field``.
        where: ``{column name: value}``; only lines that have these values are read. A value is a
            text or number, a range ``low..high``, or ``*`` for any.
        quantity: what the level column holds: ``"power"`` in dBm, ``"gain"`` in dB (negative), or
            ``"loss"`` in dB (positive); told from the column's name when left out. A loss is turned
            into a gain.
        eirp_dbm: radiated power of the transmitter towards the receiver, antenna gains included;
            gain = power − EIRP. Without it a power stays a power.
        recording_crs: coordinate reference system of x and y, e.g. ``"EPSG:32617"``; ``"local"``
            says that they are metres in a frame of their own, as they are taken to be when left
            out.
        skip_bad: leave out lines that cannot be understood and count them, instead of refusing the
            file. Lines with a mark for no value are left out and counted in any case.
        level_min_db: lowest level to read, in place of what the quantity allows.
        level_max_db: highest level to read.
        max_bytes: refuse larger files.

    Raises:
        InputError: the file cannot be used, or holds several cells or altitudes; the message names
            the line or the columns.
    """
    limits = (level_min_db, level_max_db)
    ask = _Ask(
        columns or {}, where or {}, quantity, eirp_dbm, recording_crs, skip_bad, limits, max_bytes
    )
    return _read(Path(path), ask, None)[""]


def read_series(path: str | os.PathLike[str], by: str, **options: Any) -> dict[str, Recording]:
    """Read a log of several cells as one recording for each value of the column ``by``, the one
    with most readings first.

    Args:
        path: the file.
        by: the column, by its name or its role: ``pci`` finds ``Physical cell identity``.
        options: as for `read_recording`.

    Raises:
        InputError: as for `read_recording`; or there is no such column.
    """
    limits = (options.pop("level_min_db", None), options.pop("level_max_db", None))
    ask = _Ask(
        options.pop("columns", None) or {},
        options.pop("where", None) or {},
        options.pop("quantity", None),
        options.pop("eirp_dbm", None),
        options.pop("recording_crs", None),
        options.pop("skip_bad", False),
        limits,
        options.pop("max_bytes", MAX_BYTES),
    )
    if options:
        raise TypeError(f"unknown option {next(iter(options))!r}")
    return _read(Path(path), ask, by)


@dataclass(frozen=True)
class _Ask:
    """What a caller asked for; see `read_recording`."""

    columns: Mapping[str, str]
    where: Mapping[str, Any]
    quantity: str | None
    eirp_dbm: float | None
    crs: str | None
    skip_bad: bool
    limits: tuple[float | None, float | None]
    max_bytes: int

    def __post_init__(self) -> None:
        eirp = self.eirp_dbm
        if eirp is not None and not (math.isfinite(eirp) and abs(eirp) <= MAX_LEVEL_DB):
            raise InputError(f"`eirp_dbm` must be a power in dBm, got {eirp}; 47 is 50 W")
        if self.quantity not in (None, "power", "gain", "loss"):
            raise InputError(
                f"`quantity` is 'power', 'gain' or 'loss', got {self.quantity!r}; leave it out to "
                "tell it from the column's name"
            )
        low, high = (v if v is not None else d for v, d in zip(self.limits, (-1e9, 1e9),
                                                               strict=True))  # fmt: skip
        if not low <= high:
            raise InputError(
                f"`level_min_db` must be below `level_max_db`, got {low:g} and {high:g}"
            )


def _read(path: Path, ask: _Ask, by: str | None) -> dict[str, Recording]:
    """Recordings by the value of the column ``by``; of one signal, under an empty name, without
    it."""
    from skygain.instruments.formats import open_table

    table = open_table(path, ask.max_bytes, ask.columns.get("level"))
    named = {k: v for k, v in ask.columns.items() if not (k == "level" and "level" in table.roles)}
    index, open_roles = find_columns(table.header, named, table.roles)
    level_name = table.header[index["level"]]
    chosen = conditions(table.header, ask.where)
    series = series_columns(table.header, level_name)
    split = None if by is None else column_for(table.header, by, "series")
    needed = {*index.values(), *(c.column for c in chosen), *series}
    wanted = sorted(needed | ({split} if split is not None else set()))
    columns, line = table.load(wanted)
    lines = Lines(table.name, dict(zip(wanted, columns, strict=True)), line, ask.skip_bad)
    lines.notes += [*table.notes, *open_roles]
    read = without_empty(lines, index)
    if not read:
        raise InputError(
            f"{table.name} holds a header but no readings; expected one line per reading below it"
        )
    lines.keep(lines.bad(too_many(lines), lambda i: f"has more fields than the {len(table.header)}"
                         " column names"))  # fmt: skip
    before = dict(lines.columns)
    for condition in chosen:
        lines.keep(condition.holds(lines.columns[condition.column]))
    if chosen and not len(lines.line):
        raise nothing_passes(table.name, chosen, before)
    values = _values(lines, table, index, level_name, ask)
    settled = {c.column for c in chosen}
    place_m = rough_metres(values)
    if split is None:
        signals = {i: lines.columns[i] for i in series}
        lines.notes += refuse_series(table.name, table.header, signals, chosen, place_m)
    altitude = index.get("altitude")
    if altitude is not None and altitude not in settled and split != altitude:
        lines.notes += refuse_altitudes(
            table.name, table.header[altitude], values["altitude"], place_m
        )
    names = {role: table.header[i] for role, i in index.items() if role != "altitude"}
    whole = _recording(lines, values, names, table, ask)
    if split is None:
        return {"": whole}
    return _split(whole, texts(lines.columns[split]).astype(str), table.header[split])


def _split(whole: Recording, label: NDArray, column: str) -> dict[str, Recording]:
    labels, count = np.unique(label, return_counts=True)
    order = [i for i in np.argsort(-count, kind="stable") if labels[i] not in ("", "-")]
    if not order:
        raise InputError(
            f"{whole.source}: column {column!r} is empty in every line; choose another for `by`"
        )
    return {
        str(labels[i]): replace(
            whole.taken(label == labels[i]), source=f"{whole.source}, {column} {labels[i]}"
        )
        for i in order
    }


def _values(
    lines: Lines, table: Table, index: Mapping[str, int], level_name: str, ask: _Ask
) -> dict[str, Any]:
    """The checked values of each role, of the lines that remain."""
    header = table.header
    found: dict[str, Any] = {}

    def parsed(role: str, parse: Any) -> NDArray[np.int8]:
        values, kind = parse(lines.columns[index[role]])
        found[role] = values
        return kind

    def settle(role: str, kind: NDArray[np.int8]) -> None:
        column = lines.columns[index[role]]
        what = f"the {role} ({header[index[role]]})"
        lines.missing(kind == MISSING, what, column)
        wrong = int((kind == BAD).sum())
        if wrong > max(_FEW_BAD, _MOST_BAD * len(kind)) and not ask.skip_bad:
            first = str(column[np.flatnonzero(kind == BAD)[0]])[:40]
            raise InputError(
                f"{lines.name}: {what} holds no numbers but {first!r} and the like"
                f"{', per cent' if first.strip().endswith('%') else ''}; name another column with "
                f"`columns={role}=NAME`"
            )
        good = lines.bad(
            kind == BAD, lambda i: f"{what} is {str(column[i])[:40]!r}, expected a finite number"
        )
        keep = good & (kind == FINE)
        lines.keep(keep)
        for role_, values in found.items():
            found[role_] = values[keep]

    if "position" in index:
        latitude, longitude, kind = pairs(lines.columns[index["position"]])
        found |= {"latitude": latitude, "longitude": longitude}
        settle("position", kind)
    for role in ("latitude", "longitude"):
        if role in index:
            settle(role, parsed(role, degrees))
    for role in ("x", "y", "noise", "level"):
        if role in index:
            settle(role, parsed(role, numbers))
    for role in ("x", "y"):
        if role in found and metres_each(header[index[role]]) != 1.0:
            found[role] = found[role] * metres_each(header[index[role]])
            lines.notes.append(f"{role} (column {header[index[role]]!r}) is converted to metres")
    if "latitude" in found:
        turn_degrees(lines, found, index)
        check_degrees(lines, found)
    if "noise" in found:
        wrong = (found["noise"] < 0) | (found["noise"] > MAX_LEVEL_DB)
        keep = lines.bad(wrong, lambda i: f"the noise is {found['noise'][i]:g} dB, expected a "
                         "standard deviation from 0")  # fmt: skip
        keep_lines(lines, found, keep)
    if "censored" in index:
        flags = np.array([t.casefold() for t in texts(lines.columns[index["censored"]])])
        wrong = ~np.isin(flags, (*_TRUE, *_FALSE))
        keep = lines.bad(
            wrong,
            lambda i: (
                f"the censored ({header[index['censored']]}) is {flags[i][:40]!r}, expected 0 or 1"
            ),
        )
        found["censored"] = np.isin(flags, _TRUE)
        keep_lines(lines, found, keep)
    if not len(lines.line):
        raise InputError(nothing_left(lines))
    quantity = ask.quantity or table.quantity or level_quantity(level_name)
    if quantity == "power":
        found["level"], converted = in_dbm(found["level"], level_name, table.name)
        lines.notes += converted
        none = np.isnan(found["level"])
        lines.missing(none, f"the level ({level_name})", None)
        keep_lines(lines, found, ~none)
    wild = np.abs(found["level"]) > 1e6
    keep, told = check_levels(
        found["level"], quantity, level_name, table.name, lines.line, ask.limits
    ) if not wild.all() else (~wild, [])  # fmt: skip
    if not keep.any():
        raise InputError(nothing_left(lines) or f"{table.name} holds no level")
    lines.notes += told
    keep_lines(lines, found, keep)
    found["kind"] = quantity
    if "altitude" in index:
        found["altitude"] = numbers(lines.columns[index["altitude"]])[0]
    return found


def _recording(
    lines: Lines, values: dict[str, Any], names: dict[str, str], table: Table, ask: _Ask
) -> Recording:
    level, kind = _as_gain(values["level"], values["kind"], names["level"], ask, table.name)
    time_s = began_s = None
    if "time" in names:
        column = names["time"]
        time_s, began_s, why = seconds(lines.columns[list(table.header).index(column)], column)
        if time_s is None:
            if "time" in ask.columns:
                raise InputError(
                    f"column {column!r} is not time: expected seconds or ISO 8601, such as "
                    f"2024-05-01T12:00:00Z; {why}"
                )
            lines.notes.append(f"times are not used: column {column!r} is not understood ({why})")
            del names["time"]
    guessed = [f"{r} from {names[r]!r}" for r in names if r not in ask.columns]
    if guessed:
        lines.notes.insert(0, f"read as {values['kind']}: {', '.join(guessed)}")
    latlon, xy_m, crs = placed(values, names, table, ask.crs, lines.notes)
    if lines.skipped:
        lines.notes.append(
            f"{lines.skipped} lines that cannot be understood left out, as asked; the first: "
            f"{lines.complaint}"
        )
    return Recording(
        level_db=level,
        quantity=kind,
        source=table.name,
        latlon=latlon,
        xy_m=xy_m,
        crs=crs,
        time_s=time_s,
        began_s=began_s,
        noise_std_db=values.get("noise"),
        censored=values.get("censored"),
        line=lines.line,
        columns=names,
        skipped=lines.skipped,
        notes=tuple(lines.notes),
    )


def _as_gain(
    level: NDArray[np.float64], kind: str, column: str, ask: _Ask, name: str
) -> tuple[NDArray[np.float64], str]:
    """The level with its sign and reference put right, and whether it is now a ``"gain"`` or still
    a ``"power"``."""
    if kind == "power":
        eirp = ask.eirp_dbm
        return (level, "power") if eirp is None else (level - eirp, "gain")
    if ask.eirp_dbm is not None:
        raise InputError(
            f"{name}: column {column!r} is a {kind} in dB, which has no EIRP to take off; leave "
            "the EIRP out (`eirp_dbm`)"
        )
    return (0.0 - level if kind == "loss" else level), "gain"
