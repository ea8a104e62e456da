"""Surveys as reinforcement-learning environments."""

from __future__ import annotations

__all__ = ["ENVIRONMENT_ID", "make", "make_single"]

from typing import Any

from skygain.environments.rewards import ENVIRONMENT_ID
from skygain.ground.errors import require


def make(**options: Any) -> Any:
    """The PettingZoo environment, see `skygain.environments.active_mapping.ActiveMapping` for the
    options.

    Raises:
        InputError: PettingZoo is not installed; the message names the extra.
    """
    require("pettingzoo", "rl")
    from skygain.environments.active_mapping import ActiveMapping

    return ActiveMapping(**options)


def make_single(**options: Any) -> Any:
    """The Gymnasium view for one UAV, with the same options but for ``n_uavs``.

    Raises:
        InputError: Gymnasium is not installed; the message names the extra.
    """
    require("gymnasium", "rl")
    from skygain.environments.single_uav import SingleUavMapping

    return SingleUavMapping(**options)
