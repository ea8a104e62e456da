"""Flight logs: PX4 ``.ulg``, ArduPilot ``.bin`` and MAVLink ``.tlog``.

One message gives the level, any numeric field of it, and another the position, which is brought to
the moments of the level by linear interpolation.
"""

from __future__ import annotations

__all__ = ["LOG_SUFFIXES", "open_flight_log"]

import contextlib
import io
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError, require
from skygain.instruments import cellular
from skygain.instruments.points import table_of
from skygain.instruments.tables import Table, quoted_list

_ENDLESS = re.compile(rb"\xa3\x95\x80.[\x00-\x02]", re.DOTALL)
"""a description of a message of no length, at which a reader would stand still"""

Message: TypeAlias = dict[str, NDArray]
"""the numeric fields of a message, each ``[n]``, and its ``time_s``"""

LOG_SUFFIXES = (".ulg", ".bin", ".tlog")
"""endings of the files that are read as flight logs"""

_LONGEST_GAP_S = 5.0
"""no position is made up between fixes further apart than this"""
_CELLULAR = ("cellular_status",)
_CELL_LEVELS = ("rsrp", "rx_level", "rsrp_dbm")
_SIK = ("radio_status", "radio", "rad")
_LEVELS = re.compile(r"rssi|rsrp|rscp|rx_?level|signal|power_dbm|level", re.IGNORECASE)
_POSITIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]] = {
    "vehicle_global_position": (("lat",), ("lon",), ("alt",)),
    "global_position_int": (("lat",), ("lon",), ("relative_alt", "alt")),
    "pos": (("Lat",), ("Lng",), ("RelHomeAlt", "Alt")),
    "vehicle_gps_position": (
        ("latitude_deg", "lat"),
        ("longitude_deg", "lon"),
        ("altitude_msl_m", "alt"),
    ),
    "sensor_gps": (("latitude_deg", "lat"), ("longitude_deg", "lon"), ("altitude_msl_m", "alt")),
    "gps_raw_int": (("lat",), ("lon",), ("alt",)),
    "gps": (("Lat",), ("Lng",), ("Alt",)),
}
"""messages that hold a position, best first, and the names of its fields"""


def open_flight_log(path: Path, level: str | None) -> Table:
    """The level and position of a flight log as a table.

    Args:
        path: the log.
        level: ``MESSAGE.field`` that holds the level; ``CELLULAR_STATUS`` is found by itself.

    Raises:
        InputError: the log cannot be read, or holds no such field or no position.
    """
    messages = _ulg(path) if path.suffix.lower() == ".ulg" else _mavlink(path)
    name, field = _level_field(path.name, messages, level)
    values, notes = _level(name, field, messages[name])
    where = messages[name]["time_s"]
    lat, lon, alt, alt_name, source = _position(path.name, messages, where)
    placed = np.isfinite(lat)
    notes.append(f"positions from {source}, interpolated to the moments of {name}")
    if not placed.all():
        notes.append(
            f"{int((~placed).sum())} of {len(where)} levels left out: no position within "
            f"{_LONGEST_GAP_S:g} s"
        )
    if not placed.any():
        raise InputError(
            f"{path.name}: no position of {source} lies within {_LONGEST_GAP_S:g} s of a level of "
            f"{name}; check that the log holds a GPS fix"
        )
    shown = f"{name}.{field}"
    others = {f"{name}.{k}": v for k, v in messages[name].items() if k not in ("time_s", field)}
    columns = {
        "time": where,
        "latitude": lat,
        "longitude": lon,
        alt_name: alt,
        shown: values,
        **others,
    }
    columns = {k: v[placed] for k, v in columns.items()}
    roles = {"time": "time", "latitude": "latitude", "longitude": "longitude"}
    roles |= {"altitude": alt_name, "level": shown}
    found = table_of(path.name, columns, roles, notes=notes)
    return Table(found.name, found.header, found.load, roles, quantity="power", notes=found.notes)


def _level_field(file: str, messages: Mapping[str, Message], level: str | None) -> tuple[str, str]:
    """The message and field of the level."""
    fields = {
        f"{name}.{field}": (name, field)
        for name, message in messages.items()
        for field in message
        if field != "time_s"
    }
    if level is not None:
        for known, found in fields.items():
            if known.casefold() == level.strip().casefold():
                return found
    else:
        for known, found in fields.items():
            message, _, field = known.casefold().rpartition(".")
            if message.split("#")[0] in _CELLULAR and field in _CELL_LEVELS:
                return found
    likely = [known for known in fields if _LEVELS.search(known)]
    wrong = f"no field {level!r}" if level else "no CELLULAR_STATUS with a level"
    hint = (
        f"fields that may be one: {quoted_list(likely, 12)}"
        if likely
        else f"its messages are {quoted_list(list(messages), 20)}"
    )
    raise InputError(
        f"{file} holds {wrong}; name the level with `columns=level=MESSAGE.field`; {hint}"
    )


def _level(name: str, field: str, message: Message) -> tuple[NDArray[np.float64], list[str]]:
    """The level in dBm, NaN where it is marked invalid."""
    values, notes = np.array(message[field], dtype=np.float64), []
    plain = name.casefold().split("#")[0]
    if plain in _CELLULAR:
        values[values == 0] = np.nan
    if plain in _SIK and "rssi" in field.casefold() and np.nanmin(values) >= 0:
        values[values >= 255] = np.nan
        values = values / 1.9 - 127.0
        notes.append(f"{name}.{field} taken as the steps of a SiK radio: dBm = value / 1.9 − 127")
    return values, notes


def _position(
    file: str, messages: Mapping[str, Message], at: NDArray[np.float64]
) -> tuple[NDArray, NDArray, NDArray, str, str]:
    """Latitude, longitude and altitude at the moments ``at``, NaN where there is none near; the
    altitude's name and the message it comes from."""
    lower = {name.casefold(): name for name in messages}
    for known, fields in _POSITIONS.items():
        message = messages.get(lower.get(known, ""))
        if message is None:
            continue
        names = [next((f for f in options if f in message), None) for options in fields]
        if names[0] is None or names[1] is None:
            continue
        lat, lon = (_in_degrees(message[str(n)]) for n in names[:2])
        alt = message[names[2]] if names[2] else np.full(len(lat), np.nan)
        alt = alt / 1000.0 if known.endswith("_int") or alt.dtype.kind in "iu" else alt
        fixed = np.isfinite(lat) & np.isfinite(lon) & ((lat != 0) | (lon != 0))
        if not fixed.any():
            continue
        time, (lat, lon, alt) = message["time_s"][fixed], (v[fixed] for v in (lat, lon, alt))
        order = np.argsort(time, kind="stable")
        time = time[order]
        found = [np.interp(at, time, v[order]) for v in (lat, lon, alt)]
        after = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
        before = np.clip(after - 1, 0, None)
        inside = (at >= time[0]) & (at <= time[-1])
        near = np.where(
            inside,
            time[after] - time[before] <= _LONGEST_GAP_S,
            np.minimum(np.abs(at - time[0]), np.abs(at - time[-1])) <= _LONGEST_GAP_S / 2,
        )
        near |= np.minimum(np.abs(at - time[after]), np.abs(at - time[before])) < 1e-3
        relative = "rel" in str(names[2]).casefold()
        shown = "altitude_relative" if relative else "altitude"
        lat, lon, alt = (np.where(near, v, np.nan) for v in found)
        return lat, lon, alt, shown, lower[known]
    raise InputError(
        f"{file} holds no position with a fix; expected one of {quoted_list(list(_POSITIONS))}"
    )


def _in_degrees(values: NDArray) -> NDArray[np.float64]:
    """Degrees, from degrees or from steps of 1e-7 degrees."""
    degrees = np.array(values, dtype=np.float64)
    return (
        degrees / 1e7 if values.dtype.kind in "iu" or np.nanmax(np.abs(degrees)) > 360 else degrees
    )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The libraries print what they stumble over; a log that cannot be read is told in one line."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def _ulg(path: Path) -> dict[str, Message]:
    pyulog = require("pyulog", "logs")
    try:
        with _quiet():
            log = pyulog.ULog(str(path))
    except Exception as error:
        raise _unreadable(path, "PX4 log", error) from error
    messages: dict[str, Message] = {}
    for topic in log.data_list:
        stamp = topic.data.get("timestamp")
        if stamp is None or len(stamp) == 0:
            continue
        name = topic.name if topic.multi_id == 0 else f"{topic.name}#{topic.multi_id}"
        fields = {k: np.asarray(v) for k, v in topic.data.items() if k != "timestamp"}
        fields = {k: v for k, v in fields.items() if v.dtype.kind in "iuf"}
        if topic.name in _CELLULAR:
            fields = cellular.told(fields)
        messages[name] = fields | {"time_s": np.asarray(stamp, dtype=np.float64) / 1e6}
    return messages


def _mavlink(path: Path) -> dict[str, Message]:
    os.environ.setdefault("MAVLINK20", "1")
    mavutil = require("pymavlink.mavutil", "logs")
    rows: dict[str, list[tuple[float, dict[str, Any]]]] = {}
    try:
        with _quiet():
            log = (
                _dataflash(path)
                if path.suffix.lower() == ".bin"
                else mavutil.mavlink_connection(str(path), robust_parsing=True, dialect="all")
            )
            while (message := log.recv_match()) is not None:
                kind = message.get_type()
                if kind == cellular.MESSAGE:
                    values = cellular.decoded(bytes(message.data))
                    if values is not None:
                        stamp = float(message._timestamp)
                        rows.setdefault(cellular.NAME, []).append((stamp, values))
                elif kind not in ("BAD_DATA", "FMT", "PARM", "FMTU", "MULT", "UNIT", "MSG"):
                    values = message.to_dict()
                    rows.setdefault(kind, []).append((float(message._timestamp), values))
    except Exception as error:
        raise _unreadable(path, "ArduPilot or MAVLink log", error) from error
    if not rows:
        raise InputError(
            f"{path.name} holds no message of a flight log; expected .bin of ArduPilot, or .tlog "
            "of MAVLink"
        )
    return {kind: _fields(found) for kind, found in rows.items()}


def _dataflash(path: Path) -> Any:
    """A reader of ArduPilot's logs that gives up where a damaged one would keep it for ever."""
    from pymavlink.DFReader import DFReader_binary

    with path.open("rb") as raw:
        if _ENDLESS.search(raw.read(65536)):
            raise ValueError("it describes a message without a length")

    class Reader(DFReader_binary):  # type: ignore[misc, valid-type]
        def _parse_next(self) -> Any:
            before = self.offset
            message = super()._parse_next()
            if message is not None and self.offset <= before:
                raise ValueError(f"no message at byte {before}")
            return message

    return Reader(str(path))


def _fields(rows: list[tuple[float, dict[str, Any]]]) -> Message:
    """The numeric fields of messages of one kind."""
    names = [
        name
        for name, value in rows[0][1].items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    ]
    fields: Message = {"time_s": np.array([time for time, _ in rows])}
    for name in names:
        values = [row.get(name) for _, row in rows]
        if all(isinstance(v, int | float) for v in values):
            fields[name] = np.array(values)
    if "cell_tower_id" in rows[0][1]:
        towers = [str(row.get("cell_tower_id", "")) for _, row in rows]
        fields["cell_tower_id"] = np.array(towers, dtype=object)
    return fields


def _unreadable(path: Path, what: str, error: Exception) -> InputError:
    return InputError(
        f"{path.name} is no readable {what} ({type(error).__name__}: {str(error)[:80]}); check "
        "that it was copied whole"
    )
