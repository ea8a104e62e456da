"""`skygain/ActiveMapping-v0`: the paper's multi-agent decision process (section VI-C) as a
PettingZoo environment.

- Agents: ``uav_0`` … ``uav_{N−1}``, all acting at the same time, alive until step T.
- Action: ``Discrete(4)``: north, east, south, west.
- Observation: ``{"observation": Box(5, side, side), "action_mask": Box(4)}``; the planes mean,
  standard deviation, heights, all positions and own position, scaled to 0..1
  (`skygain.networks.policies.planes`).
- Reward: r_e for a cell nobody has visited, at t < T; −r_r ‖μ − x‖₂ over unobstructed cells at
  t = T, the same for all; optionally shaped (`skygain.environments.rewards`).
- End: terminated at step T; never truncated.
- Rules: the swarm's. A move that meets an obstacle or another UAV is replaced by a legal one;
  UAVs choose in their order.
"""

from __future__ import annotations

__all__ = ["ActiveMapping"]

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from skygain.environments.rewards import ENVIRONMENT_ID, RewardConfig
from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.environments.worlds import LinkWorlds, Worlds
from skygain.flight.swarm import FlightRules
from skygain.networks.policies.planes import PLANES
from skygain.predictors.base import Predictor

Observation = dict[str, NDArray[Any]]


class ActiveMapping(ParallelEnv):
    """See the module."""

    metadata: ClassVar[dict[str, Any]] = {
        "name": ENVIRONMENT_ID,
        "render_modes": [],
        "is_parallelizable": True,
    }

    def __init__(
        self,
        worlds: Worlds | None = None,
        predictor: str | Predictor = "kriging",
        *,
        n_uavs: int = 3,
        steps: int = 200,
        reward: RewardConfig = RewardConfig(),  # noqa: B008 - frozen
        rules: FlightRules = FlightRules(),
        transmitter_known: bool = False,
    ) -> None:
        """Episodes in ``worlds`` (by default those that ship with the package), mapped by
        ``predictor`` (an object or a name).

        The transmitter's position is told to a predictor that cannot do without, and to others with
        ``transmitter_known``.
        """
        from skygain.predictors import create_predictor

        self.config = EnvironmentConfig(n_uavs, steps, reward, rules)
        self.worlds = worlds or LinkWorlds()
        self.predictor = create_predictor(predictor) if isinstance(predictor, str) else predictor
        self.transmitter_known = transmitter_known
        self.render_mode = None
        self.possible_agents = [f"uav_{k}" for k in range(n_uavs)]
        self.agents: list[str] = []
        side = self.worlds.side
        self.observation_spaces = {
            agent: spaces.Dict(
                {
                    "observation": spaces.Box(0.0, 1.0, (len(PLANES), side, side), np.float32),
                    "action_mask": spaces.Box(0, 1, (4,), np.int8),
                }
            )
            for agent in self.possible_agents
        }
        self.action_spaces = {agent: spaces.Discrete(4) for agent in self.possible_agents}
        self._surveys: SurveyBatch | None = None

    def observation_space(self, agent: str) -> spaces.Dict:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """The first observation of the first episode of ``seed``; without a seed, of the next
        episode of the same stream."""
        if self._surveys is None or seed is not None:
            self._surveys = SurveyBatch(
                self.worlds,
                self.predictor,
                self.config,
                seed=0 if seed is None else seed,
                transmitter_known=self.transmitter_known,
                restart=False,
            )
        else:
            self._surveys.begin_episodes([0], self._surveys.episode + 1)
        self.agents = self.possible_agents[:]
        return self._observed(), self._infos()

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """One joint step; see the module."""
        if not self.agents or self._surveys is None:
            return {}, {}, {}, {}, {}
        step = self._surveys.step(np.array([[actions[agent] for agent in self.possible_agents]]))
        ended = bool(step.ended[0])
        seen = self._observed()
        rewarded = {
            agent: float(r) for agent, r in zip(self.possible_agents, step.reward[0], strict=True)
        }
        infos = self._infos()
        if ended:
            self.agents = []
        return seen, rewarded, dict.fromkeys(seen, ended), dict.fromkeys(seen, False), infos

    def state(self) -> NDArray[np.float32]:
        """``[plane, row, col]`` what all UAVs see together: the observation without the own
        position."""
        assert self._surveys is not None
        return self._surveys.observations()[0, 0, :-1]

    def render(self) -> None:
        """There is no picture; see `skygain.reports.pictures` for those of a survey."""

    def close(self) -> None:
        """Nothing to release."""

    def _observed(self) -> dict[str, Observation]:
        assert self._surveys is not None
        seen, masks = self._surveys.observations()[0], self._surveys.masks()[0].astype(np.int8)
        return {
            agent: {"observation": seen[k], "action_mask": masks[k]}
            for k, agent in enumerate(self.possible_agents)
        }

    def _infos(self) -> dict[str, dict[str, Any]]:
        assert self._surveys is not None
        flown, rmse = int(self._surveys.steps_flown[0]), float(self._surveys.rmse_db[0])
        return {
            agent: {
                "step": flown,
                "rmse_db": rmse,
                "cell": tuple(self._surveys.cells[0, k].tolist()),
            }
            for k, agent in enumerate(self.possible_agents)
        }
