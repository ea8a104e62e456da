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
from scipy.special import log_softmax, softmax

from skygain.flight.airspace import Airspace, blocked_home, home_margins, resolve_step
from skygain.flight.swarm import Swarm
from skygain.grid import SYMMETRIES
from skygain.networks.policies.inputs import (
    Seen,
    last_moves,
    policy_views,
    turned_moves,
)
from skygain.networks.policies.planes import packed_height, packed_mean, packed_std
from skygain.networks.policies.weights import definition_of, policy_file
from skygain.networks.runtime import Network, load
from skygain.networks.weights import read_card
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
    runtime: str = "onnx"
    """what runs the network, see `skygain.networks.runtime`"""

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

    def outside_training(self, predictor: str, *, uavs: int, quantity: str = "gain") -> str:
        recipe = self._network.weights.card.get("recipe", {})
        beliefs = recipe.get("predictors") or [recipe.get("predictor", predictor)]
        trained, here = [], []
        if predictor not in beliefs:
            trained.append(f"beliefs of {' and '.join(dict.fromkeys(beliefs))}")
            here.append(f"those of {predictor}")
        if uavs != recipe.get("n_uavs", uavs):
            trained.append(f"{recipe['n_uavs']} UAVs")
            here.append("1 UAV" if uavs == 1 else f"{uavs} UAVs")
        if quantity != "gain":
            trained.append("gains in dB")
            here.append("levels in dBm")
        if not trained:
            return ""
        return (
            f"the planner {Path(self.weights).stem} was trained for {', '.join(trained)}, here are "
            f"{', '.join(here)}: its ways may teach less"
        )

    def values(self, swarm: Swarm, belief: Belief) -> NDArray[np.float64]:
        """``[uav, move]`` how much each UAV's network favours each move, legal or not."""
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
        shape = self._network.weights.card["policy"]
        views = policy_views(shape, seen, min(self.symmetries, SYMMETRIES))
        (logits,) = self._network(*(np.concatenate(arrays) for arrays in zip(*views, strict=True)))
        value = _favour(logits, shape).reshape(len(views), n, 4)
        turned = [value[k][:, turned_moves(k)] for k in range(len(views))]
        return np.mean(turned, axis=0, dtype=float)

    @cached_property
    def _network(self) -> Network:
        path = policy_file(self.weights)
        return load(definition_of(read_card(path), path), path, self.runtime)


def _favour(logits: NDArray[np.float32], shape: dict[str, Any]) -> NDArray[np.float32]:
    """``[sample, move]`` the mean of the distribution of returns ``logits[sample, move, atom]``;
    with one atom the log probability that an imitator chooses the move."""
    if shape["atoms"] == 1:
        return log_softmax(logits[..., 0], axis=-1)
    returns = np.linspace(shape["v_min"], shape["v_max"], shape["atoms"], dtype=np.float32)
    return softmax(logits, axis=-1) @ returns


def dqn_planner(weights: str | Path = "dqn", **options: Any) -> PolicyPlanner:
    """The multi-agent DQN; train it with ``skygain train policy --recipe dqn`` (or
    ``paper-dqn``)."""
    return PolicyPlanner(weights, **options)


def imitation_planner(weights: str | Path = "imitation", **options: Any) -> PolicyPlanner:
    """The imitator of a planner that looks ahead; train it with ``skygain train policy --recipe
    imitation``."""
    return PolicyPlanner(weights, **options)
