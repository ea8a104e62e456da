"""The Gymnasium view of `skygain/ActiveMapping-v0` for one UAV."""

from __future__ import annotations

__all__ = ["SingleUavMapping"]

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from skygain.environments.active_mapping import ActiveMapping, Observation


class SingleUavMapping(gymnasium.Env[dict[str, NDArray[Any]], np.int64]):
    """`ActiveMapping` with N = 1 and the agent's name left out."""

    def __init__(self, **options: Any) -> None:
        """The options of `ActiveMapping` but for ``n_uavs``."""
        self.swarm = ActiveMapping(**options, n_uavs=1)
        (self._agent,) = self.swarm.possible_agents
        self.observation_space = self.swarm.observation_space(self._agent)  # type: ignore[assignment]
        self.action_space = self.swarm.action_space(self._agent)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """See `ActiveMapping.reset`."""
        super().reset(seed=seed)
        observed, infos = self.swarm.reset(seed, options)
        return observed[self._agent], infos[self._agent]

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """See `ActiveMapping.step`."""
        observed, rewarded, terminated, truncated, infos = self.swarm.step(
            {self._agent: int(action)}
        )
        agent = self._agent
        return observed[agent], rewarded[agent], terminated[agent], truncated[agent], infos[agent]
