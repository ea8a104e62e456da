"""Look-ahead on the belief: paths of up to 40 steps, scored by how much they can be expected to
teach.

UAV after UAV, a beam search looks for the path with the largest expected fall of the belief's
variance over the unvisited outdoor cells,

    Σ_x [K(x, x) − K(x, x | S)],   S the cells of the path and of the paths the other UAVs have
    planned,

with K the joint covariance of the belief (`skygain.fields.planning`). For the propagation operator
K holds both what is still open in the field itself and what the candidate transmitters disagree
about, so a path is paid for telling candidates apart as far as that changes the map; the linear
estimate behind K is never better than the belief's own conditioning, so the fall is one that can be
expected to be reached or exceeded. For Kriging K is the kernel given the readings, for beliefs of
variances only a stand-in.

No training. The delay is bounded: the beam's width is shared by the UAVs, so a decision costs about
the same for any number of them.

How soon to plan again depends on what flying can teach about the plan. With a stationary kernel K
depends on where was measured, not on what, so a plan stays as good as it was and is flown for 15
steps; other beliefs may change their mind with every reading, above all while they have seen
little, and plans are flown for 5 steps at first and 10 later.
"""

from __future__ import annotations

__all__ = ["LookaheadPlanner"]

from dataclasses import dataclass, replace

import numpy as np

from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.planners.base import Plan, Planner
from skygain.planners.sequential_greedy import SequentialGreedyPlanner
from skygain.posterior import HasStationaryPrior
from skygain.predictors.base import Belief

LEAST_WIDTH = 30


@dataclass(frozen=True)
class LookaheadPlanner(Planner):
    """See the module.

    Raises:
        InputError: no step to look ahead or to fly.
    """

    horizon: int = 40
    """most steps looked ahead"""
    commit_steps: int = 10
    """steps flown before planning again"""
    early_commit_steps: int = 5
    """the same during the first ``early_steps``"""
    stationary_commit_steps: int = 15
    """the same for a belief with a stationary kernel"""
    early_steps: int = 40
    """how long a survey counts as young"""
    paths: int = 450
    """paths kept per depth of the search, shared by the UAVs"""
    sweeps: int = 1
    """rounds in which every UAV plans again given the others"""

    def __post_init__(self) -> None:
        if (
            min(
                self.horizon,
                self.commit_steps,
                self.early_commit_steps,
                self.stationary_commit_steps,
                self.paths,
            )
            < 1
        ):
            raise InputError(
                "look-ahead needs a horizon, steps to fly and paths of 1 or more, got "
                f"{self.horizon}, {self.commit_steps}, {self.early_commit_steps}, "
                f"{self.stationary_commit_steps} and {self.paths}"
            )

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        flying = max(1, int(swarm.flying.sum()))
        search = SequentialGreedyPlanner(
            horizon=self.horizon, sweeps=self.sweeps, width=max(LEAST_WIDTH, self.paths // flying)
        )
        plan = search.plan(swarm, belief, horizon, rng)
        if isinstance(belief, HasStationaryPrior):
            flown = self.stationary_commit_steps
        else:
            flown = (
                self.early_commit_steps
                if swarm.steps_flown < self.early_steps
                else self.commit_steps
            )
        return replace(plan, commit_steps=min(flown, plan.n_steps))
