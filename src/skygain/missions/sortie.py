"""A sortie: what every UAV flies next, cell by cell and as legs, with its times and its energy."""

from __future__ import annotations

__all__ = ["Flight", "Sortie", "corners", "flight_along", "flight_over"]

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.missions.clearance import FOLLOWING_M, Ways, straightened
from skygain.missions.site import Site
from skygain.missions.timing import (
    CLIMB_MPS,
    DESCENT_MPS,
    ROUNDING_M,
    TICK_S,
    Timeline,
    sharp_corners,
    timeline,
    way_seconds,
)

_STAIRS = 0.75
"""stairs within so many cells of a straight leg are flown as the leg"""
_SEARCHED = 160
"""ticks ahead among which the next cell of a flight is looked for; a climb may lie between"""


@dataclass(frozen=True, eq=False)
class Flight:
    """What one UAV flies in a sortie."""

    uav: int
    """its number, from 0"""
    cells: NDArray[np.int64]
    """``[k, (row, col)]`` cells to be measured, in order, those under the legs; each is a neighbour
    of the one before"""
    route_m: NDArray[np.float64]
    """``[point, (x, y, z)]`` legs: above the pad, along the cells, home, above the pad again; z in
    the ground's zero"""
    measuring: int
    """so many of the points belong to the cells, the others to the way home"""
    pad_m: tuple[float, float, float]
    """(x, y, z) where it takes off and lands"""
    delay_s: float = 0.0
    """it takes off this long after the first UAV"""
    speed_mps: float = 5.0
    """along the legs"""
    airborne: bool = False
    """it is in the air at the first point already"""
    homeward: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    """``[k, (row, col)]`` cells that the way home leads over, which are read as well"""
    stop: NDArray[np.bool_] | None = None
    """``[point]`` whether it stops there; at every corner when left out"""

    @cached_property
    def timeline(self) -> Timeline:
        """Where it is when."""
        return timeline(
            self.route_m,
            self.pad_m[2],
            self.speed_mps,
            self.delay_s,
            stop=self.stops,
            airborne=self.airborne,
        )

    @property
    def stops(self) -> NDArray[np.bool_]:
        """``[point]`` whether it stops there, at a corner."""
        return sharp_corners(self.route_m, 5.0) if self.stop is None else self.stop

    def moments_s(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """``[k]`` moments at which points ``points_m[k, (x, y)]`` near the way are passed, one
        after another."""
        ticks, found, at = self.timeline.ticks_m[:, :2], [], 0
        at = int(np.isfinite(ticks[:, 0]).argmax())
        for point in np.asarray(points_m, dtype=float):
            ahead = ticks[at : at + _SEARCHED]
            off = np.hypot(*(ahead - point).T)
            at += int(np.where(np.isfinite(off), off, np.inf).argmin())
            found.append(at * TICK_S)
        return np.array(found)

    @property
    def read_cells(self) -> NDArray[np.int64]:
        """``[k, (row, col)]`` cells under the whole flight."""
        return np.concatenate([self.cells, self.homeward])

    @cached_property
    def air_s(self) -> float:
        """Seconds in the air."""
        up, down = self.heights_m[[0, -1]]
        climb_s = 0.0 if self.airborne else up / CLIMB_MPS
        return climb_s + way_seconds(self.route_m, self.speed_mps, self.stops) + down / DESCENT_MPS

    @property
    def length_m(self) -> float:
        """Length of all legs."""
        return float(np.linalg.norm(np.diff(self.route_m, axis=0), axis=1).sum())

    @property
    def heights_m(self) -> NDArray[np.float64]:
        """``[point]`` heights above the pad."""
        return self.route_m[:, 2] - self.pad_m[2]

    def as_data(self) -> dict[str, Any]:
        """Plain values, for the journal."""
        return {
            "uav": self.uav,
            "cells": self.cells.tolist(),
            "route_m": np.round(self.route_m, 3).tolist(),
            "measuring": self.measuring,
            "pad_m": [round(float(v), 3) for v in self.pad_m],
            "delay_s": self.delay_s,
            "speed_mps": self.speed_mps,
            "airborne": self.airborne,
            "homeward": self.homeward.tolist(),
            "stops": np.flatnonzero(self.stops).tolist(),
        }

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Flight:
        """The flight that `as_data` told of."""
        x, y, z = data["pad_m"]
        route = np.array(data["route_m"], dtype=float)
        stop = None  # older journals stop at every corner
        if "stops" in data:
            stop = np.zeros(len(route), dtype=bool)
            stop[data["stops"]] = True
        return cls(
            int(data["uav"]),
            np.array(data["cells"], dtype=np.int64).reshape(-1, 2),
            route,
            int(data["measuring"]),
            (x, y, z),
            float(data["delay_s"]),
            float(data["speed_mps"]),
            bool(data["airborne"]),
            np.array(data.get("homeward", []), dtype=np.int64).reshape(-1, 2),
            stop,
        )


@dataclass(frozen=True, eq=False)
class Sortie:
    """The flights of all UAVs between two changes of batteries."""

    number: int
    """from 1"""
    flights: tuple[Flight, ...]
    """one for each UAV that flies"""
    error_before_db: float
    """expected error of the map before it: the root mean square of its standard deviation"""
    error_after_db: float
    """the same after it, as far as can be said before"""
    refly_cells: int = 0
    """cells of earlier sorties that were not flown and are in this one"""
    notes: tuple[str, ...] = ()
    """what was changed to keep the rules"""

    @property
    def cells(self) -> NDArray[np.int64]:
        """``[k, (row, col)]`` distinct cells to be measured."""
        return np.unique(np.concatenate([f.read_cells for f in self.flights]), axis=0)

    @property
    def duration_s(self) -> float:
        """From the first take-off to the last landing."""
        return max(f.timeline.landed_s for f in self.flights)

    def as_data(self) -> dict[str, Any]:
        """Plain values, for the journal."""
        return {
            "number": self.number,
            "flights": [flight.as_data() for flight in self.flights],
            "error_before_db": self.error_before_db,
            "error_after_db": self.error_after_db,
            "refly_cells": self.refly_cells,
            "notes": list(self.notes),
        }

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Sortie:
        """The sortie that `as_data` told of."""
        return cls(
            int(data["number"]),
            tuple(Flight.of(one) for one in data["flights"]),
            float(data["error_before_db"]),
            float(data["error_after_db"]),
            int(data["refly_cells"]),
            tuple(data["notes"]),
        )

    def numbered(self, number: int) -> Sortie:
        """The same under another number."""
        return replace(self, number=number)


def corners(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """``points_m[n, (x, y)]`` without repeated points and without those on a straight run."""
    points = np.asarray(points_m, dtype=float)
    moved = np.concatenate([[True], np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-6])
    points = points[moved]
    if len(points) < 3:
        return points
    before, after = points[1:-1] - points[:-2], points[2:] - points[1:-1]
    turn = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    ahead = (before * after).sum(axis=1) > 0
    straight = (
        turn <= 1e-6 * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    ) & ahead
    return points[np.concatenate([[True], ~straight, [True]])]


def flight_along(
    site: Site,
    uav: int,
    cells: NDArray[np.int64],
    ways: Ways,
    start_m: NDArray[np.float64] | None = None,
) -> Flight:
    """The flight of ``uav`` along ``cells[k, (row, col)]`` and the short way home.

    Stairs of cells become straight legs, and the cells under those are what it measures. It begins
    on its pad, or in the air at ``start_m[k, (x, y)]``, points that lead to the first cell.
    """
    before = site.pads[uav].xy_m if start_m is None else start_m
    points = corners(np.vstack([before, site.grid.xy_m(cells)]))
    out = corners(straightened(site.space, points, _STAIRS * site.grid.spacing_m))
    return flight_over(site, uav, out, ways.way(cells[-1]), airborne=start_m is not None)


def flight_over(
    site: Site,
    uav: int,
    out_m: NDArray[np.float64],
    home_m: NDArray[np.float64],
    *,
    airborne: bool = False,
) -> Flight:
    """The flight of ``uav`` along the clear legs ``out_m[n, (x, y)]``, and from their last point
    along ``home_m[n, (x, y)]``."""
    pad, space = site.pads[uav], site.space
    there = _at_heights(site, out_m)
    back = _at_heights(site, home_m)
    route = np.vstack([there, back[1:]])
    if len(route) == 1:
        route = np.vstack([route, route])
    stop = sharp_corners(route) | ~space.clear_corners(route[:, :2], ROUNDING_M)
    x, y = (float(v) for v in pad.xy_m)
    return Flight(
        uav,
        space.cells_read(out_m),
        route,
        len(there),
        (x, y, pad.ground_m),
        speed_mps=site.request.speed_mps,
        airborne=airborne,
        homeward=space.cells_read(home_m),
        stop=stop,
    )


def _at_heights(site: Site, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """``[n, (x, y, z)]`` the points at the height of flight, with more of them where a straight leg
    would leave the ground it follows."""
    height = [site.flight_height_m(x, y) for x, y in points_m]
    if site.level_m is not None or site.city.is_level:
        return np.column_stack([points_m, height])
    rows = [np.array([*points_m[0], height[0]])]
    for start, end, low, high in zip(
        points_m[:-1], points_m[1:], height[:-1], height[1:], strict=True
    ):
        n = max(2, int(np.hypot(*(end - start)) / (site.grid.spacing_m / 2)) + 1)
        share = np.linspace(0.0, 1.0, n)
        xy = start + share[:, None] * (end - start)
        z = np.array([low, *(site.flight_height_m(x, y) for x, y in xy[1:-1]), high])
        leg = np.column_stack([xy, z])
        rows += [leg[k] for k in _followed(share, z)[1:]]
    return np.array(rows)


def _followed(share: NDArray[np.float64], z: NDArray[np.float64]) -> list[int]:
    """Samples that a leg has to pass so that it stays within `FOLLOWING_M` of all of them."""
    line = z[0] + share / share[-1] * (z[-1] - z[0]) if share[-1] else z
    off = np.abs(z - line)
    worst = int(off.argmax())
    if off[worst] <= FOLLOWING_M or len(z) < 3:
        return [0, len(z) - 1]
    first = _followed(share[: worst + 1] - share[0], z[: worst + 1])
    second = _followed(share[worst:] - share[worst], z[worst:])
    return [*first, *(k + worst for k in second[1:])]
