"""Closed tours that teach most for their time.

Every tour begins where its UAV is and ends at its home. Place after place enters where it adds the
most per second: the fall of the expected squared error of the map by all that is read on the way
there and back, over the flight time that the detour takes. What one UAV will read teaches nothing
twice, so the tours part the area among themselves.
"""

from __future__ import annotations

__all__ = ["Start", "Tour", "find_tours", "plan_tours", "toured"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skygain.missions.clearance import straightened
from skygain.missions.lessons import Lessons
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, corners, flight_over
from skygain.missions.streets import Streets
from skygain.missions.timing import ACCELERATION_MPS2, corner_seconds, way_seconds
from skygain.planners.base import Planner
from skygain.planners.sequential_greedy import SequentialGreedyPlanner
from skygain.predictors.base import Belief

_BEND_CELLS = 2.0
"""cells that a leg may lie off the places it was planned by"""
_ENDED_S = 15.0
"""a tour with more time left than this ended for want of lessons"""
_SLACK_S = 4.0
"""seconds of battery that may be left unused"""
_WORTH = 0.05
"""a detour has to teach at least this share, per second, of what the tours teach so far"""
_TRIED = 24
"""candidates whose gain is computed exactly before one is taken"""


@dataclass(frozen=True, eq=False)
class Start:
    """Where one UAV's tour begins."""

    uav: int
    """its number"""
    flown_m: NDArray[np.float64]
    """``[n, (x, y)]`` what it has flown or will fly in any case; the tour begins at its end"""
    left_s: float
    """seconds for all of it from the first of these points home, without climb and landing"""
    later_m: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    """``[m, (x, y)]`` legs that follow in any case; the tour ends at the first of these points
    instead of its home"""
    home_m: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    """``[n, (x, y)]`` legs home from the last of those"""

    @property
    def anyway_m(self) -> tuple[NDArray[np.float64], ...]:
        """The ways ``[n, (x, y)]`` before and after the tour."""
        if not len(self.later_m):
            return (self.flown_m,)
        return self.flown_m, np.vstack([self.later_m, self.home_m[1:]])

    @property
    def heading(self) -> NDArray[np.float64]:
        """Unit vector in which it comes; zero at rest."""
        if len(self.flown_m) < 2:
            return np.zeros(2)
        step = self.flown_m[-1] - self.flown_m[-2]
        return np.asarray(step / max(float(np.hypot(*step)), 1e-9))


@dataclass(frozen=True)
class Tour:
    """What one UAV would fly, as places of the streets."""

    stops: tuple[int, ...]
    """places it was sent to, the first where it begins, the last its home"""
    seconds: float
    """about so long it takes, without climb and landing"""
    entered: tuple[int, ...] = ()
    """the places between the two in the order in which they entered, which is that of their
    worth"""

    def without_last(self) -> Tour:
        """Without the place that entered last."""
        *kept, last = self.entered
        at = len(self.stops) - 2 - self.stops[-2:0:-1].index(last)
        return replace(self, stops=self.stops[:at] + self.stops[at + 1 :], entered=tuple(kept))

    def legs_m(self, streets: Streets) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``[n, (x, y)]`` corners up to the last place it was sent to, and from there home."""
        tolerance = _BEND_CELLS * streets.space.grid.spacing_m
        out = [self.stops[0]]
        for one, other in pairwise(self.stops[:-1]):
            out += streets.way(one, other)[1:]
        home = streets.way(self.stops[-2], self.stops[-1])
        first, last = (
            corners(straightened(streets.space, streets.xy_m[places], tolerance))
            for places in (out, home)
        )
        return first, last


def plan_tours(
    site: Site,
    belief: Belief,
    starts: Sequence[Start],
    noise_db2: float,
    weighted: bool,
    told: Callable[[int, int], None] = lambda done, total: None,
    known: NDArray[np.int64] | None = None,
    rounds: int = 2,
) -> list[list[Flight]]:
    """For each start its flight, and the same the other way round where all of it is still to be
    flown; none where the battery does not even bring it home.

    Args:
        site: where.
        belief: what is known so far, ready for readings that are only expected.
        starts: where tours begin.
        noise_db2: variance of a planned reading.
        weighted: see `SequentialGreedyPlanner`.
        told: hears how many rounds of how many are done.
        known: ``[k, (row, col)]`` cells that others will read.
        rounds: so often tours are found, after the first time with what their legs really take.
    """
    streets, speed = Streets.of(site.space), site.request.speed_mps
    left = np.array([one.left_s - _anyway_s(one, speed) for one in starts])
    k = len(starts)
    begins = [one.flown_m[-1] for one in starts]
    ends = [one.later_m[0] if len(one.later_m) else site.pads[one.uav].xy_m for one in starts]
    near = streets.within(list(zip(begins, ends, strict=True)), (left * speed).tolist())
    joined = near.joined(np.array([*begins, *ends]))
    n = len(near.places)
    if not np.isfinite(joined.length_m[np.arange(n, n + k), np.arange(n + k, n + 2 * k)]).all():
        near, n = streets, len(streets.places)
        joined = near.joined(np.array([*begins, *ends]))
    mine = [site.space.cells_read(way) for one in starts for way in one.anyway_m]
    theirs = np.concatenate([*mine, np.empty((0, 2), np.int64) if known is None else known])
    lessons = Lessons.about(belief, joined.sites, noise_db2, weighted=weighted)
    known_sites = joined.sites_at(theirs)
    best: list[list[Flight]] = [[] for _ in starts]
    most = -np.inf
    for round_ in range(rounds):
        tours = find_tours(
            joined,
            lessons,
            range(n, n + k),
            range(n + k, n + 2 * k),
            left.tolist(),
            speed,
            np.array([one.heading for one in starts]),
            known_sites,
        )
        told(round_ + 1, rounds)
        flights = [_flights(site, joined, one, t) for one, t in zip(starts, tours, strict=True)]
        over = np.array([_over_s(f[0], one) for f, one in zip(flights, starts, strict=True)])
        fitted = [
            found if late <= 0 else _in_time(site, joined, one, tour)
            for found, late, one, tour in zip(flights, over, starts, tours, strict=True)
        ]
        # tours of one round part the area; those of two rounds may be the same twice
        read = [f[0].read_cells for f in fitted if f]
        sites = joined.sites_at(np.concatenate([theirs, *read]))
        lessons.begin(np.empty(0, dtype=np.int64))
        taught = lessons.gain(sites) if len(sites) else 0.0
        if taught > most:
            best, most = fitted, taught
        # who ended with time left found nothing worth it
        ended = np.array([left_s - t.seconds for left_s, t in zip(left, tours, strict=True)])
        if ((over <= 0) & ((over > -_SLACK_S) | (ended > _ENDED_S))).all():
            break
        left = left - over - np.where(over > 0, 1.0, 0.0)
    return best


def _over_s(flight: Flight, start: Start) -> float:
    """Seconds that a flight takes more than there are."""
    return way_seconds(flight.route_m, flight.speed_mps, flight.stops) - start.left_s


def _in_time(site: Site, streets: Streets, start: Start, tour: Tour) -> list[Flight]:
    """The flights of what is left of a tour when it is cut until it comes home in time; none where
    even the way home takes too long."""
    while tour.entered:
        tour = tour.without_last()
        flights = _flights(site, streets, start, tour)
        if _over_s(flights[0], start) <= 0:
            return flights
    return []


def toured(planner: Planner) -> bool:
    """Whether a planner's sorties are tours."""
    return isinstance(planner, SequentialGreedyPlanner) and planner.objective == "variance"


def _anyway_s(start: Start, speed_mps: float) -> float:
    """Seconds until the tour begins and after it ends, at full speed there."""
    return sum(
        way_seconds(way, speed_mps) - speed_mps / (2 * ACCELERATION_MPS2)
        for way in start.anyway_m
        if len(way) > 1
    )


def _flights(site: Site, streets: Streets, start: Start, tour: Tour) -> list[Flight]:
    """The flight of a tour, and the other way round where it begins at rest."""
    out, home = tour.legs_m(streets)
    if len(start.later_m):
        out, home = np.vstack([out, home[1:], start.later_m[1:]]), start.home_m
    if len(start.flown_m) > 1:
        return [flight_over(site, start.uav, corners(np.vstack([start.flown_m, out[1:]])), home)]
    back, away = replace(tour, stops=tour.stops[::-1]).legs_m(streets)
    return [flight_over(site, start.uav, *legs) for legs in ((out, home), (back, away))]


def find_tours(
    streets: Streets,
    lessons: Lessons,
    starts: Sequence[int],
    homes: Sequence[int],
    seconds: Sequence[float],
    speed_mps: float,
    headings: NDArray[np.float64] | None = None,
    known: NDArray[np.int64] | None = None,
) -> list[Tour]:
    """One tour for each UAV, found together.

    Args:
        streets: where they fly.
        lessons: what is to be learnt.
        starts: place at which each begins.
        homes: place at which each ends.
        seconds: that each may fly, without climb and landing.
        speed_mps: along the legs.
        headings: ``[uav, (x, y)]`` unit vectors in which they come; zero for those at rest.
        known: numbers of sites that are read by others anyway.
    """
    theirs = np.empty(0, dtype=np.int64) if known is None else known
    lessons = lessons.after(theirs)
    search = _Search(streets, lessons, speed_mps)
    tours = [[a, b] for a, b in zip(starts, homes, strict=True)]
    entered: list[list[int]] = [[] for _ in tours]
    come = np.zeros((len(tours), 2)) if headings is None else headings
    took = [search.seconds(tour, way) for tour, way in zip(tours, come, strict=True)]

    def begin(before: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
        now = search.read(tours)
        if before is not None and np.isin(before, now).all():
            lessons.plan(now)
        else:
            lessons.begin(now)
        return now

    planned = begin()
    gained, spent = 0.0, 0.0
    left = np.array([s - t for t, s in zip(took, seconds, strict=True)])
    while (left > 0).any():
        # whoever has most time left is next, so that all are used and each gets its own part
        u = int(left.argmax())
        least = _WORTH * gained / max(spent, 1.0)
        found = search.best(tours[u], come[u], float(left[u]), least)
        if found is None:
            left[u] = -np.inf
            continue
        rate, position, place = found
        tours[u].insert(position, place)
        entered[u].append(place)
        before, took[u] = took[u], search.seconds(tours[u], come[u])
        left[u] = seconds[u] - took[u]
        gained += rate * (took[u] - before)
        spent += took[u] - before
        planned = begin(planned)
    return [Tour(tuple(t), s, tuple(e)) for t, s, e in zip(tours, took, entered, strict=True)]


class _Search:
    """Detours by what they add per second."""

    def __init__(self, streets: Streets, lessons: Lessons, speed_mps: float) -> None:
        self.streets, self.lessons, self.speed = streets, lessons, speed_mps
        self.out, self.into = streets.directions()
        self.seconds_of = streets.length_m / speed_mps

    def seconds(self, tour: Sequence[int], come: NDArray[np.float64]) -> float:
        """About the time of a tour from rest, or from full speed in the direction ``come``, to
        rest."""
        t = np.asarray(tour)
        total = float(self.seconds_of[t[:-1], t[1:]].sum())
        turn = (self.into[t[:-2], t[1:-1]] * self.out[t[1:-1], t[2:]]).sum(axis=1)
        ramps = 1.0
        if come.any():
            turn = np.append(turn, come @ self.out[t[0], t[1]])
            ramps = 0.5
        ends = ramps * self.speed / ACCELERATION_MPS2
        return total + float(corner_seconds(turn, self.speed).sum()) + ends

    def read(self, tours: Sequence[Sequence[int]]) -> NDArray[np.int64]:
        """Sites read on tours."""
        found = np.zeros(len(self.lessons.among), dtype=bool)
        for tour in tours:
            for a, b in pairwise(tour):
                found |= self.streets.reads(a)[b]
        return np.flatnonzero(found)

    def best(
        self,
        tour: Sequence[int],
        come: NDArray[np.float64],
        left_s: float,
        least: float,
    ) -> tuple[float, int, int] | None:
        """Gain per second, position and place of the best detour of a tour, if any is better than
        ``least``."""
        single = self.lessons.single
        ends = np.array(tour)
        one, other = ends[:-1], ends[1:]
        n = len(self.streets.places)
        more = self.seconds_of[one] + self.seconds_of[other] - self.seconds_of[one, other][:, None]
        more += self._corners(come, one, other)
        more = np.maximum(more, 0.2)
        reads = np.stack(
            [self.streets.reads(a) | self.streets.reads(b) for a, b in zip(one, other, strict=True)]
        )
        fits = more <= left_s
        rate = np.where(fits, (reads @ single) / more, 0.0)
        order = np.argsort(-rate, axis=None)[:_TRIED]
        best, found = least, None
        for flat in order:
            position, place = divmod(int(flat), n)
            if rate[position, place] <= best:
                break
            sites = np.flatnonzero(reads[position, place] & ~self.lessons.planned)
            exact = self.lessons.gain(sites) / more[position, place] if len(sites) else 0.0
            if exact > best:
                best, found = exact, (exact, position + 1, place)
        return found

    def _corners(
        self, come: NDArray[np.float64], one: NDArray[np.int64], other: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """``[position, place]`` seconds that a detour adds at corners."""

        def cost(first, second):  # type: ignore[no-untyped-def]
            return corner_seconds((first * second).sum(axis=-1), self.speed)

        added = cost(self.into[one], self.out[:, other].transpose(1, 0, 2))
        for k in range(len(one)):
            if k > 0:
                come = self.into[one[k - 1], one[k]]
            if come.any():
                added[k] += cost(come, self.out[one[k]]) - cost(come, self.out[one[k], other[k]])
            if k + 1 < len(one):
                go = self.out[other[k], other[k + 1]]
                added[k] += cost(self.into[:, other[k]], go) - cost(self.into[one[k], other[k]], go)
        return added
