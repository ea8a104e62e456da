"""New ways for a vehicle in the air: the next part of its tour, or cells one after another."""

from __future__ import annotations

__all__ = ["LiveSettings", "Moment", "NewWays"]

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skygain.flight.swarm import Swarm
from skygain.missions.imagined import with_expected
from skygain.missions.rider import Rider
from skygain.missions.site import Site
from skygain.missions.sortie import Flight, flight_along
from skygain.missions.timing import DESCENT_MPS, way_seconds
from skygain.missions.tours import Start, plan_tours, toured
from skygain.planners.base import Planner
from skygain.planners.sequential_greedy import SequentialGreedyPlanner
from skygain.predictors.base import Belief

_SHARES = (1.0, 0.7, 0.4, 0.2)
"""of a new way, tried in this order until it is clear of the others"""


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


@dataclass(frozen=True)
class Moment:
    """When a new way is planned; seconds of the vehicles."""

    now_s: float
    """since the flight began"""
    ago_s: float
    """since the vehicle's place was heard"""
    lead_s: float
    """until the new way leaves the old one"""


class NewWays:
    """Finds them.

    Args:
        site: where.
        planner: chooses what is read.
        settings: how the flight is led.
        rng: the planner's randomness.
    """

    def __init__(
        self, site: Site, planner: Planner, settings: LiveSettings, rng: np.random.Generator
    ) -> None:
        self.site, self.settings = site, settings
        self._planner, self._random = planner, rng

    def ways(
        self,
        rider: Rider,
        others: Sequence[Rider],
        belief: Belief,
        moment: Moment,
        *,
        near_miss: bool = False,
    ) -> Iterator[Flight]:
        """New flights for a vehicle in the air, the one that teaches most first.

        Args:
            rider: the vehicle.
            others: what they will read teaches nothing twice.
            belief: what is known, ready for readings that are only expected.
            moment: when.
            near_miss: also one that is home soon.
        """
        left_s = self.site.request.usable_s - (moment.now_s - rider.up_s)
        if toured(self._planner):
            yield from self._tours(rider, others, belief, moment, left_s, near_miss)
        else:
            yield from self._along_cells(rider, others, belief, moment, left_s)

    def _tours(
        self,
        rider: Rider,
        others: Sequence[Rider],
        belief: Belief,
        moment: Moment,
        left_s: float,
        near_miss: bool,
    ) -> Iterator[Flight]:
        """A tour from where a vehicle will be into the later part of its old one, or home where
        that is near or two may meet."""
        site, planner, old = self.site, self._planner, rider.flight
        assert isinstance(planner, SequentialGreedyPlanner)
        ahead = rider.ahead(
            site.grid, moment.now_s, moment.ago_s, moment.lead_s, self.settings.horizon_s
        )
        if ahead is None or not site.space.clear(ahead.lead_m):
            return
        left_s -= float(old.heights_m[-1]) / DESCENT_MPS
        theirs = [r.flight.read_cells[r.done :] for r in others]
        known = np.concatenate([np.empty((0, 2), dtype=np.int64), *theirs])
        starts, horizon_s = [], self.settings.horizon_s
        if len(ahead.later_m):
            # what takes no longer than before leaves the later part's times as they were
            most_s = min(left_s, ahead.rest_s)
            starts = [Start(rider.uav, ahead.lead_m, most_s, ahead.later_m, ahead.home_m)]
        if near_miss or not starts:
            way = site.ways_home[rider.uav].way(site.grid.cells_at(ahead.lead_m[-1]))
            shortest_s = way_seconds(np.vstack([ahead.lead_m, way]), old.speed_mps)
            starts.append(Start(rider.uav, ahead.lead_m, min(left_s, shortest_s + 2 * horizon_s)))
        for start in starts:
            found = plan_tours(
                site, belief, [start], planner.noise_db2, planner.weighted, known=known, rounds=1
            )[0]
            if found:
                yield replace(found[0], airborne=True)

    def _along_cells(
        self,
        rider: Rider,
        others: Sequence[Rider],
        belief: Belief,
        moment: Moment,
        left_s: float,
    ) -> Iterator[Flight]:
        """Along the cells that the planner chooses one after another, by less and less of them."""
        site, old = self.site, rider.flight
        steps = max(1, int(moment.lead_s * old.speed_mps / site.grid.spacing_m))
        turn = min(rider.done + steps, len(old.cells) - 1)
        cell = old.cells[turn]
        place = rider.place_m(site.grid)
        lead = np.vstack([place[None], site.grid.xy_m(old.cells[rider.done : turn])])
        if not site.space.clear(np.vstack([lead, site.grid.xy_m(cell)[None]])):
            return
        coming = np.vstack([self._coming(others, cell), old.cells[rider.done : turn + 1]])
        path = self._path(with_expected(belief, coming), cell)
        for share in _SHARES:
            cells = np.vstack(
                [old.cells[rider.done : turn], path[: max(1, int(share * len(path)))]]
            )
            flight = self._within(rider.uav, cells, turn - rider.done, lead[:1], left_s)
            if flight is None:
                return
            yield flight

    def _coming(self, others: Sequence[Rider], cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Every second cell that the others will read soon, and near enough to matter."""
        ahead = self.settings.ahead_cells
        theirs = [r.flight.cells[r.done : r.done + 2 * ahead : 2] for r in others]
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
