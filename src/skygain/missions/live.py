"""A sortie flown live: readings in, belief updated, new ways out, without a stop.

One vehicle is planned anew at a time, clear of what all others have on board at that moment. So
whatever link breaks and whenever, every vehicle keeps a plan that was legal beside the others'. A
vehicle that is lost, low or taken over by its pilot is planned for no more; its last plan is kept
clear of as long as it may be flying it.
"""

from __future__ import annotations

__all__ = ["LiveFlight", "LiveSettings", "Rider"]

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from skygain.flight.swarm import Swarm
from skygain.ground.files import atomic_write
from skygain.missions.folder import Mission
from skygain.missions.imagined import ahead_of, with_expected
from skygain.missions.journal import Reading
from skygain.missions.orders import orders_for
from skygain.missions.qgroundcontrol import items
from skygain.missions.sortie import Flight, Sortie, flight_along
from skygain.missions.state import known_belief
from skygain.missions.timing import SLIP_S, TICK_S, Timeline, first_conflict
from skygain.missions.vehicle_link import VehicleLink
from skygain.missions.watching import LIVE
from skygain.predictors.base import Belief

_SHARES = (1.0, 0.7, 0.4, 0.2)
"""of a new way, tried in this order until it is clear of the others"""
_IN_TIME = 0.5
"""share of the lead after which a new way comes too late to be sent"""
_ARDUPILOT = 3
FLYING, LOST, LOW, HOLDING, LANDED = "flying", "lost", "low", "holding", "landed"
WAITING = "waiting"


@dataclass(frozen=True)
class LiveSettings:
    """How a live flight is led; times are those of the vehicles."""

    every_cells: int = 15
    """a vehicle is planned anew after so many cells"""
    ahead_cells: int = 40
    """so many cells are planned ahead; a vehicle that hears of no new plan turns home after
    them"""
    lead_s: float = 4.0
    """a new way leaves the old one so long after now, or later where planning takes longer"""
    lost_s: float = 5.0
    """a vehicle that is silent for longer is lost"""
    low: float = 0.25
    """share of battery below which a vehicle is left alone"""
    keep_s: float = 2.0
    """readings are in the journal at most so long after they came"""
    pace: float = 1.0
    """vehicles' seconds in one second; above 1 for simulated ones"""


@dataclass(eq=False)
class Rider:
    """One vehicle of the flight, as the leader sees it."""

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


class LiveFlight:
    """The flight of one sortie.

    Args:
        mission: open for writing.
        sortie: what is flown.
        links: one for each of its flights, in their order.
        settings: how it is led.
        told: hears what happens, a line each.
    """

    def __init__(
        self,
        mission: Mission,
        sortie: Sortie,
        links: Sequence[VehicleLink],
        settings: LiveSettings | None = None,
        told: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.mission, self.sortie, self.told = mission, sortie, told
        self.site = mission.site
        self.settings = settings or LiveSettings()
        self.riders = [Rider(link, f) for link, f in zip(links, sortie.flights, strict=True)]
        self.replan_s: list[float] = []
        """wall time of every new plan, upload included"""
        self._zero = time.monotonic()
        self._buffer: list[Reading] = []
        self._kept_s = self._shown_s = 0.0
        self._random = mission.random(sortie.number + 1_000_000)
        self._planner = mission.method.build_planner()

    def now(self) -> float:
        """Seconds of the vehicles since the flight began."""
        return (time.monotonic() - self._zero) * self.settings.pace

    def upload(self) -> list[int]:
        """Send every vehicle its flight; returns the numbers of those that did not take it."""
        refused = []
        for rider in self.riders:
            if not self._send(rider, rider.flight):
                refused.append(rider.uav)
        return refused

    def _send(self, rider: Rider, flight: Flight) -> bool:
        orders = orders_for(self.site, self.sortie, flight)
        return rider.link.upload(items(orders, airborne=flight.airborne), orders.home)

    def lead(self, *, arm: bool, most_s: float = 7200.0) -> None:
        """Lead the flight until every vehicle has landed or is out of reach.

        Args:
            arm: arm and start each vehicle when it is due; otherwise their pilots do.
            most_s: end after so many seconds of the vehicles in any case.
        """
        self._zero = time.monotonic()
        try:
            while self.now() < most_s and any(r.state in (WAITING, FLYING) for r in self.riders):
                self._start(arm)
                self._watch()
                self._take_readings()
                self._plan_one()
                self._show()
                time.sleep(0.02)
            self._take_readings(at_once=True)
        finally:
            (self.mission.folder / LIVE).unlink(missing_ok=True)

    def _start(self, arm: bool) -> None:
        for rider in self.riders:
            heard = rider.link.heard
            if rider.state != WAITING:
                continue
            if arm and self.now() >= rider.flight.delay_s and not heard.armed:
                rider.link.arm()
                rider.link.start()
            if heard.armed and heard.height_m > 2.0:
                # its times begin now, less the climb so far
                rider.began_s = self.now() - rider.flight.delay_s - heard.height_m / 2.0
                rider.up_s = self.now() - heard.height_m / 2.0
                rider.state = FLYING
                self.told(f"UAV {rider.uav} is in the air")
            elif rider.link.silent_s() * self.settings.pace > self.settings.lost_s:
                self._out(rider, LOST, "it was not heard before take-off")

    def _watch(self) -> None:
        for rider in self.riders:
            heard = rider.link.heard
            if rider.state != FLYING:
                continue
            silent = rider.link.silent_s() * self.settings.pace
            if silent > self.settings.lost_s:
                self._out(rider, LOST, f"not heard for {silent:.0f} s")
            elif not heard.armed:
                rider.state = LANDED
                self.told(f"UAV {rider.uav} has landed")
            elif heard.battery < self.settings.low:
                self._out(rider, LOW, f"battery at {heard.battery:.0%}; it flies home as planned")
            elif not heard.in_mission and rider.done < len(rider.flight.cells) - 1:
                self._out(rider, HOLDING, "it left its mission; its pilot has it")
            else:
                self._follow(rider)

    def _out(self, rider: Rider, state: str, reason: str) -> None:
        rider.state = state
        self.mission.journal.add("lost", {"uav": rider.uav, "state": state, "reason": reason})
        self.told(f"UAV {rider.uav} is out ({state}): {reason}; the others are planned anew")
        for other in self.riders:
            other.planned_at = -self.settings.every_cells  # due at once

    def _follow(self, rider: Rider) -> None:
        """Move along the cells that the vehicle has passed."""
        cells = rider.flight.cells
        ahead = cells[rider.done : rider.done + 60]
        if not len(ahead):
            return
        off = np.hypot(*(self.site.grid.xy_m(ahead) - self._place(rider)).T)
        near = np.flatnonzero(off <= 0.75 * self.site.grid.spacing_m)
        if len(near):
            step = int(near[0]) + 1
            while step < len(ahead) and off[step] <= off[step - 1]:
                step += 1
            rider.reached = np.vstack([rider.reached, ahead[:step]])
            rider.done += step

    def _place(self, rider: Rider) -> NDArray[np.float64]:
        heard = rider.link.heard
        return self.site.grid.xy_m_at_latlon((heard.latitude, heard.longitude))

    def _take_readings(self, *, at_once: bool = False) -> None:
        for rider in self.riders:
            levels = rider.link.heard.levels
            while levels:
                moment, latitude, longitude, level = levels.popleft()
                self._buffer.append(
                    Reading(
                        round(latitude, 8),
                        round(longitude, 8),
                        level,
                        None,
                        False,
                        moment,
                        self.sortie.number,
                        rider.uav,
                        f"live, UAV {rider.uav}",
                    )
                )
        due = (time.monotonic() - self._kept_s) * self.settings.pace > self.settings.keep_s
        if self._buffer and (due or at_once):
            body = {"file": "live", "quantity": "power", "matched": []}
            self.mission.journal.take_in("ingested", body, self._buffer)
            self._buffer = []
            self._kept_s = time.monotonic()

    def _show(self) -> None:
        if time.monotonic() - self._shown_s < 0.5:
            return
        self._shown_s = time.monotonic()
        corner = np.array(self.site.grid.bounds_m[:2])
        vehicles = [
            {
                "uav": rider.uav,
                "state": rider.state,
                "xy": np.round(self._place(rider) - corner, 1).tolist(),
            }
            for rider in self.riders
        ]
        with atomic_write(self.mission.folder / LIVE) as tmp:
            tmp.write_text(json.dumps({"vehicles": vehicles}), encoding="utf-8")

    def _plan_one(self) -> None:
        """Plan the vehicle anew that has waited longest, if one is due."""
        due = [
            rider
            for rider in self.riders
            if rider.state == FLYING
            and rider.done - rider.planned_at >= self.settings.every_cells
            and 0 < rider.done < len(rider.flight.cells) - 2
        ]
        if not due:
            return
        rider = max(due, key=lambda r: r.done - r.planned_at)
        began, began_s, lead_s = time.monotonic(), self.now(), self.lead_s
        rider.planned_at = rider.done
        self._take_readings(at_once=True)
        flight = self.planned(rider)
        late = self.now() - began_s > _IN_TIME * lead_s
        if flight is not None and rider.state == FLYING and not late and self._send(rider, flight):
            rider.link.fly_from(self._next_item(rider, flight))
            self.mission.journal.add("replanned", {"flight": flight.as_data()})
            rider.flight, rider.began_s = flight, began_s
            rider.done = rider.planned_at = 0
        self.replan_s.append(time.monotonic() - began)

    @property
    def lead_s(self) -> float:
        """Seconds of the vehicles after which a new way leaves the old one: enough to plan and to
        upload it."""
        slowest = max(self.replan_s[-5:], default=0.0)
        return self.settings.lead_s + 2.0 * slowest * self.settings.pace

    def _next_item(self, rider: Rider, flight: Flight) -> int:
        """The item of a new mission to fly to: the end of the leg that the vehicle is on, which is
        the old way still, or the nearest point in clear sight if it is late."""
        place, points = self._place(rider), flight.route_m[:, :2]
        first = points[: min(len(points) - 1, flight.measuring)]
        step = points[1 : len(first) + 1] - first
        length = np.maximum((step**2).sum(axis=1), 1e-12)
        share = np.clip(((place - first) * step).sum(axis=1) / length, 0.0, 1.0)
        off = np.hypot(*(first + share[:, None] * step - place).T)
        for leg in np.argsort(off, kind="stable")[:8]:
            if self.site.space.clear(np.array([place, points[leg + 1]])):
                # one item before the way sets the speed; ArduPilot counts its home too
                return int(leg) + 1 + (rider.link.heard.autopilot == _ARDUPILOT)
        return int(np.argmin(off)) + 1 + (rider.link.heard.autopilot == _ARDUPILOT)

    @threadpool_limits.wrap(limits=1, user_api="blas")
    def planned(self, rider: Rider, belief: Belief | None = None) -> Flight | None:
        """A new flight for a vehicle in the air that is clear of what the others have on board;
        ``None`` where its old one is as good."""
        site = self.site
        old = rider.flight
        steps = max(1, int(self.lead_s * old.speed_mps / site.grid.spacing_m))
        turn = min(rider.done + steps, len(old.cells) - 1)
        cell = old.cells[turn]
        lead = np.vstack([self._place(rider)[None], site.grid.xy_m(old.cells[rider.done : turn])])
        if not site.space.clear(np.vstack([lead, site.grid.xy_m(cell)[None]])):
            return None
        left_s = site.request.usable_s - (self.now() - rider.up_s)
        belief = ahead_of(known_belief(self.mission) if belief is None else belief)
        others = [r for r in self.riders if r is not rider and r.state not in (LANDED, WAITING)]
        coming = np.vstack([self._coming(rider, cell), old.cells[rider.done : turn + 1]])
        belief = with_expected(belief, coming)
        path = self._path(belief, cell)
        lines = [_remaining(r.flight, self._place(r), self.now() - r.began_s) for r in others]
        speed, apart = old.speed_mps, site.request.separation_m
        for share in _SHARES:
            cells = np.vstack(
                [old.cells[rider.done : turn], path[: max(1, int(share * len(path)))]]
            )
            flight = self._within(rider.uav, cells, turn - rider.done, lead[:1], left_s)
            if flight is None:
                return None
            if all(first_conflict(flight.timeline, o, speed, apart) is None for o in lines):
                return flight
        return None

    def _coming(self, rider: Rider, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Every second cell that the others will read soon, and near enough to matter."""
        ahead = self.settings.ahead_cells
        theirs = [r.flight.cells[r.done : r.done + 2 * ahead : 2] for r in self.riders
                  if r is not rider]  # fmt: skip
        cells = np.vstack([np.empty((0, 2), dtype=np.int64), *theirs])
        return cells[np.abs(cells - cell).max(axis=1, initial=0) <= ahead]

    def _within(
        self,
        uav: int,
        cells: NDArray[np.int64],
        least: int,
        start_m: NDArray[np.float64],
        left_s: float,
    ) -> Flight | None:
        """The longest flight along the beginning of ``cells`` that comes home in time."""
        low, high, best = max(1, least), len(cells), None
        while low <= high:
            middle = (low + high + 1) // 2
            ways = self.site.ways_home[uav]
            flight = flight_along(self.site, uav, cells[:middle], ways, start_m)
            if flight.air_s <= left_s:
                best, low = flight, middle + 1
            else:
                high = middle - 1
        return best

    def _path(self, belief: Belief, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Cells from ``cell`` on."""
        swarm = Swarm.deployed(self.site.scenario, cell[None], self.settings.ahead_cells)
        while swarm.flying.any():
            horizon = int(swarm.steps_left.max())
            plan = self._planner.plan(swarm, belief, horizon, self._random)
            for cells in plan.paths.transpose(1, 0, 2)[1:]:
                swarm = swarm.advanced(cells)
            if swarm.flying.any():
                belief = with_expected(belief, plan.paths[:, 1:])
        return swarm.history[0]


def _remaining(flight: Flight, place_m: NDArray[np.float64], moment_s: float) -> Timeline:
    """What is left of a flight, its times counted from now: it is where it was last seen, which may
    be earlier or later than planned."""
    ticks = flight.timeline.ticks_m
    near = np.hypot(*(ticks[:, :2] - place_m).T)
    index = np.arange(len(ticks))
    late = np.abs(index * TICK_S - moment_s)
    cost = np.where(np.isfinite(near), near + 0.5 * late, np.inf)
    at = int(cost.argmin())
    rest = ticks[at:]
    # it is seen here and now, so only the stops still to come make it early or late
    slip = flight.timeline.slip_s[at:]
    return Timeline(rest, slip - slip[0] + SLIP_S, np.empty(0), len(rest) * TICK_S)
