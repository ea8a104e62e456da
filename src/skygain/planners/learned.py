"""Planners that are trained networks: `dqn` by Q-learning, `imitation` by watching an expert.

At every step each UAV looks at the belief, the city and the swarm, and takes the move its network
values most among the legal ones; UAVs whose wishes collide choose one after another
(`skygain.flight.airspace`). A network with a view centred on the UAV is asked about all eight turns
and mirror images of what it sees and the answers are averaged, so that the plan turns with the
city.
"""

from __future__ import annotations

__all__ = ["PolicyPlanner", "dqn_planner", "imitation_planner"]

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.flight.airspace import Airspace, blocked_home, home_margins, resolve_step
from skygain.flight.swarm import Swarm
from skygain.networks.policies.planes import packed_height, packed_mean, packed_std
from skygain.planners.base import Plan, Planner
from skygain.predictors.base import Belief


@dataclass(frozen=True)
class PolicyPlanner(Planner):
    """One step per decision."""

    weights: str | Path
    """name or file of the weights"""
    symmetries: int = 8
    """turns and mirror images averaged over, 1 to 8; the paper's network, whose view is not
    centred, is asked once"""

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        score = self.values(swarm, belief) + 1e-9 * rng.random((swarm.n_uavs, 4))
        air, start, then = (
            Airspace.of(swarm),
            np.ascontiguousarray(swarm.cells),
            np.empty((swarm.n_uavs, 2), dtype=np.int64),
        )
        for margin in home_margins(swarm):
            if resolve_step(start, score, swarm.steps_left, margin, air, then):
                return Plan(np.stack([swarm.cells, then], axis=1), commit_steps=1)
        raise blocked_home()

    def values(self, swarm: Swarm, belief: Belief) -> NDArray[np.float64]:
        """``[uav, move]`` how much each UAV's network favours each move, legal or not."""
        import torch

        from skygain.networks.policies.inputs import SYMMETRIES, Seen, last_moves, turned_moves

        network, z = self._network
        posterior, n = belief.posterior(), swarm.n_uavs
        maps = (
            packed_mean(posterior.mean_db),
            packed_std(posterior.variance_db2),
            packed_height(belief.scenario.city.height_m),
        )
        mean, std, height = (np.broadcast_to(m, (n, *m.shape)) for m in maps)
        seen = Seen(
            mean=mean,
            std=std,
            height=height,
            flyable=np.broadcast_to(swarm.flyable, mean.shape),
            cells=np.broadcast_to(swarm.cells, (n, n, 2)),
            uav=np.arange(n),
            last=last_moves(swarm),
            left=swarm.steps_left,
        )
        count = min(self.symmetries, SYMMETRIES) if network.centred else 1
        total = np.zeros((n, 4))
        with torch.inference_mode():
            for symmetry, inputs in enumerate(network.all_inputs(seen, count)):
                logits = network(*inputs)
                value = (
                    torch.log_softmax(logits[..., 0], dim=-1)
                    if z is None
                    else torch.softmax(logits, dim=-1) @ z
                )
                total += value.numpy()[:, turned_moves(symmetry)]
        return total / count

    @cached_property
    def _network(self) -> tuple[Any, Any]:
        """The network and the support of its returns, ``None`` for an imitator."""
        from skygain.networks.policies.weights import load_policy

        return load_policy(self.weights)


def dqn_planner(weights: str | Path = "dqn", **options: Any) -> PolicyPlanner:
    """The multi-agent DQN; train it with ``skygain train policy --recipe dqn`` (or
    ``paper-dqn``)."""
    return PolicyPlanner(weights, **options)


def imitation_planner(weights: str | Path = "imitation", **options: Any) -> PolicyPlanner:
    """The imitator of a planner that looks ahead; train it with ``skygain train policy --recipe
    imitation``."""
    return PolicyPlanner(weights, **options)
