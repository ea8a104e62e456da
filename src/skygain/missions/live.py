"""A sortie flown live: readings in, belief updated, new ways out, without a stop.

One vehicle is planned anew at a time, clear of what all others have on board at that moment. So
whatever link breaks and whenever, every vehicle keeps a plan that was legal beside the others'. A
vehicle that is lost, low or taken over by its pilot is planned for no more; its last plan is kept
clear of as long as it may be flying it. A new plan is in the journal before it is sent, so that a
leader that died is followed by one that knows what may be on board.
"""

from __future__ import annotations

__all__ = ["LiveFlight"]

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.missions.folder import Mission
from skygain.missions.imagined import ahead_of
from skygain.missions.keeping import Keeper
from skygain.missions.new_ways import LiveSettings, Moment, NewWays
from skygain.missions.orders import orders_for
from skygain.missions.qgroundcontrol import Item, items
from skygain.missions.rider import FLYING, HOLDING, LANDED, LOST, LOW, WAITING, Rider
from skygain.missions.sortie import Flight, Sortie
from skygain.missions.state import known_belief, with_readings
from skygain.missions.timing import first_conflict
from skygain.missions.vehicle_link import VehicleLink, same_mission
from skygain.missions.watching import LIVE
from skygain.predictors.base import Belief

_IN_TIME = 0.5
"""share of the lead after which a new way comes too late to be sent"""
_ARDUPILOT = 3
_HEARD_S = 1.5
"""nothing is sent to a vehicle that was not heard for longer"""
_SENDING_S = 3.0
"""a vehicle in the air has so long to take a new mission"""
_SETTLE_S = 2.0
"""a vehicle that may have either of two missions is asked so often which"""
_UP_M = 2.0
"""a vehicle so high is in the air"""


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
        self._resumed = False
        self._shown_s = 0.0
        self._ways = NewWays(
            self.site,
            mission.method.build_planner(),
            self.settings,
            mission.random(sortie.number + 1_000_000),
        )
        self._held: set[int] = set()
        self._known: Belief | None = None
        self._heard = 0

    def now(self) -> float:
        """Seconds of the vehicles since the flight began."""
        return (time.monotonic() - self._zero) * self.settings.pace

    def upload(self) -> list[int]:
        """Send every vehicle on the ground its flight; returns the numbers of those that did not
        take it."""
        waiting = [rider for rider in self.riders if rider.state == WAITING]
        return [r.uav for r in waiting if not r.link.upload(*self._orders(r.flight))]

    def _orders(self, flight: Flight) -> tuple[list[Item], tuple[float, float]]:
        orders = orders_for(self.site, self.sortie, flight)
        return items(orders, airborne=flight.airborne), orders.home

    def resume(self) -> None:
        """Take over vehicles in the air from a leader that died: every vehicle is asked what it has
        on board, and the journal knows where that came from."""
        told = self.mission.journal.events("led", "airborne", "offered", "replanned", "lost")
        mine = [e for e in told if e.get("sortie") == self.sortie.number]
        zero = max((e["zero_at"] for e in mine if e["kind"] == "led"), default=time.time())
        self._zero, self._resumed = time.monotonic() - (time.time() - zero), True
        for rider in self.riders:
            up = [e for e in mine if e["kind"] == "airborne" and e["uav"] == rider.uav]
            offers = [
                (Flight.of(e["flight"]), float(e["began_s"]))
                for e in mine
                if e["kind"] == "offered" and e["flight"]["uav"] == rider.uav
            ]
            rider.began_s = up[-1]["began_s"] if up else 0.0
            rider.up_s = up[-1]["up_s"] if up else rider.flight.delay_s
            self._find(rider, bool(up), offers)
            self.told(f"UAV {rider.uav} is {rider.state}")

    def _find(self, rider: Rider, was_up: bool, offers: list[tuple[Flight, float]]) -> None:
        """Which of its flights a vehicle is on."""
        heard = rider.link.heard
        if rider.link.silent_s() > self.settings.patience_s:
            if offers:
                rider.take(*offers[-1])
            ticks = rider.flight.timeline.ticks_m
            known = ticks[np.isfinite(ticks[:, 0])]
            at = int(np.clip((self.now() - rider.began_s) / 0.25, 0, len(known) - 1))
            heard.latitude, heard.longitude = map(float, self.site.latlon(known[at, :2]))
            heard.place_s = time.monotonic()
            self._out(rider, LOST, "it is not heard")
        elif not heard.armed:
            rider.state = LANDED if was_up else WAITING
        else:
            rider.state = FLYING
            aboard = rider.link.download()
            candidates = [(rider.flight, rider.began_s), *offers]
            for flight, began_s in reversed(candidates):
                if aboard is not None and same_mission(aboard, self._orders(flight)[0]):
                    rider.take(flight, began_s)
                    rider.found_again(self.site.grid, self.now())
                    return
            if offers:
                rider.take(*offers[-1])
            self._out(rider, HOLDING, "its mission is none of this sortie's; its pilot has it")

    def lead(self, *, arm: bool, most_s: float = 7200.0) -> None:
        """Lead the flight until every vehicle has landed or is out of reach.

        Args:
            arm: arm and start each vehicle when it is due; otherwise their pilots do.
            most_s: end after so many seconds of the vehicles in any case.

        Raises:
            InputError: the last readings cannot be written.
        """
        if not self._resumed:
            self._zero = time.monotonic()
            self._keep("led", {"zero_at": time.time(), "pace": self.settings.pace})
        links = [rider.link for rider in self.riders]
        try:
            with Keeper(self.mission.journal.path, self.sortie.number, links, self.told):
                while self.now() < most_s and any(
                    rider.state in (WAITING, FLYING) for rider in self.riders
                ):
                    self._start(arm)
                    self._watch()
                    self._plan_one()
                    self._show()
                    time.sleep(0.02)
            self._keep("flown", {"states": {str(r.uav): r.state for r in self.riders}})
        finally:
            (self.mission.folder / LIVE).unlink(missing_ok=True)

    def _keep(self, kind: str, body: Mapping[str, Any]) -> int:
        """The number of a new event; 0 where it cannot be written, and the flight goes on."""
        try:
            return self.mission.journal.add(kind, {"sortie": self.sortie.number, **body})
        except InputError as error:
            self.told(str(error))
            return 0

    def _start(self, arm: bool) -> None:
        for rider in self.riders:
            heard = rider.link.heard
            if rider.state != WAITING:
                continue
            due = self.now() >= rider.flight.delay_s
            if arm and due and not heard.armed and self._may_rise(rider):
                rider.link.arm()
                rider.link.start()
            if heard.armed and heard.height_m > _UP_M:
                # its times begin now, less the climb so far
                rider.up_s = self.now() - heard.height_m / 2.0
                rider.began_s = rider.up_s - rider.flight.delay_s
                rider.state = FLYING
                body = {"uav": rider.uav, "began_s": rider.began_s, "up_s": rider.up_s}
                self._keep("airborne", body)
                self.told(f"UAV {rider.uav} is in the air")
            elif rider.link.silent_s() > self.settings.patience_s:
                self._out(rider, LOST, "it was not heard before take-off")

    def _may_rise(self, rider: Rider) -> bool:
        """Whether a flight that begins now is clear of what the others have on board; they may have
        new ways since it was planned, or it is late."""
        grid, now = self.site.grid, self.now()
        (mine,) = rider.lines(grid, now, 0.0)
        speed, apart = rider.flight.speed_mps, self.site.request.separation_m
        clear = all(
            first_conflict(mine, line, speed, apart) is None
            for r in self.riders
            if r is not rider and r.state not in (WAITING, LANDED)
            for line in r.lines(grid, now, self._ago_s(r))
        )
        if not clear and rider.uav not in self._held:
            self._held.add(rider.uav)
            self.told(f"UAV {rider.uav} waits on the ground until its way is clear of the others'")
        return clear

    def _watch(self) -> None:
        for rider in self.riders:
            heard, silent_s = rider.link.heard, rider.link.silent_s()
            if rider.state != FLYING:
                continue
            if silent_s > self.settings.patience_s:
                self._out(rider, LOST, f"not heard for {silent_s * self.settings.pace:.0f} s")
            elif not heard.armed:
                rider.state = LANDED
                self.told(f"UAV {rider.uav} has landed")
            elif heard.battery < self.settings.low:
                self._out(rider, LOW, f"battery at {heard.battery:.0%}; it flies home as planned")
            elif not heard.in_mission and rider.done < len(rider.flight.cells) - 1:
                self._out(rider, HOLDING, "it left its mission; its pilot has it")
            else:
                if rider.offered and silent_s < _HEARD_S and time.monotonic() > rider.settle_s:
                    self._settle(rider)
                rider.follow(self.site.grid)

    def _settle(self, rider: Rider) -> None:
        """Ask a vehicle which of two missions it has."""
        assert rider.offered is not None
        rider.settle_s = time.monotonic() + _SETTLE_S
        aboard = rider.link.download(1.0)
        if aboard is None:
            return
        if same_mission(aboard, self._orders(rider.offered[0])[0]):
            self._keep("replanned", {"uav": rider.uav, "offer": rider.offer})
            rider.take(*rider.offered)
            rider.found_again(self.site.grid, self.now())
        else:
            rider.offered = None

    def _out(self, rider: Rider, state: str, reason: str) -> None:
        rider.state = state
        self._keep("lost", {"uav": rider.uav, "state": state, "reason": reason})
        self.told(f"UAV {rider.uav} is out ({state}): {reason}; the others are planned anew")
        for other in self.riders:
            other.planned_at = -self.settings.every_cells  # due at once

    def _show(self) -> None:
        if time.monotonic() - self._shown_s < 0.5:
            return
        self._shown_s = time.monotonic()
        corner = np.array(self.site.grid.bounds_m[:2])
        vehicles = [
            {
                "uav": rider.uav,
                "state": rider.state,
                "xy": np.round(rider.place_m(self.site.grid) - corner, 1).tolist(),
            }
            for rider in self.riders
        ]
        with atomic_write(self.mission.folder / LIVE) as tmp:
            tmp.write_text(json.dumps({"at": time.time(), "vehicles": vehicles}), encoding="utf-8")

    def _plan_one(self) -> None:
        """Plan the vehicle anew that has waited longest, if one is due."""
        due = [
            rider
            for rider in self.riders
            if rider.state == FLYING
            and rider.offered is None
            and rider.link.silent_s() < _HEARD_S
            and rider.done - rider.planned_at >= self.settings.every_cells
            and 0 < rider.done < len(rider.flight.cells) - 2
        ]
        if not due:
            return
        rider = max(due, key=lambda r: r.done - r.planned_at)
        began, began_s, lead_s = time.monotonic(), self.now(), self.lead_s
        rider.planned_at = rider.done
        flight = self.planned(rider)
        late = self.now() - began_s > _IN_TIME * lead_s
        if flight is not None and rider.state == FLYING and not late:
            self._send(rider, flight, began_s)
        self.replan_s.append(time.monotonic() - began)

    def _send(self, rider: Rider, flight: Flight, began_s: float) -> None:
        """Send a vehicle in the air a new flight; without an answer it may have either."""
        offer = self._keep("offered", {"flight": flight.as_data(), "began_s": began_s})
        if not offer:
            return
        rider.offered, rider.offer = (flight, began_s), offer
        taken = rider.link.upload(*self._orders(flight), _SENDING_S)
        if taken:
            rider.link.fly_from(self._next_item(rider, flight))
            self._keep("replanned", {"uav": rider.uav, "offer": offer})
            rider.take(flight, began_s)
        elif taken is False:
            rider.offered = None

    @property
    def lead_s(self) -> float:
        """Seconds of the vehicles after which a new way leaves the old one: enough to plan and to
        upload it."""
        slowest = max(self.replan_s[-5:], default=0.0)
        return self.settings.lead_s + 2.0 * slowest * self.settings.pace

    def _next_item(self, rider: Rider, flight: Flight) -> int:
        """The item of a new mission to fly to: the end of the leg that the vehicle is on, which is
        the old way still, or the nearest point in clear sight if it is late."""
        place, points = rider.place_m(self.site.grid), flight.route_m[:, :2]
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
        ``None`` where its old one is as good.
        """
        belief = ahead_of(self._belief() if belief is None else belief)
        grid, now = self.site.grid, self.now()
        others = [r for r in self.riders if r is not rider]
        theirs = [
            line for r in others if r.state != LANDED for line in r.lines(grid, now, self._ago_s(r))
        ]
        speed, apart = rider.flight.speed_mps, self.site.request.separation_m
        mine = rider.lines(grid, now, self._ago_s(rider))[0]
        before = [first_conflict(mine, line, speed, apart) for line in theirs]
        moment = Moment(now, self._ago_s(rider), self.lead_s)
        missing = before.count(None) < len(before)
        for flight in self._ways.ways(rider, others, belief, moment, near_miss=missing):
            if all(first_conflict(flight.timeline, o, speed, apart) is None for o in theirs):
                return flight
        return None

    def _belief(self) -> Belief:
        """What is known now; readings that came since it was last asked for are added to it."""
        readings = self.mission.journal.readings(after=self._heard)
        if self._known is None:
            self._known = known_belief(self.mission, readings)
        elif readings:
            self._known = with_readings(self.mission, self._known, readings)
        self._heard += len(readings)
        return self._known

    def _ago_s(self, rider: Rider) -> float:
        """Seconds of the vehicles since its place was heard."""
        return max(0.0, time.monotonic() - rider.link.heard.place_s) * self.settings.pace
