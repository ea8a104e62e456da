"""What the live page shows: the place once, then whatever the journal says, moment by moment."""

from __future__ import annotations

__all__ = ["Watched"]

import json
import threading
import time
from collections import Counter, OrderedDict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError, require
from skygain.missions.folder import Mission
from skygain.missions.posting import Wanted
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie
from skygain.missions.state import known_belief, quantity_of
from skygain.reports.pictures import uav_colours

_KEPT = 64
_PLAN_MOMENTS = 24
"""moments of the timeline that one sortie's flight is shown at"""
_STALE_S = 10.0
"""what a live flight said longer ago was said by one that died"""
_WANTED_S = 0.5
_NEW_MAP_S = 1.0
"""a map is made anew at most so often, for all readers at once"""
_CURVE = 25
"""most moments whose error is drawn"""
_CURVE_S = 0.5
"""one question for the curve takes no longer, or one map"""
LIVE = "live.json"
"""file of the folder in which a live flight says where its vehicles are"""


class Watched:
    """A mission as readers see it. Every answer opens the journal anew, so that what other
    processes write is seen; maps are kept by the readings they were made from."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._maps: OrderedDict[int, tuple[NDArray, NDArray, float]] = OrderedDict()
        self._errors: dict[int, float] = {}
        self._lock, self._heard_lock = threading.Lock(), threading.Lock()
        self._wanted: tuple[float, Wanted] | None = None
        self._heard: dict[str, list[Any]] = {"xy": [], "level": [], "uav": [], "event": []}
        self._story: dict[str, Any] = {}
        self._story_of = (-1, -1)
        self._newest, self._newest_s = 0, -1e9

    @cached_property
    def site(self) -> Site:
        """Where it takes place; read once."""
        with Mission.opened(self.folder) as mission:
            return mission.site

    @cached_property
    def place(self) -> dict[str, Any]:
        """What does not change: grid, buildings, area, zones, homes, colours."""
        import matplotlib

        shapely = require("shapely", "geo")
        site = self.site
        west, south, east, north = site.grid.bounds_m
        corner = np.array([west, south])

        def rings(shape: Any) -> list[list[list[float]]]:
            return [
                np.round(np.asarray(part.exterior.coords)[:, :2] - corner, 2).tolist()
                for part in shapely.get_parts(shape)
                if part.geom_type == "Polygon"
            ]

        colours = {
            name: np.round(matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3] * 255)
            .astype(int)
            .ravel()
            .tolist()
            for name in ("viridis", "magma")
        }
        buildings = [
            {
                "ring": np.round(np.asarray(b.footprint_m) - corner, 2).tolist(),
                "height_m": round(float(b.height_m), 1),
            }
            for b in site.city.buildings
        ]
        latitude, longitude = site.grid.latlon([(n - 1) / 2 for n in site.grid.shape])
        return {
            "name": site.reading.city.name,
            "altitude": site.altitude_text,
            "middle": [float(latitude), float(longitude)],
            "rows": site.grid.shape[0],
            "cols": site.grid.shape[1],
            "spacing_m": site.grid.spacing_m,
            "width_m": east - west,
            "height_m": north - south,
            "area": rings(site.area),
            "zones": [ring for zone in site.zones for ring in rings(zone)],
            "buildings": buildings,
            "pads": [np.round(pad.xy_m - corner, 2).tolist() for pad in site.pads],
            "uav_colours": uav_colours(len(site.pads)),
            "colours": colours,
            "stop_db": site.request.stop_std_db,
        }

    def wanted(self) -> Wanted:
        """What posts have to fit, as of half a second ago at most.

        Raises:
            InputError: posts cannot be taken.
        """
        now = time.monotonic()
        if self._wanted is None or now > self._wanted[0]:
            with Mission.opened(self.folder) as mission:
                self._wanted = now + _WANTED_S, Wanted.by(mission, self.site)
        return self._wanted[1]

    def now(self) -> dict[str, Any]:
        """What changes: the newest event, how many readings there are, how many of them the newest
        map holds, and where vehicles are."""
        with Mission.opened(self.folder) as mission:
            last, count = mission.journal.last, mission.journal.count
        moment = time.monotonic()
        if count != self._newest and moment - self._newest_s > _NEW_MAP_S:
            self._newest, self._newest_s = count, moment
        return {"last": last, "count": count, "map": self._newest, "live": self.live()}

    def heard(self, after: int = 0) -> dict[str, Any]:
        """The readings from number ``after`` on: place, level, UAV, and how many there are."""
        corner = np.array(self.site.grid.bounds_m[:2])
        with self._heard_lock:
            have = len(self._heard["level"])
            with Mission.opened(self.folder) as mission:
                new = mission.journal.readings(have)
                events = mission.journal.reading_events(have)[: len(new)]
            if new:
                latlon = np.array([(r.latitude, r.longitude) for r in new])
                xy = np.round(self.site.grid.xy_m_at_latlon(latlon) - corner, 1)
                self._heard["xy"] += xy.tolist()
                self._heard["level"] += [round(r.level_db, 1) for r in new]
                self._heard["uav"] += [r.uav for r in new]
                self._heard["event"] += events
            told: dict[str, Any] = {k: self._heard[k][after:] for k in ("xy", "level", "uav")}
            return {**told, "count": len(self._heard["level"])}

    def story(self) -> dict[str, Any]:
        """Everything that happened but for the readings: moments, ways, sorties."""
        self.heard()
        with Mission.opened(self.folder) as mission:
            mission.__dict__["site"] = self.site
            last, count = mission.journal.last, len(self._heard["level"])
            if (last, count) == self._story_of:
                return self._story
            events = mission.journal.events()
            quantity = quantity_of(mission.journal)
        came = Counter(self._heard["event"])
        upto = {event: k for k, event in enumerate(self._heard["event"], start=1)}
        told = _Told(self.site, events, came, upto)
        self._story = {
            "last": last,
            "unit": "dB" if quantity == "gain" else "dBm",
            "moments": told.moments,
            "ways": told.ways,
            "sorties": [{**one, "files": self._files(one["number"])} for one in told.sorties],
        }
        self._story_of = last, count
        return self._story

    def _files(self, number: int) -> list[str]:
        folder = self.folder / "sorties" / f"{number:03d}"
        return sorted(p.name for p in folder.glob("*") if p.is_file())

    def maps(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
        """``[row, col]`` mean and standard deviation after the first ``count`` readings, NaN
        indoors, and the expected error."""
        with self._lock:
            if count in self._maps:
                self._maps.move_to_end(count)
                return self._maps[count]
            site = self.site
            with Mission.opened(self.folder) as mission:
                mission.__dict__["site"] = site
                if count > mission.journal.count:
                    raise InputError(f"there are only {mission.journal.count} readings")
                posterior = known_belief(mission, mission.journal.readings()[:count]).posterior()
            outdoor = site.scenario.outdoor
            found = (
                np.where(outdoor, posterior.mean_db, np.nan).astype(np.float32),
                np.where(outdoor, posterior.std_db, np.nan).astype(np.float32),
                posterior.expected_rmse_db(outdoor),
            )
            self._maps[count], self._errors[count] = found, found[2]
            while len(self._maps) > _KEPT:
                self._maps.popitem(last=False)
            return found

    def curve(self) -> dict[str, Any]:
        """The expected error over the readings, ``[count, dB]``, as far as it is known, and whether
        that is all; what is missing is computed bit by bit, the newest first."""
        until = time.monotonic() + _CURVE_S
        counts = sorted({moment["count"] for moment in self.story()["moments"]})
        every = 1
        while len(counts) / every > _CURVE:
            every *= 2
        counts = sorted({*counts[::every], counts[-1]})
        missing = [count for count in counts if count not in self._errors]
        while missing and time.monotonic() < until:
            self.maps(missing.pop())
        known = sorted({*counts, self._newest} & self._errors.keys())
        return {"points": [[k, round(self._errors[k], 3)] for k in known], "whole": not missing}

    def live(self) -> dict[str, Any] | None:
        """Where the vehicles of a live flight are, as it last said; ``None`` without one."""
        try:
            told = dict(json.loads((self.folder / LIVE).read_text(encoding="utf-8")))
            return told if time.time() - told.pop("at") < _STALE_S else None
        except (OSError, ValueError, TypeError, KeyError):
            return None


class _Told:
    """The journal's events as the page tells them.

    Attributes:
        moments: of the timeline, each with the number of readings known then, ``count``, and the
            number of the event, ``at``.
        ways: what each UAV was to fly, each with the event from which on it was.
        sorties: their numbers and times.
    """

    def __init__(
        self, site: Site, events: list[dict[str, Any]], came: Counter[int], upto: dict[int, int]
    ) -> None:
        self._corner = np.array(site.grid.bounds_m[:2])
        self.moments: list[dict[str, Any]] = []
        self.ways: list[dict[str, Any]] = []
        self._sorties: dict[int, dict[str, Any]] = {}
        self._count = 0
        self._moment(0, "begun", "before the first")
        offers = {}
        for event in events:
            at, kind = event["id"], event["kind"]
            self._count = max(self._count, upto.get(at, 0))
            if kind == "planned":
                self._planned(at, event["sortie"])
            elif kind == "ingested":
                self._moment(at, kind, f"{event['file']}: {came[at]} readings")
            elif kind == "offered":
                offers[at] = event
            elif kind == "replanned":
                offer = offers[event["offer"]]
                self._way(at, offer["sortie"], Flight.of(offer["flight"]))
                self._moment(at, kind, f"UAV {event['uav']} has a new plan")
            elif kind == "lost":
                state = "lost" if event["state"] == "lost" else f"out ({event['state']})"
                self._moment(at, kind, f"UAV {event['uav']} {state}: {event['reason']}")
            elif kind == "flown":
                self._moment(at, kind, f"sortie {event['sortie']} has been flown")

    @property
    def sorties(self) -> list[dict[str, Any]]:
        """As they were last planned."""
        return [self._sorties[number] for number in sorted(self._sorties)]

    def _moment(self, at: int, kind: str, text: str, **more: Any) -> None:
        told = {"at": at, "kind": kind, "count": self._count, "text": text}
        self.moments.append({**told, **more})

    def _planned(self, at: int, data: dict[str, Any]) -> None:
        sortie = Sortie.of(data)
        number, duration_s = sortie.number, round(sortie.duration_s, 1)
        self._sorties[number] = {"number": number, "duration_s": duration_s}
        for flight in sortie.flights:
            self._way(at, number, flight)
        for k in range(_PLAN_MOMENTS + 1):
            share = k / _PLAN_MOMENTS
            text = f"sortie {number} as planned, {100 * share:.0f} % of its time"
            self._moment(at, "planned", text, sortie=number, share_s=round(share * duration_s, 1))

    def _way(self, at: int, sortie: int, flight: Flight) -> None:
        self.ways.append(
            {
                "at": at,
                "sortie": sortie,
                "uav": flight.uav,
                "route": np.round(flight.route_m[:, :2] - self._corner, 1).tolist(),
                "moment_s": np.round(flight.timeline.reached_s, 1).tolist(),
                "measuring": flight.measuring,
            }
        )
