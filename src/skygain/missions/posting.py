"""Readings that a companion computer posts: checked, and kept before they are acknowledged.

A post is taken whole or refused whole, in one line that says why. The same reading posted twice
counts once, so a sender that heard no answer posts again. One thread writes what waits, all of it
in one transaction; where more waits than is held, a post is refused with the advice to come again.
"""

from __future__ import annotations

__all__ = ["MOST_BYTES", "MOST_READINGS", "BusyError", "Posts", "Wanted", "posted_readings"]

import contextlib
import csv
import io
import json
import math
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from skygain.grid import Grid
from skygain.ground.errors import InputError, did_you_mean
from skygain.missions.folder import Mission
from skygain.missions.ingest import dated
from skygain.missions.journal import POSTED, Journal, Reading, Stream
from skygain.missions.site import Site
from skygain.missions.state import quantity_of

MOST_BYTES = 2_000_000
"""largest post"""
MOST_READINGS = 10_000
"""of one post"""
_MOST_WAITING = 50_000
_LOWEST_DB, _HIGHEST_DB = -250.0, 60.0
_NEEDED = ("time", "latitude", "longitude", "level")
_OPTIONAL = ("uav", "noise_std_db")


class BusyError(Exception):
    """More readings wait than are held."""


@dataclass(frozen=True)
class Wanted:
    """What posts have to fit."""

    sortie: int
    """number of the newest sortie, to which they are counted"""
    planned_s: float
    """when the first was planned, in seconds since 1970"""
    uavs: int
    """how many UAVs there are"""
    grid: Grid
    """the map"""

    @classmethod
    def by(cls, mission: Mission, site: Site) -> Wanted:
        """What a mission wants now.

        Raises:
            InputError: nothing is planned yet, or its readings are gains.
        """
        planned = mission.journal.events("planned")
        if not planned:
            raise InputError(
                f"nothing is planned in {mission.folder} yet; plan first with: skygain mission plan"
            )
        if quantity_of(mission.journal) == "gain":
            raise InputError("the mission's readings are gains in dB, and a post holds dBm")
        first = datetime.fromisoformat(planned[0]["time"]).timestamp()
        return cls(planned[-1]["sortie"]["number"], first, len(site.pads), site.grid)


def posted_readings(body: bytes, kind: str, wanted: Wanted) -> list[Reading]:
    """The readings of one post, of the newest sortie.

    Args:
        body: JSON (one reading, a list, or ``{"uav": …, "readings": […]}``) or CSV with a header.
        kind: its media type.
        wanted: what they have to fit.

    Raises:
        InputError: the first thing that is wrong, with the number of the reading.
    """
    try:
        text = body.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("the post is not UTF-8; send JSON or CSV as UTF-8") from None
    rows = _of_csv(text) if "csv" in kind else _of_json(text)
    if len(rows) > MOST_READINGS:
        raise InputError(
            f"{len(rows)} readings in one post; send at most {MOST_READINGS}, or give the file to "
            "skygain mission ingest"
        )
    found = [_reading(row, number, wanted) for number, row in enumerate(rows, start=1)]
    if found:
        _check(found, wanted)
    return found


def _of_json(text: str) -> list[Mapping[str, Any]]:
    try:
        told = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"the post is no JSON ({error}); send readings as JSON or CSV") from None
    shared: dict[str, Any] = {}
    if isinstance(told, dict) and "readings" in told:
        shared = {key: value for key, value in told.items() if key != "readings"}
        told = told["readings"]
    rows = told if isinstance(told, list) else [told]
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, dict):
            raise InputError(f"reading {number} must be an object with {_names()}, got {row!r:.40}")
    return [{**shared, **row} for row in rows]


def _of_csv(text: str) -> list[Mapping[str, Any]]:
    lines = csv.DictReader(io.StringIO(text), skipinitialspace=True)
    return [{key: value for key, value in row.items() if value not in ("", None)} for row in lines]


def _names() -> str:
    return f"{', '.join(_NEEDED[:-1])} and {_NEEDED[-1]}"


def _reading(row: Mapping[str, Any], number: int, wanted: Wanted) -> Reading:
    for name in row:
        if name not in (*_NEEDED, *_OPTIONAL):
            hint = did_you_mean(str(name), (*_NEEDED, *_OPTIONAL))
            raise InputError(f"reading {number} has an unknown {str(name)[:40]!r}; {hint}")
    for name in _NEEDED:
        if name not in row:
            raise InputError(f"reading {number} has no {name}; each has {_names()}")
    uav = _number(row, "uav", number, -1, wanted.uavs - 1) if "uav" in row else -1
    if uav != int(uav):
        raise InputError(f"uav of reading {number} must be a whole number, got {uav:g}")
    noise = _number(row, "noise_std_db", number, 0, 60) if "noise_std_db" in row else None
    return Reading(
        round(_number(row, "latitude", number, -90, 90), 8),
        round(_number(row, "longitude", number, -180, 180), 8),
        _number(row, "level", number, _LOWEST_DB, _HIGHEST_DB),
        noise,
        False,
        _moment(row["time"], number),
        wanted.sortie,
        int(uav),
        f"posted, UAV {int(uav)}" if uav >= 0 else "posted",
    )


def _number(row: Mapping[str, Any], name: str, number: int, low: float, high: float) -> float:
    try:
        if isinstance(row[name], bool):
            raise TypeError
        value = float(row[name])
    except (TypeError, ValueError):
        value = math.nan
    if not low <= value <= high:
        raise InputError(
            f"{name} of reading {number} must be a number from {low:g} to {high:g}, got "
            f"{row[name]!r:.40}"
        )
    return value


def _moment(told: Any, number: int) -> float:
    """Seconds since 1970."""
    with contextlib.suppress(TypeError, ValueError):
        value = float(told) if not isinstance(told, bool) else math.nan
        if math.isfinite(value):
            return value
    with contextlib.suppress(TypeError, ValueError):
        moment = datetime.fromisoformat(told)
        if moment.tzinfo is not None:
            return moment.timestamp()
    raise InputError(
        f"time of reading {number} must be seconds since 1970, or ISO 8601 with a zone such as "
        f"2026-05-06T09:00:03Z, got {told!r:.40}"
    )


def _check(found: Sequence[Reading], wanted: Wanted) -> None:
    """The readings belong to this mission.

    Raises:
        InputError: their clock is off, or their place.
    """
    moments = [r.time_s for r in found if r.time_s is not None]
    dated("the post", min(moments), max(moments), wanted.planned_s, None)
    places = np.array([(r.latitude, r.longitude) for r in found])
    if not wanted.grid.contains(wanted.grid.cells_at_latlon(places)).any():
        raise InputError(
            f"all {len(found)} readings of the post lie off the map, so they are of another mission"
        )


class Posts:
    """What waits to be written, and the thread that writes it; use it as a context manager.

    Args:
        path: the journal.
        most: so many readings may wait.
    """

    def __init__(self, path: Path, most: int = _MOST_WAITING) -> None:
        self._path, self._most = path, most
        self._waiting: deque[tuple[Sequence[Reading], Future[int]]] = deque()
        self._held = 0
        self._change = threading.Condition()
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Posts:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._change:
            self._over = True
            self._change.notify()
        self._thread.join()

    def add(self, readings: Sequence[Reading]) -> Future[int]:
        """Have them written; the answer, once they are on the disk, is how many were new.

        Raises:
            BusyError: too many wait.
        """
        done: Future[int] = Future()
        with self._change:
            if self._over or self._held + len(readings) > self._most:
                raise BusyError
            self._held += len(readings)
            self._waiting.append((readings, done))
            self._change.notify()
        return done

    def _lots(self) -> Iterator[list[tuple[Sequence[Reading], Future[int]]]]:
        while True:
            with self._change:
                while not self._waiting and not self._over:
                    self._change.wait()
                lots = list(self._waiting)
                self._waiting.clear()
            if not lots:
                return
            yield lots
            with self._change:
                self._held -= sum(len(readings) for readings, _ in lots)

    def _run(self) -> None:
        with Journal(self._path) as journal:
            body = {"file": POSTED, "quantity": "power", "matched": []}
            stream = Stream(journal, body)
            for lots in self._lots():
                try:
                    counts = stream.take_in_all([readings for readings, _ in lots])
                except InputError as error:
                    for _, done in lots:
                        done.set_exception(error)
                else:
                    for (_, done), count in zip(lots, counts, strict=True):
                        done.set_result(count)
