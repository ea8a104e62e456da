"""Entropy value iteration: the paper's planner for Kriging, problem P3, solved exactly for one to
three UAVs.

The paths maximise Σ_t H(y_{t+1} | y_t), the entropy of each step's readings given only those of the
step before, over all joint paths of ``horizon`` steps. The paper writes the recursion V(P) = max_u
r(P, u) + V(T(P, u)) with r = H(y_{t+1} | y_t) for legal joint moves and −∞ otherwise;
`skygain.planners.search.joint_paths` evaluates it on the joint positions that can be reached in
time. A cell that two UAVs hold, or that was held one step before, counts once. Equal paths are
drawn from by seed.

P3 forgets what was measured earlier, so it may fly back and forth over measured ground. With
``conditioned`` every entropy is also conditioned on all readings so far, H(y_{t+1} | y_t, D): the
covariance then depends on the place and the reward is computed per joint position, which is slower
and bounds the horizon for three UAVs.

Hovering is not in P3. Where the rules leave no joint path of the full horizon without a hover, the
horizon is halved until there is one, and a swarm that cannot even move one step jointly makes one
random legal step.
"""

from __future__ import annotations

__all__ = ["EntropyPlanner", "conditioned_entropy_planner"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.fields.offsets import offset_distance_m
from skygain.fields.planning import FALLBACK_RANGE_M, PlanningField, planning_field
from skygain.flight.airspace import Airspace
from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.planners.random_waypoint import RandomWaypointPlanner
from skygain.planners.search.joint_paths import (
    LOG_2_PI_E,
    TURNED_MOVES,
    Known,
    Scale,
    allowed_squares,
    rewards_by_offset,
    rewards_by_place,
    room_for,
    state_count,
    values_by_offset,
    values_by_place,
)
from skygain.predictors.base import Belief

TIE_NATS = 1e-5
"""joint moves whose values differ by less are equal; single precision resolves no more"""
MOST_READINGS = 600
"""readings conditioned on, the nearest"""
KNOWN_SHARE = 1e-5
"""share of the prior variance below which a cell is known"""


@dataclass(frozen=True)
class EntropyPlanner(Planner):
    """P3 by value iteration over joint positions. Time and memory grow as 4^N · horizon^(2N + 1)
    and horizon^(2N + 1)."""

    horizon: int = 20
    """steps planned"""
    commit_steps: int = 20
    """steps flown before planning again"""
    conditioned: bool = False
    """condition on all readings so far, not only on those of the step before"""
    max_states: int = 700_000_000
    """joint positions whose values may be kept (4 bytes each); the horizon is cut to fit"""
    max_rewards: int = 12_000_000
    """joint positions whose rewards may be computed one by one when ``conditioned``; the horizon is
    cut to fit"""

    def __post_init__(self) -> None:
        if self.horizon < 1 or self.commit_steps < 1:
            raise InputError(
                "entropy value iteration needs horizon >= 1 and commit_steps >= 1, got "
                f"{self.horizon} and {self.commit_steps}"
            )

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        flying = np.flatnonzero(swarm.flying)
        if len(flying) > 3:
            raise InputError(
                f"entropy value iteration plans at most 3 UAVs jointly, got {len(flying)}; use "
                "sequential-greedy for more"
            )
        steps = min(self.horizon, horizon, int(swarm.steps_left[flying].min(initial=horizon)))
        most = min(self.max_states, self.max_rewards) if self.conditioned else self.max_states
        while steps > 1 and state_count(len(flying), steps) > most:
            steps -= 1
        field = planning_field(belief)
        while steps >= 1 and len(flying):
            for margin in (
                (2 * len(flying), 0) if swarm.home_steps is not None and len(flying) > 1 else (0,)
            ):
                joint = self._paths(swarm, field, flying, steps, margin, rng)
                if joint is not None:
                    paths = np.repeat(swarm.cells[:, None], steps + 1, axis=1)
                    paths[flying] = joint
                    return Plan(paths, commit_steps=min(self.commit_steps, steps))
            steps //= 2
        return Plan(RandomWaypointPlanner().paths(swarm, 1, rng), commit_steps=1)

    def _paths(
        self,
        swarm: Swarm,
        field: PlanningField,
        flying: NDArray[np.int64],
        steps: int,
        margin: int,
        rng: np.random.Generator,
    ) -> Cells | None:
        """``[flying uav, steps + 1, (row, col)]`` an optimal joint path, or ``None`` if none is
        legal without hovering."""
        air = Airspace.of(swarm)
        start = np.ascontiguousarray(swarm.cells[flying])
        allowed = np.stack(
            [
                allowed_squares(
                    air.flyable,
                    swarm.cells[u],
                    steps,
                    None if swarm.home_steps is None else swarm.home_steps[u],
                    int(swarm.steps_left[u]) - margin,
                )
                for u in flying
            ]
        )
        kernel = _stationary_kernel(field, start, steps)
        floor = KNOWN_SHARE * float(kernel[0, 0])
        # entropy of unrelated readings, one move after their cell was read: the natural zero of the
        # rewards
        unrelated = kernel[0, 0] - kernel[1, 0] ** 2 / kernel[0, 0]
        shift = len(start) * 0.5 * (LOG_2_PI_E + np.log(max(unrelated, floor)))
        scale, room = Scale(floor, float(shift)), room_for(len(start))
        if self.conditioned:
            known = _posterior_of_reach(field, start, allowed)
            values, begin = values_by_place(start, steps, allowed, known, air, scale)
        else:
            values, begin = values_by_offset(start, steps, allowed, kernel, air, scale)

        def rewards(now: Cells) -> NDArray[np.float64]:
            if self.conditioned:
                rewards_by_place(now, known, air, scale, room)
            else:
                rewards_by_offset(now, kernel, air, scale, room)
            return room.rewards.copy()

        return _read_off(start, steps, allowed, values, begin, rewards, rng)


def conditioned_entropy_planner(**options: object) -> EntropyPlanner:
    """`EntropyPlanner` that conditions on all readings so far."""
    return EntropyPlanner(conditioned=True, **options)  # type: ignore[arg-type]


def _stationary_kernel(field: PlanningField, start: Cells, steps: int) -> NDArray[np.float64]:
    """``[|row offset|, |col offset|]`` prior covariance for every offset that can occur within
    ``steps``."""
    reach = 2 * steps + 3 + int(np.abs(start[:, None] - start[None]).max(initial=0))
    distance_m = offset_distance_m((reach, reach), field.grid.spacing_m)
    if field.kernel:
        return np.asarray(field.kernel(distance_m), dtype=float)
    return field.level_db2 * np.exp(-distance_m / FALLBACK_RANGE_M)


def _posterior_of_reach(field: PlanningField, start: Cells, allowed: NDArray[np.bool_]) -> Known:
    """The posterior covariance of the reachable cells."""
    mask = np.zeros(field.grid.shape, dtype=bool)
    mask[start[:, 0], start[:, 1]] = True
    for u, (row, col) in enumerate(start):
        t, a, b = np.nonzero(allowed[u])
        mask[row + a + b - t, col + a - b] = True
    cells = np.argwhere(mask)
    number = np.full(field.grid.shape, -1, dtype=np.int64)
    number[mask] = np.arange(len(cells))
    source = field.near(start, MOST_READINGS).conditioned()
    white = source.whitened(cells)
    return Known(number, source.covariance(cells, cells, white, white))


def _read_off(start, steps, allowed, values, begin, rewards, rng):  # type: ignore[no-untyped-def]
    """Follow the best joint moves forwards, drawing among equals."""
    n = len(start)
    moves = np.stack(np.unravel_index(np.arange(4**n), (4,) * n), axis=1)  # [joint move, uav]
    place = np.zeros((n, 2), dtype=np.int64)  # turned coordinates (a, b)
    paths = np.empty((n, steps + 1, 2), dtype=np.int64)
    paths[:, 0] = start
    for t in range(steps):
        to = place[None] + np.stack([moves // 2, moves % 2], axis=2)  # [joint move, uav, (a, b)]
        gain = rewards(paths[:, t].copy())
        side = t + 2
        for u in range(n):
            gain[~allowed[u, t + 1, to[:, u, 0], to[:, u, 1]]] = -np.inf
        if t + 1 < steps:
            flat = np.zeros(len(moves), dtype=np.int64)
            for u in range(n):
                flat = flat * side * side + to[:, u, 0] * side + to[:, u, 1]
            open_ = np.isfinite(gain)
            gain[open_] += values[begin[t + 1] + flat[open_]]
        best = gain.max()
        if not np.isfinite(best):
            return None
        chosen = rng.choice(np.flatnonzero(gain >= best - TIE_NATS))
        place = to[chosen]
        paths[:, t + 1] = paths[:, t] + TURNED_MOVES[moves[chosen]]
    return paths
