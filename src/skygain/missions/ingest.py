"""Readings of a flight taken into the mission: checked, matched to sortie and UAV, kept once."""

from __future__ import annotations

__all__ = ["Intake", "Taken", "dated", "take_in"]

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skygain.frames import parse_crs
from skygain.ground.errors import InputError, require
from skygain.ground.files import file_digest
from skygain.instruments.columns import find_columns
from skygain.instruments.formats import open_table
from skygain.instruments.gridded import on_grid
from skygain.instruments.reading import MAX_BYTES, read_recording
from skygain.instruments.recording import Recording
from skygain.missions.folder import Mission
from skygain.missions.journal import Reading
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie
from skygain.missions.state import quantity_of

NEAR_M = 12.0
"""a reading so near to a planned leg, or two cells, was taken on it"""
_EARLY_S = 1800.0
"""clocks may be off by so much against the moment of the plan"""
_OWN = 0.6
"""a log with this share of its readings along one flight is that UAV's"""
_PACE_S = 60.0
"""a time off by so much counts as much as a reading off by `NEAR_M`"""


@dataclass(frozen=True)
class Taken:
    """What came of one log."""

    name: str
    """of the file"""
    readings: int
    """in it"""
    new: int
    """of these, not known before"""
    matched: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """how many fit each (sortie, UAV); those under (…, -1) were taken elsewhere"""
    notes: tuple[str, ...] = ()
    """what was assumed"""

    def __str__(self) -> str:
        parts = [
            f"sortie {sortie}, " + (f"UAV {uav}" if uav >= 0 else "elsewhere") + f": {count}"
            for (sortie, uav), count in sorted(self.matched.items())
        ]
        shown = "; ".join(parts)
        return f"{self.name}: {self.readings} readings, {self.new} new; {shown}"


@dataclass(frozen=True)
class Intake:
    """What came of all logs."""

    logs: tuple[Taken, ...]
    """one for each"""

    @property
    def new(self) -> int:
        """Readings that were not known before."""
        return sum(one.new for one in self.logs)


def take_in(
    mission: Mission,
    files: Sequence[Path],
    options: Mapping[str, Any] | None = None,
    shift_hours: float = 0.0,
) -> Intake:
    """Read every log, check it against the mission, and only then keep all of them.

    Args:
        mission: open for writing.
        files: the logs.
        options: of `skygain.instruments.read_recording`.
        shift_hours: added to the logs' times.

    Raises:
        InputError: a log cannot be read, is of another place or another quantity, or its clock is
            off; nothing is kept then.
    """
    sorties = mission.sorties()
    if not sorties:
        raise InputError(
            f"nothing is planned in {mission.folder} yet; plan first with: skygain mission plan"
        )
    known = quantity_of(mission.journal)
    prepared = []
    for path in files:
        recording = _read(path, dict(options or {}))
        known = _same_quantity(known, recording)
        recording = _placed(recording, mission.site)
        told = on_grid(recording, mission.site.grid).notes
        began_s = _began(recording, mission, shift_hours)
        prepared.append((path, recording, began_s, told))
    logs = []
    for path, recording, began_s, told in prepared:
        readings, matched = _matched(mission.site, sorties, recording, began_s)
        body = {
            "file": path.name,
            "digest": file_digest(path),
            "quantity": recording.quantity,
            "matched": [[sortie, uav, n] for (sortie, uav), n in sorted(matched.items())],
        }
        new = mission.journal.take_in("ingested", body, readings)
        logs.append(Taken(path.name, len(readings), new, matched, tuple(told)))
    return Intake(tuple(logs))


def _read(path: Path, options: dict[str, Any]) -> Recording:
    """The log; altitudes of climb and landing are no reason to refuse it."""
    table = open_table(path, MAX_BYTES, options.get("columns", {}).get("level"))
    named = dict(options.get("columns") or {})
    named = {k: v for k, v in named.items() if not (k == "level" and "level" in table.roles)}
    index, _ = find_columns(table.header, named, table.roles)
    where = dict(options.get("where") or {})
    if "altitude" in index and not any("alt" in name.casefold() for name in where):
        where[table.header[index["altitude"]]] = "*"
    return read_recording(path, **{**options, "where": where})


def _same_quantity(known: str | None, recording: Recording) -> str:
    if known is not None and recording.quantity != known:
        raise InputError(
            f"{recording.source} holds {recording.quantity}, the mission's readings are "
            f"{known}; give `eirp_dbm` to turn power into gain, or `quantity`"
        )
    return recording.quantity


def _placed(recording: Recording, site: Site) -> Recording:
    """The recording with latitudes and longitudes."""
    if recording.latlon is not None:
        return recording
    assert recording.xy_m is not None
    if recording.crs is None:
        raise InputError(
            f"{recording.source} is in metres of a frame of its own; say which with "
            f"`recording_crs`, e.g. `recording_crs={site.grid.crs}`"
        )
    pyproj = require("pyproj", "geo")
    move = pyproj.Transformer.from_crs(parse_crs(recording.crs), "EPSG:4326", always_xy=True)
    lon, lat = move.transform(*recording.xy_m.T)
    return replace(recording, xy_m=None, crs=None, latlon=np.column_stack([lat, lon]))


def _began(recording: Recording, mission: Mission, shift_hours: float) -> float | None:
    """When the log's first reading was taken, if it says.

    Raises:
        InputError: before anything was planned, or later than now.
    """
    if recording.began_s is None or recording.time_s is None:
        return None
    began = recording.began_s + 3600.0 * shift_hours
    planned = datetime.fromisoformat(mission.journal.events("planned")[0]["time"]).timestamp()
    dated(recording.source, began, began + float(recording.time_s.max()), planned, shift_hours)
    return began


def dated(
    source: str, began: float, ended: float, planned: float, shift_hours: float | None
) -> None:
    """Readings from ``began`` to ``ended``, in seconds since 1970, may be this mission's.

    Args:
        source: what they came with.
        began: the first.
        ended: the last.
        planned: when the mission's first sortie was.
        shift_hours: what their times were shifted by; ``None`` where they cannot be.

    Raises:
        InputError: before anything was planned, or later than now.
    """
    now = time.time()
    if planned - _EARLY_S <= began and ended <= now + _EARLY_S:
        return
    off = began - planned if began < planned - _EARLY_S else ended - now
    hours = abs(off) / 3600.0
    shown = f"{hours:.1f} h" if hours < 72 else f"{hours / 24:.0f} days"
    side = "before the first plan was made" if off < 0 else "after now"
    first = datetime.fromtimestamp(began, UTC).strftime("%Y-%m-%d %H:%M UTC")
    told = f"{source} is dated {shown} {side} (first reading {first})"
    if shift_hours is None:
        raise InputError(f"{told}, so it is of another mission or the sender's clock is off")
    mend = math.ceil(hours - _EARLY_S / 3600.0) * (1 if off < 0 else -1)
    raise InputError(
        f"{told}, so it is of another mission or its clock is off; if it is of this one, give "
        f"`shift_hours={shift_hours + mend:g}`"
    )


def _matched(
    site: Site, sorties: Sequence[Sortie], recording: Recording, began_s: float | None
) -> tuple[list[Reading], dict[tuple[int, int], int]]:
    """The readings with their sortie and UAV, and how many fit each."""
    assert recording.latlon is not None
    xy = site.grid.xy_m_at_latlon(recording.latlon)
    flights = [(sortie.number, flight) for sortie in sorties for flight in sortie.flights]
    cost = np.stack([_cost(site, flight, xy, recording.time_s) for _, flight in flights])
    best = cost.argmin(axis=0)
    near = np.isfinite(cost).any(axis=0)
    # a log is mostly one UAV's, and paths cross
    shares = np.isfinite(cost).mean(axis=1)
    total = np.where(np.isfinite(cost), cost, 4.0).sum(axis=1)
    own = int(np.lexsort((total, -np.round(shares, 1)))[0])
    if shares[own] >= _OWN:
        best = np.where(np.isfinite(cost[own]), own, best)
    number = np.array([n for n, _ in flights])[best]
    uav = np.where(near, np.array([f.uav for _, f in flights])[best], -1)
    elsewhere = flights[own][0] if shares[own] > 0 else sorties[-1].number
    number = np.where(near, number, elsewhere)
    times = None
    if recording.time_s is not None:
        times = recording.time_s + (began_s or 0.0)
    noise, floor = recording.noise_std_db, recording.censored
    readings = [
        Reading(
            float(recording.latlon[k, 0]),
            float(recording.latlon[k, 1]),
            float(recording.level_db[k]),
            None if noise is None else float(noise[k]),
            bool(floor is not None and floor[k]),
            None if times is None else float(times[k]),
            int(number[k]),
            int(uav[k]),
            recording.source,
        )
        for k in range(len(recording))
    ]
    pairs, count = np.unique(np.column_stack([number, uav]), axis=0, return_counts=True)
    matched = {(int(a), int(b)): int(n) for (a, b), n in zip(pairs, count, strict=True)}
    return readings, matched


def _cost(
    site: Site, flight: Flight, xy_m: NDArray[np.float64], time_s: NDArray | None
) -> NDArray[np.float64]:
    """How badly each reading fits a flight, by place and by pace; infinite off its legs."""
    ticks = flight.timeline.ticks_m
    moments = np.flatnonzero(np.isfinite(ticks[:, 0]))
    reach = max(NEAR_M, 2 * site.grid.spacing_m)
    tree = cKDTree(ticks[moments, :2])
    if time_s is None:
        distance, _ = tree.query(xy_m)
        return np.where(distance <= reach, distance / reach, np.inf)
    distance, at = tree.query(xy_m)
    inside = distance <= reach
    if not inside.any():
        return np.full(len(xy_m), np.inf)
    planned = moments[at] * 0.25
    late = time_s - planned
    late = np.abs(late - np.median(late[inside]))
    return np.where(inside, distance / reach + np.minimum(late / _PACE_S, 2.0), np.inf)
