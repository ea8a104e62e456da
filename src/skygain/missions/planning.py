"""The next sortie: where the planner wants readings, within what batteries and rules allow.

Sequential greedy plans closed tours of straight legs (`skygain.missions.tours`); other planners
choose cells one after another, and their stairs are straightened.
"""

from __future__ import annotations

__all__ = ["Leftover", "check_battery", "expected_error", "plan_sortie", "staggered"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from skygain.flight.airspace import followed
from skygain.flight.swarm import FlightRules, Swarm
from skygain.flight.ways import steps_between
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.missions.clearance import straightened
from skygain.missions.imagined import ahead_of, with_expected
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie, corners, flight_along
from skygain.missions.timing import TICK_S, clear_delays, way_seconds
from skygain.missions.tours import Start, plan_tours, toured
from skygain.planners.base import Planner
from skygain.planners.sequential_greedy import SequentialGreedyPlanner
from skygain.predictors.base import Belief

_COMMITTED = 0.75
"""share of a plan that is flown before the next, since nothing is learnt in between"""
_SHORTEST_REFLY = 4
_STAIRS = 0.75
"""cells that a leg may lie off a run that is flown again"""
_STAGGER_S = 5.0
"""take-offs are staggered by multiples of this"""

Told = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Leftover:
    """A part of a flight that was planned and not flown."""

    cells: NDArray[np.int64]
    """``[k, (row, col)]`` cells to be read, in order"""
    legs_m: NDArray[np.float64]
    """``[n, (x, y)]`` clear legs over them"""

    @classmethod
    def of(cls, flight: Flight, first: int, last: int, grid: Grid) -> Leftover:
        """What of a flight leads over its cells from number ``first`` on, to before ``last``."""
        moments_s = flight.moments_s(grid.xy_m(flight.cells[:last]))
        line, (start_s, end_s) = flight.timeline, moments_s[[first, -1]]
        between = flight.route_m[(line.reached_s > start_s) & (line.reached_s < end_s), :2]
        ends = line.ticks_m[np.rint(np.array([start_s, end_s]) / TICK_S).astype(int), :2]
        return cls(flight.cells[first:last], corners(np.vstack([ends[0], between, ends[1]])))

    def reversed(self) -> Leftover:
        """The same flown the other way round."""
        return Leftover(self.cells[::-1], self.legs_m[::-1])


@threadpool_limits.wrap(limits=1, user_api="blas")
def plan_sortie(
    site: Site,
    belief: Belief,
    planner: Planner,
    rng: np.random.Generator,
    *,
    number: int = 1,
    uavs: Sequence[int] | None = None,
    leftover: Sequence[Leftover] = (),
    told: Told = lambda done, total: None,
) -> Sortie:
    """The flights that teach most, each within its battery and clear of everything and everyone.

    Args:
        site: where.
        belief: what is known so far.
        planner: chooses what is read.
        rng: the planner's randomness.
        number: of the sortie.
        uavs: numbers of those that fly; all when left out.
        leftover: what was planned before and not flown; it is flown first.
        told: hears how many steps of how many are planned.

    Raises:
        InputError: no UAV can fly and come back.
    """
    chosen = list(range(len(site.pads))) if uavs is None else list(uavs)
    if not chosen:
        raise InputError("every UAV stays on the ground; leave one out of `without`")
    check_battery(site, chosen)
    belief = ahead_of(belief)
    if toured(planner):
        found = _toured(site, belief, planner, chosen, leftover, told)
    else:
        paths = _paths(site, belief, planner, rng, chosen, leftover, told)
        found = [
            [flight] if (flight := _longest(site, uav, path)) is not None else []
            for uav, path in zip(chosen, paths, strict=True)
        ]
    before_db = expected_error(site, belief)
    flights, notes = staggered(site, chosen, found)
    if not flights:
        raise InputError(
            "no UAV can measure anything and come back; give a larger `battery_min`, a smaller "
            "`reserve_percent` or another `home`"
        )
    planned = np.unique(np.concatenate([f.read_cells for f in flights]), axis=0)
    after_db = expected_error(site, with_expected(belief, planned))
    cells = {tuple(cell) for cell in planned.tolist()}
    refly = sum(tuple(c) in cells for run in leftover for c in run.cells.tolist())
    return Sortie(number, tuple(flights), before_db, after_db, refly, tuple(notes))


def expected_error(site: Site, belief: Belief) -> float:
    """Root mean square of the map's predicted standard deviation."""
    return belief.posterior().expected_rmse_db(site.scenario.outdoor)


def check_battery(site: Site, uavs: Sequence[int]) -> None:
    """Raise `InputError` unless every UAV can climb, fly to its first cell, and land."""
    for uav in uavs:
        least = flight_along(site, uav, site.pads[uav].cell[None], site.ways_home[uav])
        if least.air_s > site.request.usable_s:
            raise InputError(
                f"the battery is too small to come back: climb to {site.request.altitude_m:g} m "
                f"and landing alone take {least.air_s / 60:.1f} min of the "
                f"{site.request.usable_s / 60:.1f} min that {site.request.battery_min:g} min and a "
                f"reserve of {site.request.reserve_percent:g} % leave; give a larger `battery_min` "
                "or fly lower"
            )


def _toured(
    site: Site,
    belief: Belief,
    planner: Planner,
    uavs: Sequence[int],
    leftover: Sequence[Leftover],
    told: Told,
) -> list[list[Flight]]:
    """For each UAV its tour, and the same the other way round where it may be flown so."""
    assert isinstance(planner, SequentialGreedyPlanner)
    starts = []
    for uav, run in zip(uavs, _assigned(site, uavs, leftover), strict=True):
        left_s = site.request.usable_s - _vertical_s(site, uav)
        starts.append(Start(uav, _first_legs(site, uav, run, left_s), left_s))
    return plan_tours(site, belief, starts, planner.noise_db2, planner.weighted, told)


def _vertical_s(site: Site, uav: int) -> float:
    """Seconds of climb and landing."""
    hover = flight_along(site, uav, site.pads[uav].cell[None], site.ways_home[uav])
    return hover.air_s - way_seconds(hover.route_m, hover.speed_mps, hover.stops)


def _first_legs(site: Site, uav: int, run: Leftover | None, left_s: float) -> NDArray[np.float64]:
    """``[n, (x, y)]`` from the pad along as much of ``run`` as leaves time to come home; the pad
    alone without a run."""
    if run is not None:
        ways, grid = site.ways_home[uav], site.grid
        there, legs = ways.way(run.cells[0])[::-1], run.legs_m
        while len(legs) > 1 and site.space.clear(np.vstack([there[-1], legs[0]])):
            line = corners(np.vstack([there, legs]))
            line = corners(straightened(site.space, line, _STAIRS * grid.spacing_m))
            back = ways.way(grid.cells_at(legs[-1:])[0])
            whole = np.vstack([line, back])
            if way_seconds(whole, site.request.speed_mps) <= left_s and site.space.clear(whole):
                return line
            legs = legs[:-1]
    return site.pads[uav].xy_m[None]


def _paths(
    site: Site,
    belief: Belief,
    planner: Planner,
    rng: np.random.Generator,
    uavs: Sequence[int],
    leftover: Sequence[Leftover],
    told: Told,
) -> NDArray[np.int64]:
    """``[uav, step, (row, col)]`` cells the planner would visit, longer than a battery lasts."""
    spacing, request = site.grid.spacing_m, site.request
    start = np.array([site.pads[u].cell for u in uavs])
    apart = request.separation_m
    for i, one in enumerate(start):
        for other in start[:i]:
            apart = min(apart, float(np.hypot(*(one - other))) * spacing)
    steps = max(1, int(request.usable_s * request.speed_mps / spacing))
    rules = FlightRules(min_distance_m=apart)
    swarm = Swarm.deployed(site.scenario, start, steps, rules)

    belief = with_expected(belief, start)
    nothing = np.empty((0, 2), dtype=np.int64)
    ahead = [run.cells if run else nothing for run in _assigned(site, uavs, leftover)]
    alive = np.ones(len(uavs), dtype=bool)
    while alive.any() and swarm.flying.any():
        plan = planner.plan(swarm, belief, int(swarm.steps_left.max()), rng)
        commit = max(plan.commit_steps, int(_COMMITTED * plan.n_steps))
        paths = plan.paths
        if any(len(run) for run in ahead):
            routes = [
                _route_to(site, swarm.cells[i], run) if len(run) else paths[i]
                for i, run in enumerate(ahead)
            ]
            commit = min(commit, 15, int(swarm.steps_left.max()))
            paths = followed(swarm, routes, commit)
        for cells in paths.transpose(1, 0, 2)[1 : commit + 1]:
            swarm = swarm.advanced(cells)
        flown = paths[:, 1 : commit + 1]
        ahead = [_without(run, flown[i]) for i, run in enumerate(ahead)]
        belief = with_expected(belief, flown)
        for i, uav in enumerate(uavs):
            if alive[i]:
                alive[i] = _seconds(site, uav, swarm.history[i]) <= request.usable_s
        told(swarm.steps_flown, steps)
    return swarm.history


def _seconds(site: Site, uav: int, cells: NDArray[np.int64]) -> float:
    return flight_along(site, uav, cells, site.ways_home[uav]).air_s


def _assigned(
    site: Site, uavs: Sequence[int], leftover: Sequence[Leftover]
) -> list[Leftover | None]:
    """For each UAV what was left over nearest to its pad, its nearer end first; longer runs choose
    first."""
    ahead: list[Leftover | None] = [None for _ in uavs]
    flyable = site.scenario.flyable
    for run in sorted(leftover, key=lambda run: len(run.cells), reverse=True):
        free = [i for i in range(len(uavs)) if ahead[i] is None]
        flies = flyable[run.cells[:, 0], run.cells[:, 1]].all()
        if len(run.cells) < _SHORTEST_REFLY or not free or not flies:
            continue
        way = [
            [site.ways_home[uavs[i]].distance_m[tuple(run.cells[end])] for end in (0, -1)]
            for i in free
        ]
        k, end = np.unravel_index(int(np.argmin(way)), (len(free), 2))
        ahead[free[int(k)]] = run.reversed() if end else run
    return ahead


def _route_to(site: Site, cell: NDArray[np.int64], run: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells of the shortest way from ``cell`` to the first of ``run``, and on along it as far as it
    is joined."""
    steps = steps_between(site.scenario.flyable, run[0])
    route = [np.asarray(cell)]
    while steps[tuple(route[-1])] > 0:
        here = route[-1]
        near = here + np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])
        near = near[site.grid.contains(near)]
        found = near[steps[near[:, 0], near[:, 1]] == steps[tuple(here)] - 1]
        route.append(found[0])
    for after in run[1:]:
        if np.abs(after - route[-1]).sum() != 1:
            break
        route.append(after)
    return np.array(route)


def _without(run: NDArray[np.int64], flown: NDArray[np.int64]) -> NDArray[np.int64]:
    """What is left of ``run`` after ``flown``."""
    if not len(run):
        return run
    seen = {tuple(cell) for cell in flown.tolist()}
    return np.array([c for c in run.tolist() if tuple(c) not in seen], dtype=np.int64).reshape(
        -1, 2
    )


def _longest(site: Site, uav: int, path: NDArray[np.int64]) -> Flight | None:
    """The longest beginning of ``path`` that the battery allows."""
    ways, usable = site.ways_home[uav], site.request.usable_s
    low, high = 0, len(path)
    best: Flight | None = None
    while low < high:
        middle = (low + high + 1) // 2
        flight = flight_along(site, uav, path[:middle], ways)
        if flight.air_s <= usable:
            best, low = flight, middle
        else:
            high = middle - 1
    return best


def staggered(
    site: Site, uavs: Sequence[int], found: Sequence[Sequence[Flight]]
) -> tuple[list[Flight], list[str]]:
    """One of each UAV's flights, with the smallest delays that keep them apart."""
    flights: list[Flight] = []
    notes: list[str] = []
    for uav, options in zip(uavs, found, strict=True):
        if not options:
            notes.append(f"UAV {uav} stays on the ground: its battery is too small")
            continue
        last = max((f.timeline.landed_s for f in flights), default=0.0)
        delays = np.arange(0.0, last + 4 * _STAGGER_S, _STAGGER_S)
        clear = np.array([_clear(site, one, flights, delays) for one in options])
        first = np.where(clear.any(axis=1), clear.argmax(axis=1), len(delays) - 1)
        best = int(first.argmin())
        delay = float(delays[first[best]])
        flights.append(replace(options[best], delay_s=delay))
        if delay > last:
            notes.append(f"UAV {uav} takes off after the others have landed, to keep its distance")
    return flights, notes


def _clear(
    site: Site, flight: Flight, others: Sequence[Flight], delays: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """``[delay]`` whether the flight keeps its distance from others when it takes off so late."""
    speed, apart = site.request.speed_mps, site.request.separation_m
    clear = np.ones(len(delays), dtype=bool)
    for other in others:
        clear &= clear_delays(flight.timeline, other.timeline, speed, apart, delays)
    return clear
