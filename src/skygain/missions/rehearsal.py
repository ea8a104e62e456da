"""A sortie flown in simulation: readings are taken on the way, and ways are planned anew with them.

It says what live planning brings before anyone has a link. Every vehicle is planned anew again and
again, from where it will be a little later; its new way is flown if it is clear of what all others
have on board at that moment, else the old one is.
"""

from __future__ import annotations

__all__ = ["rehearse"]

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from skygain.measurements import Measurements
from skygain.missions.imagined import ahead_of
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie
from skygain.missions.timing import SLIP_S, TICK_S, Timeline, first_conflict, way_seconds
from skygain.missions.tours import Start, plan_tours
from skygain.planners.sequential_greedy import SequentialGreedyPlanner
from skygain.predictors.base import Belief

EVERY_S = 15.0
"""all are planned anew so often"""
LEAD_S = 4.0
"""a new way leaves the old one so long after its last readings"""
_LANDING_S = 20.0
"""who is above its home within that is left alone"""

Read = Callable[[NDArray[np.int64]], Measurements]


@threadpool_limits.wrap(limits=1, user_api="blas")
def rehearse(
    site: Site,
    belief: Belief,
    sortie: Sortie,
    read: Read,
    planner: SequentialGreedyPlanner,
    *,
    every_s: float = EVERY_S,
) -> Sortie:
    """The sortie as it would be flown live.

    Args:
        site: where.
        belief: before it.
        sortie: what the vehicles have on board when they take off.
        read: takes the readings at cells.
        planner: chooses what is read.
        every_s: seconds between two plans.
    """
    flights = {f.uav: f for f in sortie.flights}
    known = np.zeros(site.grid.shape, dtype=bool)
    moment, tried, flown = every_s, 0, 0
    while any(_under_way(f, moment) for f in flights.values()):
        fresh = known.copy()
        for f in flights.values():
            cells = site.space.cells_read(_until(f, moment))
            fresh[cells[:, 0], cells[:, 1]] = f.delay_s < moment
        new = np.argwhere(fresh & ~known)
        if len(new):
            belief = belief.updated(read(new))
        known = fresh
        for flight in _planned(site, ahead_of(belief), list(flights.values()), moment, planner):
            others = [f for f in flights.values() if f.uav != flight.uav]
            tried += 1
            if _clear(site, flight, others, moment):
                flights[flight.uav] = flight
                flown += 1
        moment += every_s
    note = f"{flown} of {tried} new ways were clear of the others"
    return replace(sortie, flights=tuple(flights.values()), notes=(note,))


def _under_way(flight: Flight, moment: float) -> bool:
    reached = flight.timeline.reached_s
    return bool(reached[0] <= moment + LEAD_S and moment + _LANDING_S < reached[-1])


def _until(flight: Flight, moment: float) -> NDArray[np.float64]:
    """``[n, (x, y)]`` what of a flight is flown at a moment."""
    line, route = flight.timeline, flight.route_m[:, :2]
    passed = int(np.searchsorted(line.reached_s, moment, side="right"))
    if passed in (0, len(route)):
        return route[: max(1, passed)]
    return np.vstack([route[:passed], line.ticks_m[int(moment / TICK_S), :2]])


def _planned(
    site: Site,
    belief: Belief,
    flights: Sequence[Flight],
    moment: float,
    planner: SequentialGreedyPlanner,
) -> list[Flight]:
    """New flights that go on as the old ones for `LEAD_S` after ``moment``."""
    due = [f for f in flights if _under_way(f, moment)]
    others = [f.read_cells for f in flights if not _under_way(f, moment)]
    starts = []
    for f in due:
        vertical_s = f.air_s - way_seconds(f.route_m, f.speed_mps, f.stops)
        left_s = site.request.usable_s - vertical_s
        starts.append(Start(f.uav, _until(f, moment + LEAD_S), left_s))
    theirs = np.concatenate([np.empty((0, 2), dtype=np.int64), *others])
    found = plan_tours(site, belief, starts, planner.noise_db2, planner.weighted, known=theirs)
    return [replace(new[0], delay_s=f.delay_s) for f, new in zip(due, found, strict=True) if new]


def _clear(site: Site, flight: Flight, others: Sequence[Flight], moment: float) -> bool:
    """Whether a new flight keeps its distance from what others fly from a moment on."""
    line, request = _rest(flight.timeline, moment), site.request
    return all(
        first_conflict(line, _rest(o.timeline, moment), request.speed_mps, request.separation_m)
        is None
        for o in others
    )


def _rest(line: Timeline, moment: float) -> Timeline:
    """What comes after a moment at which the vehicle is seen where it should be."""
    at = min(int(moment / TICK_S), len(line.ticks_m) - 1)
    slip = line.slip_s[at:]
    return Timeline(line.ticks_m[at:], slip - slip[0] + SLIP_S, np.empty(0), line.landed_s - moment)
