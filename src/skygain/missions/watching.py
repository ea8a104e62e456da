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

from skygain.ground.errors import require
from skygain.missions.folder import Mission
from skygain.missions.site import Site
from skygain.missions.state import known_belief, quantity_of
from skygain.reports.pictures import uav_colours

_KEPT = 64
_PLAN_MOMENTS = 24
"""moments of the timeline that one sortie's flight is shown at"""
_STALE_S = 10.0
"""what a live flight said longer ago was said by one that died"""
LIVE = "live.json"
"""file of the folder in which a live flight says where its vehicles are"""


class Watched:
    """A mission as readers see it. Every answer opens the journal anew, so that what other
    processes write is seen; maps are kept by the readings they were made from."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._maps: OrderedDict[int, tuple[NDArray, NDArray, float]] = OrderedDict()
        self._lock = threading.Lock()

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

    def last(self) -> int:
        """Number of the newest event."""
        with Mission.opened(self.folder) as mission:
            return mission.journal.last

    def story(self) -> dict[str, Any]:
        """Everything that happened: moments, sorties, readings, expected errors."""
        site = self.site
        corner = np.array(site.grid.bounds_m[:2])
        with Mission.opened(self.folder) as mission:
            mission.__dict__["site"] = site
            readings = mission.journal.readings()
            event_of = mission.journal.reading_events()
            sorties = mission.sorties()
            events = mission.journal.events("begun", "planned", "ingested", "lost", "advised")
            quantity = quantity_of(mission.journal)
            last = mission.journal.last
        moments: list[dict[str, Any]] = [{"kind": "begun", "event": 0, "text": "before the first"}]
        latest = 0
        came = Counter(event_of)
        for event in events:
            if event["kind"] == "planned":
                number = event["sortie"]["number"]
                for k in range(_PLAN_MOMENTS + 1):
                    share = k / _PLAN_MOMENTS
                    moments.append(
                        {"kind": "planned", "event": latest, "sortie": number, "share": share}
                    )
            elif event["kind"] == "ingested":
                latest = event["id"]
                moments.append(
                    {
                        "kind": "ingested",
                        "event": latest,
                        "text": f"{event['file']}: {came[latest]} readings",
                    }
                )
            elif event["kind"] == "lost":
                text = f"UAV {event['uav']} lost: {event['reason']}"
                moments.append({"kind": "lost", "event": latest, "text": text})
        xy = np.zeros((0, 2))
        if readings:
            latlon = np.array([(r.latitude, r.longitude) for r in readings])
            xy = np.round(site.grid.xy_m_at_latlon(latlon) - corner, 1)
        return {
            "last": last,
            "unit": "dB" if quantity == "gain" else "dBm",
            "moments": moments,
            "sorties": [
                {
                    "number": sortie.number,
                    "duration_s": round(sortie.duration_s, 1),
                    "flights": [
                        {
                            "uav": flight.uav,
                            "route": np.round(flight.route_m[:, :2] - corner, 1).tolist(),
                            "moment_s": np.round(flight.timeline.reached_s, 1).tolist(),
                            "measuring": flight.measuring,
                            "delay_s": flight.delay_s,
                            "landed_s": round(flight.timeline.landed_s, 1),
                        }
                        for flight in sortie.flights
                    ],
                    "files": self._files(sortie.number),
                }
                for sortie in sorties
            ],
            "readings": {
                "xy": xy.tolist(),
                "level": [round(r.level_db, 1) for r in readings],
                "uav": [r.uav for r in readings],
                "event": event_of,
            },
        }

    def _files(self, number: int) -> list[str]:
        folder = self.folder / "sorties" / f"{number:03d}"
        return sorted(p.name for p in folder.glob("*") if p.is_file())

    def maps(self, event: int) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
        """``[row, col]`` mean and standard deviation after the readings of all events up to one,
        NaN indoors, and the expected error."""
        with self._lock:
            if event in self._maps:
                self._maps.move_to_end(event)
                return self._maps[event]
            site = self.site
            with Mission.opened(self.folder) as mission:
                mission.__dict__["site"] = site
                events = np.array(mission.journal.reading_events(), dtype=np.int64)
                count = int(np.searchsorted(events, event, side="right"))
                posterior = known_belief(mission, mission.journal.readings()[:count]).posterior()
            outdoor = site.scenario.outdoor
            found = (
                np.where(outdoor, posterior.mean_db, np.nan).astype(np.float32),
                np.where(outdoor, posterior.std_db, np.nan).astype(np.float32),
                posterior.expected_rmse_db(outdoor),
            )
            self._maps[event] = found
            while len(self._maps) > _KEPT:
                self._maps.popitem(last=False)
            return found

    def live(self) -> dict[str, Any] | None:
        """Where the vehicles of a live flight are, as it last said; ``None`` without one."""
        try:
            told = dict(json.loads((self.folder / LIVE).read_text(encoding="utf-8")))
            return told if time.time() - told.pop("at") < _STALE_S else None
        except (OSError, ValueError, TypeError, KeyError):
            return None
