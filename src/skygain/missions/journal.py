"""Everything that happened in a mission, in one SQLite file that only grows.

Events (the request, plans, decisions) and readings are added and never changed; the database itself
refuses to change or delete them. A transaction is on the disk when it returns, whatever happens to
the process next. A reading is known by its content, so the same one given twice is kept once.
"""

from __future__ import annotations

__all__ = ["POSTED", "Journal", "Reading", "Stream"]

import contextlib
import hashlib
import json
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from skygain.ground.errors import InputError
from skygain.ground.strict_json import plain

POSTED = "posted"
"""the file that readings come from which a companion computer posted"""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS events (
    id INTEGER PRIMARY KEY, time TEXT NOT NULL, kind TEXT NOT NULL, body TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS readings (
    id INTEGER PRIMARY KEY, hash TEXT NOT NULL UNIQUE, event INTEGER NOT NULL,
    latitude REAL NOT NULL, longitude REAL NOT NULL, level_db REAL NOT NULL, noise_std_db REAL,
    censored INTEGER NOT NULL, time_s REAL, sortie INTEGER NOT NULL, uav INTEGER NOT NULL,
    source TEXT NOT NULL);
CREATE TRIGGER IF NOT EXISTS events_stay BEFORE UPDATE ON events
    BEGIN SELECT RAISE(ABORT, 'events are never changed'); END;
CREATE TRIGGER IF NOT EXISTS events_last BEFORE DELETE ON events
    BEGIN SELECT RAISE(ABORT, 'events are never deleted'); END;
CREATE TRIGGER IF NOT EXISTS readings_stay BEFORE UPDATE ON readings
    BEGIN SELECT RAISE(ABORT, 'readings are never changed'); END;
CREATE TRIGGER IF NOT EXISTS readings_last BEFORE DELETE ON readings
    BEGIN SELECT RAISE(ABORT, 'readings are never deleted'); END;
"""


@dataclass(frozen=True)
class Reading:
    """One reading as it was taken."""

    latitude: float
    """degrees, WGS 84"""
    longitude: float
    """degrees, WGS 84"""
    level_db: float
    """gain in dB or power in dBm"""
    noise_std_db: float | None
    """standard deviation of its noise, where it is known"""
    censored: bool
    """the receiver was at its floor"""
    time_s: float | None
    """seconds since 1970 where the log says so, else since the log's first reading"""
    sortie: int
    """number of the sortie it was taken in; 0 where it fits none"""
    uav: int
    """number of the UAV that took it; -1 where it fits none"""
    source: str
    """name of the log"""

    @property
    def hash(self) -> str:
        """What it says and when, which tells it from all others."""
        moment = "" if self.time_s is None else f"{self.time_s:.3f}"
        told = (
            f"{self.latitude:.8f} {self.longitude:.8f} {self.level_db:.4f} {self.noise_std_db} "
            f"{int(self.censored)} {moment}"
        )
        return hashlib.sha256(told.encode()).hexdigest()[:32]


class Journal:
    """The journal of one mission; use it as a context manager.

    Raises:
        InputError: the file is no journal, or cannot be opened.
    """

    def __init__(self, path: Path, *, create: bool = False) -> None:
        if not create and not path.is_file():
            raise InputError(f"{path.parent} holds no mission; begin one with: skygain mission new")
        self.path = path
        try:
            self._db = sqlite3.connect(path, timeout=10.0, isolation_level=None)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            if create:
                self._db.executescript(_SCHEMA)
            self._db.execute("SELECT 1 FROM events LIMIT 1")
        except sqlite3.Error as error:
            raise InputError(
                f"{path} is no journal of a mission ({error}); give another `folder`"
            ) from error

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()

    @contextlib.contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
        except sqlite3.OperationalError as error:
            with contextlib.suppress(sqlite3.Error):
                self._db.execute("ROLLBACK")
            raise InputError(
                f"cannot write {self.path}: {error}; nothing of this step was kept, give the "
                "command again"
            ) from error
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                self._db.execute("ROLLBACK")
            raise

    def add(self, kind: str, body: Mapping[str, Any]) -> int:
        """Add an event; returns its number."""
        with self._all_or_nothing():
            return self._event(kind, body)

    def _event(self, kind: str, body: Mapping[str, Any]) -> int:
        text = json.dumps(plain(dict(body)), allow_nan=False)
        row = (datetime.now(UTC).isoformat(timespec="milliseconds"), kind, text)
        done = self._db.execute("INSERT INTO events (time, kind, body) VALUES (?, ?, ?)", row)
        return int(done.lastrowid or 0)

    def take_in(self, kind: str, body: Mapping[str, Any], readings: Sequence[Reading]) -> int:
        """Add an event with the readings that came with it, all or none of them; returns how many
        were new. Where none is, no event is added."""
        return len(self._take_in(None, kind, body, readings)[1])

    def _take_in(
        self, event: int | None, kind: str, body: Mapping[str, Any], readings: Sequence[Reading]
    ) -> tuple[int | None, set[str]]:
        """The number of the event that the readings were added to, a new one without ``event``, and
        the hashes of those that were new."""
        names = ("hash", "event", *(f.name for f in fields(Reading)))
        marks = ", ".join("?" * len(names))
        with self._all_or_nothing():
            known = self.known([one.hash for one in readings])
            new = {one.hash: one for one in readings if one.hash not in known}
            if not new:
                return event, set()
            event = event or self._event(kind, body)
            self._db.executemany(
                f"INSERT INTO readings ({', '.join(names)}) VALUES ({marks})",
                [(key, event, *astuple(one)) for key, one in new.items()],
            )
            return event, set(new)

    def known(self, hashes: Sequence[str]) -> set[str]:
        """Those of ``hashes`` whose readings are kept already."""
        found: set[str] = set()
        for k in range(0, len(hashes), 500):
            some = list(hashes[k : k + 500])
            marks = ", ".join("?" * len(some))
            rows = self._db.execute(f"SELECT hash FROM readings WHERE hash IN ({marks})", some)
            found |= {row[0] for row in rows}
        return found

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        """Every event of these kinds, or all, in order, each with ``id``, ``time``, ``kind``."""
        some = f"WHERE kind IN ({', '.join('?' * len(kinds))})" if kinds else ""
        asked = f"SELECT id, time, kind, body FROM events {some} ORDER BY id"
        return [
            {**json.loads(body), "id": number, "time": when, "kind": kind}
            for number, when, kind, body in self._db.execute(asked, kinds)
        ]

    def readings(self, after: int = 0) -> list[Reading]:
        """Every reading in the order in which they came in, without the first ``after``."""
        names = ", ".join(f.name for f in fields(Reading))
        # readings are never deleted, so the ids of SQLite count them
        asked = f"SELECT {names} FROM readings WHERE id > ? ORDER BY id"
        rows = self._db.execute(asked, (after,))
        typed = ([*row[:4], bool(row[4]), *row[5:]] for row in rows)
        return [Reading(*values) for values in typed]

    def reading_events(self, after: int = 0) -> list[int]:
        """The number of the event that each reading came with, in the order of `readings`."""
        asked = "SELECT event FROM readings WHERE id > ? ORDER BY id"
        return [row[0] for row in self._db.execute(asked, (after,))]

    @property
    def count(self) -> int:
        """How many readings there are."""
        return int(self._db.execute("SELECT COALESCE(MAX(id), 0) FROM readings").fetchone()[0])

    def settled(self) -> None:
        """Bring everything into the one file, which may then be renamed."""
        self._db.execute("PRAGMA journal_mode = DELETE")

    @property
    def last(self) -> int:
        """Number of the newest event, 0 without any."""
        return int(self._db.execute("SELECT COALESCE(MAX(id), 0) FROM events").fetchone()[0])


class Stream:
    """Readings that come a few at a time: each lot is on the disk at once, and an event holds those
    of some seconds, so that a flight of hours stays a story that can be told.

    Args:
        journal: where they go.
        body: of the events.
        every_s: seconds of one event.
    """

    def __init__(self, journal: Journal, body: Mapping[str, Any], every_s: float = 5.0) -> None:
        self._journal, self._body, self._every_s = journal, dict(body), every_s
        self._event: int | None = None
        self._until_s = 0.0

    def take_in(self, readings: Sequence[Reading]) -> int:
        """Keep them, all or none; returns how many were new."""
        return self.take_in_all([readings])[0]

    def take_in_all(self, lots: Sequence[Sequence[Reading]]) -> list[int]:
        """Keep several lots, all or none; returns how many of each were new."""
        now = time.monotonic()
        event = self._event if now < self._until_s else None
        every = [reading for lot in lots for reading in lot]
        kept, new = self._journal._take_in(event, "ingested", self._body, every)
        if kept is not None and kept != event:
            self._event, self._until_s = kept, now + self._every_s
        counts = []
        for lot in lots:
            mine = {one.hash for one in lot} & new
            new -= mine
            counts.append(len(mine))
        return counts
