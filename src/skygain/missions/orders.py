"""What one vehicle is told, in degrees and metres above its take-off place."""

from __future__ import annotations

__all__ = ["Orders", "Point", "orders_for"]

import math
from dataclasses import dataclass

import numpy as np

from skygain.ground.errors import require
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie


@dataclass(frozen=True)
class Point:
    """A waypoint."""

    latitude: float
    """degrees, WGS 84"""
    longitude: float
    """degrees, WGS 84"""
    height_m: float
    """above the take-off place"""
    moment_s: float
    """when it is reached, counted from the first take-off of the sortie"""
    homeward: bool
    """it belongs to the way home"""
    stop: bool
    """the vehicle stops there, at a corner without room to round it, or at the end"""


@dataclass(frozen=True, eq=False)
class Orders:
    """One vehicle's part of a sortie."""

    title: str
    """for people"""
    uav: int
    """number of the vehicle"""
    home: tuple[float, float]
    """latitude and longitude of the take-off place"""
    home_altitude_m: float
    """height of the ground there, in the map's zero"""
    points: tuple[Point, ...]
    """the way, the first and the last above the take-off place"""
    speed_mps: float
    """along the legs"""
    delay_s: float
    """it takes off this long after the first"""
    return_height_m: float
    """above the take-off place: over everything on the map and apart from the other vehicles"""
    fence: tuple[tuple[tuple[float, float], ...], ...]
    """rings of (latitude, longitude) that hold the flight in, with the area's outline"""
    keep_out: tuple[tuple[tuple[float, float], ...], ...]
    """rings that nobody may enter"""

    @property
    def takeoff_m(self) -> float:
        """Height of the first point above the ground."""
        return self.points[0].height_m


def orders_for(site: Site, sortie: Sortie, flight: Flight) -> Orders:
    """The orders for one flight of a sortie."""
    latlon = np.round(site.latlon(flight.route_m[:, :2]), 8)
    moments = flight.timeline.reached_s
    points = tuple(
        Point(
            float(lat),
            float(lon),
            round(float(h), 2),
            float(t),
            k >= flight.measuring,
            bool(stop) or k == len(latlon) - 1,
        )
        for k, ((lat, lon), h, t, stop) in enumerate(
            zip(latlon, flight.heights_m, moments, flight.stops, strict=True)
        )
    )
    lat, lon = (float(v) for v in np.round(site.latlon(np.array(flight.pad_m[:2])), 8))
    highest = site.highest_m + site.request.clearance_m - flight.pad_m[2]
    above = max(highest, float(flight.heights_m.max()))
    shapely = require("shapely", "geo")
    return Orders(
        f"{site.reading.city.name}, sortie {sortie.number}, UAV {flight.uav}",
        flight.uav,
        (lat, lon),
        flight.pad_m[2],
        points,
        flight.speed_mps,
        flight.delay_s,
        float(math.ceil(above + flight.uav * site.request.separation_m)),
        tuple(_ring(site, part.exterior) for part in shapely.get_parts(site.area)),
        tuple(_ring(site, zone.exterior) for zone in site.zones),
    )


def _ring(site: Site, ring: object) -> tuple[tuple[float, float], ...]:
    """The corners of a ring, the first not repeated."""
    corners = np.asarray(ring.simplify(0.05).coords)[:-1, :2]  # type: ignore[attr-defined]
    return tuple((float(a), float(b)) for a, b in np.round(site.latlon(corners), 8))
