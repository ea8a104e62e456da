"""One vehicle of a live flight, as its leader sees it: what it has on board, and where on it."""

from __future__ import annotations

__all__ = ["FLYING", "HOLDING", "LANDED", "LOST", "LOW", "WAITING", "Ahead", "Rider"]

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.missions.sortie import Flight
from skygain.missions.timing import SLIP_S, TICK_S, Timeline
from skygain.missions.vehicle_link import VehicleLink

FLYING, LOST, LOW, HOLDING, LANDED = "flying", "lost", "low", "holding", "landed"
WAITING = "waiting"
_AHEAD = 60
"""a vehicle is looked for on so many of the next cells"""


@dataclass(frozen=True, eq=False)
class Ahead:
    """What a vehicle has before it."""

    lead_m: NDArray[np.float64]
    """``[n, (x, y)]`` from where it was last seen to where a new plan leaves the old one"""
    later_m: NDArray[np.float64]
    """``[n, (x, y)]`` what it measures late enough to stay as it is; empty for nothing"""
    home_m: NDArray[np.float64]
    """``[n, (x, y)]`` from there home; empty as well then"""
    rest_s: float
    """seconds from where it was last seen until it is above its home"""


@dataclass(eq=False)
class Rider:
    """One vehicle of the flight."""

    link: VehicleLink
    """its connection"""
    flight: Flight
    """what it has on board"""
    began_s: float = 0.0
    """moment at which that flight's times begin"""
    up_s: float = 0.0
    """moment of its first take-off"""
    state: str = WAITING
    """waiting, flying, lost, low, holding or landed"""
    offered: tuple[Flight, float] | None = None
    """a newer flight and the moment at which it begins, sent without an answer: the vehicle has
    either"""
    offer: int = 0
    """event of the journal that tells of the newest flight it was sent"""
    settle_s: float = 0.0
    """not asked before this moment which of the two it has"""
    done: int = 0
    """cells of the flight on board that it has passed"""
    planned_at: int = 0
    """cells it had passed when it was last planned"""
    reached: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    """cells it passed in all"""

    @property
    def uav(self) -> int:
        """Its number."""
        return self.flight.uav

    def place_m(self, grid: Grid) -> NDArray[np.float64]:
        """(x, y) where it was last seen."""
        heard = self.link.heard
        return grid.xy_m_at_latlon((heard.latitude, heard.longitude))

    def take(self, flight: Flight, began_s: float) -> None:
        """It has this flight on board now."""
        self.flight, self.began_s, self.offered = flight, began_s, None
        self.done = self.planned_at = 0

    def follow(self, grid: Grid) -> None:
        """Move along the cells that it has passed."""
        ahead = self.flight.cells[self.done : self.done + _AHEAD]
        if not len(ahead):
            return
        off = np.hypot(*(grid.xy_m(ahead) - self.place_m(grid)).T)
        near = np.flatnonzero(off <= 0.75 * grid.spacing_m)
        if len(near):
            step = int(near[0]) + 1
            while step < len(ahead) and off[step] <= off[step - 1]:
                step += 1
            self.reached = np.vstack([self.reached, ahead[:step]])
            self.done += step

    def found_again(self, grid: Grid, now_s: float) -> None:
        """Look for it along its whole flight, by place and moment."""
        cells = grid.xy_m(self.flight.cells)
        moment = self.flight.moments_s(cells)
        off = np.hypot(*(cells - self.place_m(grid)).T)
        late = np.abs(moment - (now_s - self.began_s))
        self.done = self.planned_at = int((off + 0.5 * late).argmin())
        self.reached = self.flight.cells[: self.done]

    def ahead(
        self,
        grid: Grid,
        now_s: float,
        ago_s: float,
        lead_s: float,
        horizon_s: float,
    ) -> Ahead | None:
        """What of its flight is before it, for a plan that leaves it ``lead_s`` from now; ``None``
        if it will be on its way home by then."""
        line, place = self.flight.timeline, self.place_m(grid)
        seen = _seen(self.flight, place, now_s - self.began_s, ago_s)
        end = seen + round((ago_s + lead_s) / TICK_S)
        measuring, route = self.flight.measuring, self.flight.route_m[:, :2]
        if end >= len(line.ticks_m) or end * TICK_S >= line.reached_s[measuring - 1]:
            return None
        passed = (line.reached_s > seen * TICK_S) & (line.reached_s < end * TICK_S)
        lead = np.vstack([place[None], route[passed], line.ticks_m[end, :2]])
        rest_s = float(line.reached_s[-1]) - seen * TICK_S
        late = int(np.searchsorted(line.reached_s, end * TICK_S + horizon_s))
        if late >= measuring:
            return Ahead(lead, np.empty((0, 2)), np.empty((0, 2)), rest_s)
        return Ahead(lead, route[late:measuring], route[measuring - 1 :], rest_s)

    def lines(self, grid: Grid, now_s: float, ago_s: float) -> list[Timeline]:
        """What is left of every flight that it may have on board, by time from now, for a vehicle
        that was seen ``ago_s`` before."""
        if self.state == WAITING:
            return [_before(self.flight, now_s)]
        both = [(self.flight, self.began_s), *([self.offered] if self.offered else [])]
        place = self.place_m(grid)
        return [_remaining(f, place, now_s - began_s, ago_s) for f, began_s in both]


def _before(flight: Flight, now_s: float) -> Timeline:
    """The flight of a vehicle on the ground, by time from now; it takes off when it is due or
    later."""
    line = flight.timeline
    at = round(min(now_s, flight.delay_s) / TICK_S)
    return Timeline(line.ticks_m[at:], line.slip_s[at:], np.empty(0), line.landed_s - at * TICK_S)


def _remaining(
    flight: Flight, place_m: NDArray[np.float64], moment_s: float, ago_s: float
) -> Timeline:
    """What is left of a flight, its times counted from now: it flew on from where it was last seen,
    which may be earlier or later than planned."""
    ticks = flight.timeline.ticks_m
    seen = _seen(flight, place_m, moment_s, ago_s)
    at = min(seen + round(ago_s / TICK_S), len(ticks) - 1)
    rest = ticks[at:]
    # it was seen, so only the stops since then make it early or late
    slip = flight.timeline.slip_s[at:]
    return Timeline(
        rest, slip - flight.timeline.slip_s[seen] + SLIP_S, np.empty(0), len(rest) * TICK_S
    )


def _seen(flight: Flight, place_m: NDArray[np.float64], moment_s: float, ago_s: float) -> int:
    """Tick of a flight at which it was where it was last seen, by place and moment."""
    ticks = flight.timeline.ticks_m
    near = np.hypot(*(ticks[:, :2] - place_m).T)
    late = np.abs(np.arange(len(ticks)) * TICK_S - (moment_s - ago_s))
    cost = np.where(np.isfinite(near), near + 0.5 * late, np.inf)
    return int(cost.argmin())
