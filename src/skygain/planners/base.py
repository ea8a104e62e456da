"""The seam every planner implements: look at the swarm and the belief, return legal paths."""

from __future__ import annotations

__all__ = ["Certificate", "Plan", "Planner"]

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.flight.swarm import Swarm
from skygain.predictors.base import Belief


@dataclass(frozen=True)
class Certificate:
    """A proof of how far a plan can be from the best plan of the same horizon, for a stated
    objective."""

    objective: str
    """what is maximised, with its constants, for example ``"½ log det(I + K/σ²), σ² = 1 dB²"``"""
    value_nats: float
    """the objective of this plan"""
    upper_bound_nats: float
    """no legal plan exceeds this"""
    random_nats: float | None = None
    """the mean objective of random-waypoint plans from the same state, where it was computed"""

    @property
    def gap_nats(self) -> float:
        """At most this much is missing."""
        return self.upper_bound_nats - self.value_nats

    @property
    def ratio(self) -> float:
        """At least this share of the best value is reached."""
        return self.value_nats / self.upper_bound_nats if self.upper_bound_nats > 0 else 1.0

    @property
    def share(self) -> float | None:
        """At least this share of the way from random plans to the best one is gone; ``None``
        without random plans."""
        if self.random_nats is None:
            return None
        way = self.upper_bound_nats - self.random_nats
        return (self.value_nats - self.random_nats) / way if way > 0 else 1.0


@dataclass(frozen=True, eq=False)
class Plan:
    """Paths for the next steps of every UAV."""

    paths: NDArray[np.int64]
    """``[uav, step, (row, col)]``; step 0 is where the UAV stands now"""
    commit_steps: int
    """how many of the steps to fly before planning again, at least 1"""
    certificate: Certificate | None = None
    """how far from optimal the plan can be, where the objective allows a proof"""

    @property
    def n_steps(self) -> int:
        """Steps planned."""
        return self.paths.shape[1] - 1


class Planner(ABC):
    """A method that chooses where the swarm measures next. Holds settings and weights, never a
    survey's state."""

    @abstractmethod
    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        """Legal paths of 1 to ``horizon`` steps from where the swarm is; ``horizon`` (>= 1) is what
        is left of the survey.

        What a planner needs to remember (last moves, steps flown, cells visited) stands in the
        swarm and the belief, so that
        planning is a function of its arguments: the same swarm, belief, horizon and seed give the
        same plan.
        """

    def outside_training(self, predictor: str, *, uavs: int, quantity: str = "gain") -> str:
        """One line that says in what a survey is unlike all that the planner was trained for;
        empty where it is not, and for a planner that nobody trained.

        Args:
            predictor: name of the method whose beliefs it sees, without options.
            uavs: how many fly.
            quantity: what the readings are of, see `GriddedRecording.quantity`.
        """
        return ""
