"""Sequential greedy planning: UAVs choose their paths one after another, each knowing what the
others will measure.

The first UAV takes the path that gains most, the second the path that gains most given the first
one's readings, and so on; then every UAV in turn plans again given all the others, until no one
gains. The cost grows linearly with the number of UAVs. Over short horizons, where searching is
cheap and UAVs are in each other's way, the same is done from several random joint paths too and the
best outcome is taken. The objective is one of

- ``variance``: Σ_x w(x)·(σ²(x) − σ²(x | S)) over outdoor unvisited cells x, the fall of the
  expected squared error, where w(x) = `skygain.planners.search.volatility.volatility` for a belief
  with a stationary prior and 1 otherwise;
- ``entropy``: F(S) = ½ log det(I + K_SS/σ²), which differs from the entropy of the readings by a
  constant per reading;
- ``mutual-information``: the information of the readings about the unvisited cells.

With ``entropy`` a plan carries a certificate (`skygain.planners.search.certificate`).
"""

from __future__ import annotations

__all__ = [
    "SequentialGreedyPlanner",
    "independent_greedy_planner",
    "tree_search_planner",
]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.fields.planning import PlanningField, planning_field
from skygain.flight.airspace import Airspace, followed
from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.planners.random_waypoint import RandomWaypointPlanner
from skygain.planners.search.certificate import certified
from skygain.planners.search.objectives import Objective
from skygain.planners.search.path_gain import path_value
from skygain.planners.search.path_search import beam_path, exact_path
from skygain.planners.search.reach import Attention, LocalReach
from skygain.planners.search.traffic import Traffic
from skygain.planners.search.tree_search import tree_path
from skygain.planners.search.volatility import volatility
from skygain.predictors.base import Belief

GAIN_SHARE = 1e-4
"""a new path replaces the old one in a sweep if it gains more than this share"""
MOST_SWEEPS = 4
"""rounds in which random joint paths are improved"""


@dataclass(frozen=True)
class SequentialGreedyPlanner(Planner):
    """Coordinated planning for any number of UAVs."""

    objective: str = "variance"
    """``"variance"``, ``"entropy"`` or ``"mutual-information"``"""
    horizon: int = 40
    """steps planned"""
    commit_steps: int = 15
    """steps flown before planning again"""
    sweeps: int = 1
    """most rounds in which every UAV plans again given the others"""
    width: int = 200
    """paths kept per depth of the beam search"""
    exact_horizon: int = 6
    """horizons up to this are searched exhaustively, UAV by UAV"""
    restarts: int = 6
    """random joint paths that are improved as well over horizons that are searched exhaustively"""
    tree_rounds: int = 0
    """rounds of Monte-Carlo tree search per path, which takes the beam's place if above 0"""
    stride: int | None = None
    """1 scores every cell of a path, 2 every second one; ``None`` takes 1 up to a horizon of 24 and
    2 beyond"""
    coordinated: bool = True
    """``False`` plans every UAV as if it were alone"""
    weighted: bool = True
    """weight the cells by the volatility that the predicted gain suggests, where the belief itself
    knows no difference"""
    noise_db2: float = 1.0
    """σ², noise variance of the readings in the objectives"""
    most_readings: int = 400
    """readings conditioned on per UAV, the nearest within its reach and twice ``target_range_m``"""
    most_targets: int = 500
    """cells per UAV that stand for the map in the objectives"""
    target_range_m: float = 60.0
    """how far beyond its reach a UAV looks for cells to learn about"""

    def __post_init__(self) -> None:
        Objective.named(self.objective)
        if (
            min(self.horizon, self.commit_steps, self.width) < 1
            or min(self.sweeps, self.tree_rounds, self.restarts) < 0
        ):
            raise InputError(
                "sequential greedy needs horizon, commit_steps, width >= 1 and sweeps, "
                "tree_rounds, restarts >= 0, got "
                f"{self.horizon}, {self.commit_steps}, {self.width} and {self.sweeps}, "
                f"{self.tree_rounds}, {self.restarts}"
            )
        if self.stride not in (None, 1, 2):
            raise InputError(f"stride must be 1, 2 or None, got {self.stride}")
        if not self.noise_db2 > 0:
            raise InputError(
                f"noise_db2 must be above 0, got {self.noise_db2}; give the variance of a "
                "reading's noise in dB²"
            )

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        steps = min(self.horizon, horizon)
        field = planning_field(belief)
        paths = followed(
            swarm, self._routes(swarm, field, self._weight(swarm, belief, field), steps, rng), steps
        )
        certificate = None
        if self.objective == "entropy":
            certificate = certified(swarm, field, paths, self.noise_db2, self.most_readings, rng)
        return Plan(paths, min(self.commit_steps, steps), certificate)

    def _weight(self, swarm: Swarm, belief: Belief, field: PlanningField) -> NDArray[np.float64]:
        """``[row, col]`` how much a cell's variance counts."""
        weight = (belief.scenario.outdoor & ~swarm.visited).astype(float)
        if self.weighted and self.objective == "variance" and field.kernel:
            weight *= volatility(field.posterior.mean_db)
        return weight

    def _routes(
        self,
        swarm: Swarm,
        field: PlanningField,
        weight: NDArray[np.float64],
        steps: int,
        rng: np.random.Generator,
    ) -> list[Cells]:
        """One route per UAV from its current cell, legal among each other up to hovering."""
        stride = self.stride or (1 if steps <= 24 else 2)
        air, flying = Airspace.of(swarm), np.flatnonzero(swarm.flying)
        ahead = np.minimum(steps, swarm.steps_left)
        attention = Attention(
            Objective.named(self.objective),
            self.noise_db2,
            stride,
            self.most_readings,
            self.most_targets,
            self.target_range_m,
        )
        reach = {
            int(u): LocalReach.around(field, swarm, int(u), int(ahead[u]), weight, attention)
            for u in flying
        }
        paths = np.repeat(swarm.cells[:, None], steps + 1, axis=1)
        settled = np.zeros(swarm.n_uavs, dtype=np.int64)
        search = _Search(
            self,
            swarm,
            air,
            reach,
            ahead,
            stride,
            2 * self.target_range_m / swarm.spacing_m + steps,
        )
        together = self.coordinated and len(flying) > 1
        search.improve(paths, settled, 1 + (self.sweeps if together else 0), rng)
        if together and steps <= self.exact_horizon and not self.tree_rounds and self.restarts:
            best = search.value(paths, settled)
            for _ in range(self.restarts):
                try:
                    other = RandomWaypointPlanner().paths(swarm, steps, rng)
                except InputError:  # a random walk may find no common way home
                    break
                known = ahead.copy()
                search.improve(other, known, 1 + MOST_SWEEPS, rng)
                if (value := search.value(other, known)) > best * (1 + GAIN_SHARE):
                    best, paths, settled = value, other, known
        return [paths[u, : settled[u] + 1] for u in range(swarm.n_uavs)]


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for one decision's paths: every UAV in turn, given the others."""

    planner: SequentialGreedyPlanner
    swarm: Swarm
    air: Airspace
    reach: dict[int, LocalReach]
    ahead: NDArray[np.int64]  # [uav] steps to plan
    stride: int
    span: float  # cells around a UAV in which others' readings matter to it

    def improve(
        self, paths: Cells, settled: NDArray[np.int64], rounds: int, rng: np.random.Generator
    ) -> None:
        """Let every UAV plan in turn, up to ``rounds`` times until none gains.

        ``paths[uav, step, (row, col)]`` and ``settled[uav]``, the steps planned so far, are changed
        in place.
        """
        planner, swarm, ahead, stride, air = (
            self.planner,
            self.swarm,
            self.ahead,
            self.stride,
            self.air,
        )
        flying = np.array(list(self.reach), dtype=np.int64)
        for _ in range(rounds):
            gained = False
            for u in rng.permutation(flying):
                planned = np.empty((0, 2), np.int64)
                if planner.coordinated:
                    planned = _planned_cells(paths, settled, int(u), stride, self.span)
                here = self.reach[u].given(planned)
                traffic = Traffic.around(int(u), paths, settled, swarm.steps_left, air.min_cells)
                order = rng.permutation(4)
                start = swarm.cells[u], ahead[u]
                if planner.tree_rounds:
                    draws = rng.random((planner.tree_rounds, ahead[u], 5))
                    path, value = tree_path(u, *start, draws, here, traffic, air)
                elif ahead[u] <= planner.exact_horizon:
                    path, value = exact_path(u, *start, order, here, traffic, air)
                else:
                    path, value = beam_path(
                        u, *start, planner.width, stride == 1, order, here, traffic, air
                    )
                if settled[u] and value <= path_value(paths[u, : settled[u] + 1], here) * (
                    1 + GAIN_SHARE
                ):
                    continue
                gained = True
                settled[u] = len(path) - 1
                paths[u, : len(path)] = path
                paths[u, len(path) :] = path[-1]
            if not gained:
                break

    def value(self, paths: Cells, settled: NDArray[np.int64]) -> float:
        """What all paths gain together, by the chain rule: each UAV's gain given those before
        it."""
        total, known = 0.0, np.zeros_like(settled)
        for u in self.reach:
            here = self.reach[u].given(_planned_cells(paths, known, u, self.stride, self.span))
            total += path_value(paths[u, : settled[u] + 1], here)
            known[u] = settled[u]
        return total


def _planned_cells(
    paths: Cells, settled: NDArray[np.int64], uav: int, stride: int, span: float
) -> Cells:
    """Distinct cells ``[k, (row, col)]`` that the other UAVs have planned to measure within
    ``span`` cells of ``uav``."""
    parts = [paths[v, stride : settled[v] + 1 : stride] for v in range(len(paths)) if v != uav]
    cells = np.unique(np.concatenate(parts), axis=0) if parts else np.empty((0, 2), dtype=np.int64)
    return cells[np.abs(cells - paths[uav, 0]).max(axis=1, initial=0) <= span]


def independent_greedy_planner(**options: object) -> SequentialGreedyPlanner:
    """The same search without coordination: every UAV plans as if it were alone, only keeping clear
    of the others."""
    return SequentialGreedyPlanner(coordinated=False, **options)  # type: ignore[arg-type]


def tree_search_planner(**options: object) -> SequentialGreedyPlanner:
    """The same objective and coordination with Monte-Carlo tree search for each path."""
    return SequentialGreedyPlanner(**({"tree_rounds": 1000} | options))  # type: ignore[arg-type]
