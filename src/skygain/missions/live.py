"""A sortie flown live: readings in, belief updated, new ways out, without a stop.

One vehicle is planned anew at a time, clear of what all others have on board at that moment. So
whatever link breaks and whenever, every vehicle keeps a plan that was legal beside the others'. A
vehicle that is lost, low or taken over by its pilot is planned for no more; its last plan is kept
clear of as long as it may be flying it. A new plan is in the journal before it is sent, so that a
leader that died is followed by one that knows what may be on board.
"""

from __future__ import annotations

__all__ = ["LiveFlight", "LiveSettings"]

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.missions.folder import Mission
from skygain.missions.imagined import ahead_of, with_expected
from skygain.missions.keeping import Keeper
from skygain.missions.orders import orders_for
from skygain.missions.qgroundcontrol import Item, items
from skygain.missions.rider import FLYING, HOLDING, LANDED, LOST, LOW, WAITING, Rider
from skygain.missions.sortie import Flight, Sortie, flight_along
from skygain.missions.state import known_belief, with_readings
from skygain.missions.timing import DESCENT_MPS, first_conflict, way_seconds
from skygain.missions.tours import Start, plan_tours, toured
from skygain.missions.vehicle_link import VehicleLink, same_mission
from skygain.missions.watching import LIVE
from skygain.planners.sequential_greedy import SequentialGreedyPlanner
from skygain.predictors.base import Belief

_SHARES = (1.0, 0.7, 0.4, 0.2)
"""of a new way, tried in this order until it is clear of the others"""
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


@dataclass(frozen=True)
class LiveSettings:
    """How a live flight is led; times are those of the vehicles."""

    every_cells: int = 15
    """a vehicle is planned anew after so many cells"""
    ahead_cells: int = 40
    """so many cells are planned ahead by planners that choose cells; a vehicle that hears of no new
    plan turns home after them"""
    horizon_s: float = 60.0
    """what of a tour comes more than so much later stays as it is until it comes nearer"""
    lead_s: float = 4.0
    """a new way leaves the old one so long after now, or later where planning takes longer"""
    lost_s: float = 5.0
    """a vehicle that is silent for longer is lost"""
    low: float = 0.25
    """share of battery below which a vehicle is left alone"""
    pace: float = 1.0
    """vehicles' seconds in one second; above 1 for simulated ones"""

    @property
    def patience_s(self) -> float:
        """Seconds of silence after which a vehicle is lost, on this machine's clock, which has
        hiccups of its own."""
        return max(self.lost_s / self.pace, 2.0)


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
        self._random = mission.random(sortie.number + 1_000_000)
        self._planner = mission.method.build_planner()
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
            if arm and self.now() >= rider.flight.delay_s and not heard.armed:
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
        ``None`` where its old one is as good."""
        belief = ahead_of(self._belief() if belief is None else belief)
        others = [r for r in self.riders if r is not rider and r.state != LANDED]
        lines = [
            line for r in others for line in r.lines(self.site.grid, self.now(), self._ago_s(r))
        ]
        speed, apart = rider.flight.speed_mps, self.site.request.separation_m
        for flight in self._ways(rider, belief):
            if all(first_conflict(flight.timeline, o, speed, apart) is None for o in lines):
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

    def _ways(self, rider: Rider, belief: Belief) -> Iterator[Flight]:
        """New flights for a vehicle in the air, the one that teaches most first."""
        left_s = self.site.request.usable_s - (self.now() - rider.up_s)
        if toured(self._planner):
            yield from self._tours(rider, belief, left_s)
        else:
            yield from self._along_cells(rider, belief, left_s)

    def _tours(self, rider: Rider, belief: Belief, left_s: float) -> Iterator[Flight]:

        site, planner, old = self.site, self._planner, rider.flight
        assert isinstance(planner, SequentialGreedyPlanner)
        now, ago_s, lead_s = self.now(), self._ago_s(rider), self.lead_s
        ahead = rider.ahead(site.grid, now, ago_s, lead_s, self.settings.horizon_s)
        if ahead is None or not site.space.clear(ahead.lead_m):
            return
        left_s -= float(old.heights_m[-1]) / DESCENT_MPS
        theirs = [r.flight.read_cells[r.done :] for r in self.riders if r is not rider]
        known = np.concatenate([np.empty((0, 2), dtype=np.int64), *theirs])
        if len(ahead.later_m):
            # what takes no longer than before leaves the later part's times as they were
            starts = [
                Start(rider.uav, ahead.lead_m, seconds, ahead.later_m, ahead.home_m)
                for seconds in (min(left_s, ahead.rest_s), left_s)
            ]
        else:
            way = site.ways_home[rider.uav].way(site.grid.cells_at(ahead.lead_m[-1]))
            shortest_s = way_seconds(np.vstack([ahead.lead_m, way]), old.speed_mps)
            soon_s = shortest_s + 2 * self.settings.horizon_s
            starts = [Start(rider.uav, ahead.lead_m, min(left_s, soon_s))]
        for start in starts:
            found = plan_tours(
                site, belief, [start], planner.noise_db2, planner.weighted, known=known, rounds=1
            )[0]
            if not found:
                return
            yield replace(found[0], airborne=True)

    def _along_cells(self, rider: Rider, belief: Belief, left_s: float) -> Iterator[Flight]:
        """Along the cells that the planner chooses one after another, by less and less of them."""
        site, old = self.site, rider.flight
        steps = max(1, int(self.lead_s * old.speed_mps / site.grid.spacing_m))
        turn = min(rider.done + steps, len(old.cells) - 1)
        cell = old.cells[turn]
        place = rider.place_m(site.grid)
        lead = np.vstack([place[None], site.grid.xy_m(old.cells[rider.done : turn])])
        if not site.space.clear(np.vstack([lead, site.grid.xy_m(cell)[None]])):
            return
        coming = np.vstack([self._coming(rider, cell), old.cells[rider.done : turn + 1]])
        path = self._path(with_expected(belief, coming), cell)
        for share in _SHARES:
            cells = np.vstack(
                [old.cells[rider.done : turn], path[: max(1, int(share * len(path)))]]
            )
            flight = self._within(rider.uav, cells, turn - rider.done, lead[:1], left_s)
            if flight is None:
                return
            yield flight

    def _ago_s(self, rider: Rider) -> float:
        """Seconds of the vehicles since its place was heard."""
        return max(0.0, time.monotonic() - rider.link.heard.place_s) * self.settings.pace

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
