"""The next sortie: where the planner wants readings, within what batteries and rules allow."""

from __future__ import annotations

__all__ = ["plan_sortie"]

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from skygain.flight.airspace import followed
from skygain.flight.swarm import FlightRules, Swarm
from skygain.flight.ways import steps_between
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.missions.imagined import ahead_of, with_expected
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, Sortie, flight_along
from skygain.missions.timing import first_conflict
from skygain.planners.base import Planner
from skygain.predictors.base import Belief

_COMMITTED = 0.75
"""share of a plan that is flown before the next, since nothing is learnt in between"""
_SHORTEST_REFLY = 4
_DELAYS_S = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 240.0)
"""stagger of take-offs, tried in this order"""
_CUTS = 6
"""so often a flight is cut short before it waits for the others to land"""

Told = Callable[[int, int], None]
Read = Callable[[NDArray[np.int64]], Measurements]


@threadpool_limits.wrap(limits=1, user_api="blas")
def plan_sortie(
    site: Site,
    belief: Belief,
    planner: Planner,
    rng: np.random.Generator,
    *,
    number: int = 1,
    uavs: Sequence[int] | None = None,
    leftover: Sequence[NDArray[np.int64]] = (),
    read: Read | None = None,
    told: Told = lambda done, total: None,
) -> Sortie:
    """The flights that teach most, each within its battery and clear of everything and everyone.

    Args:
        site: where.
        belief: what is known so far.
        planner: chooses the cells.
        rng: the planner's randomness.
        number: of the sortie.
        uavs: numbers of those that fly; all when left out.
        leftover: runs of cells ``[k, (row, col)]`` that were planned before and not flown; they are
            flown first.
        read: takes the readings at cells as they are flown, where the flight is simulated and its
            vehicles are planned anew with them; otherwise what is expected is taken to be read.
        told: hears how many steps of how many are planned.

    Raises:
        InputError: no UAV can fly and come back.
    """
    chosen = list(range(len(site.pads))) if uavs is None else list(uavs)
    if not chosen:
        raise InputError("every UAV stays on the ground; leave one out of `without`")
    check_battery(site, chosen)
    paths = _paths(site, belief, planner, rng, chosen, leftover, read, told)
    belief = ahead_of(belief)
    before_db = expected_error(site, belief)
    flights, notes = _fitted(site, chosen, paths)
    if not flights:
        raise InputError(
            "no UAV can measure anything and come back; give a larger `battery_min`, a smaller "
            "`reserve_percent` or another `home`"
        )
    planned = np.unique(np.concatenate([f.cells for f in flights]), axis=0)
    after_db = expected_error(site, with_expected(belief, planned))
    cells = {tuple(cell) for cell in planned.tolist()}
    refly = sum(tuple(c) in cells for run in leftover for c in run.tolist())
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


def _paths(
    site: Site,
    belief: Belief,
    planner: Planner,
    rng: np.random.Generator,
    uavs: Sequence[int],
    leftover: Sequence[NDArray[np.int64]],
    read: Read | None,
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

    def after(belief: Belief, cells: NDArray[np.int64]) -> Belief:
        cells = cells.reshape(-1, 2)
        return with_expected(belief, cells) if read is None else belief.updated(read(cells))

    belief = after(belief if read else ahead_of(belief), start)
    ahead = _assigned(site, uavs, leftover)
    alive = np.ones(len(uavs), dtype=bool)
    while alive.any() and swarm.flying.any():
        plan = planner.plan(swarm, belief, int(swarm.steps_left.max()), rng)
        commit = max(plan.commit_steps, 0 if read else int(_COMMITTED * plan.n_steps))
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
        belief = after(belief, flown)
        for i, uav in enumerate(uavs):
            if alive[i]:
                alive[i] = _seconds(site, uav, swarm.history[i]) <= request.usable_s
        told(swarm.steps_flown, steps)
    return swarm.history


def _seconds(site: Site, uav: int, cells: NDArray[np.int64]) -> float:
    return flight_along(site, uav, cells, site.ways_home[uav]).air_s


def _assigned(
    site: Site, uavs: Sequence[int], leftover: Sequence[NDArray[np.int64]]
) -> list[NDArray[np.int64]]:
    """For each UAV the run that was left over nearest to its pad; longer runs choose first."""
    ahead = [np.empty((0, 2), dtype=np.int64) for _ in uavs]
    flyable = site.scenario.flyable
    for run in sorted(leftover, key=len, reverse=True):
        run = run[flyable[run[:, 0], run[:, 1]]]
        free = [i for i in range(len(uavs)) if not len(ahead[i])]
        if len(run) < _SHORTEST_REFLY or not free:
            continue
        way = [site.ways_home[uavs[i]].distance_m[tuple(run[0])] for i in free]
        ahead[free[int(np.argmin(way))]] = run
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


def _fitted(
    site: Site, uavs: Sequence[int], paths: NDArray[np.int64]
) -> tuple[list[Flight], list[str]]:
    """The flights cut to the battery, one after another clear of those before."""
    flights: list[Flight] = []
    notes: list[str] = []
    for uav, path in zip(uavs, paths, strict=True):
        flight = _longest(site, uav, path, len(path))
        if flight is None:
            notes.append(f"UAV {uav} stays on the ground: its battery is too small")
            continue
        flight, note = _apart(site, flight, flights)
        flights.append(flight)
        notes += note
    return flights, notes


def _longest(site: Site, uav: int, path: NDArray[np.int64], most: int) -> Flight | None:
    """The longest beginning of ``path``, of at most ``most`` cells, that the battery allows."""
    ways, usable = site.ways_home[uav], site.request.usable_s
    low, high = 0, min(most, len(path))
    best: Flight | None = None
    while low < high:
        middle = (low + high + 1) // 2
        flight = flight_along(site, uav, path[:middle], ways)
        if flight.air_s <= usable:
            best, low = flight, middle
        else:
            high = middle - 1
    return best


def _apart(site: Site, flight: Flight, others: Sequence[Flight]) -> tuple[Flight, list[str]]:
    """The flight with a delay, and cut short where need be, so that it keeps the separation."""
    speed, apart = site.request.speed_mps, site.request.separation_m
    cells = flight.cells

    def conflict(one: Flight) -> float | None:
        found = [first_conflict(one.timeline, o.timeline, speed, apart) for o in others]
        moments = [moment for moment in found if moment is not None]
        return min(moments) if moments else None

    for cut in range(_CUTS):
        best: tuple[float, Flight] | None = None
        for delay in _DELAYS_S:
            tried = replace(flight, delay_s=delay)
            moment = conflict(tried)
            if moment is None:
                note = []
                if cut:
                    note = [
                        f"UAV {flight.uav} turns home after {len(flight.cells)} of {len(cells)} "
                        "cells, to keep its distance from the others"
                    ]
                return tried, note
            if best is None or moment - delay > best[0]:
                best = (moment - delay, tried)
        assert best is not None
        reached = best[1].timeline.reached_s[: flight.measuring] - best[1].delay_s
        share = float((reached < best[0] - 10.0).mean())
        most = int(len(flight.cells) * min(share, 0.9))
        if most < len(cells) // 2:
            break
        flight = flight_along(site, flight.uav, flight.cells[:most], site.ways_home[flight.uav])
    whole = flight_along(site, flight.uav, cells, site.ways_home[flight.uav])
    wait = max(o.timeline.landed_s for o in others) + 10.0
    told = f"UAV {flight.uav} takes off after the others have landed, to keep its distance"
    return replace(whole, delay_s=float(np.ceil(wait))), [told]
