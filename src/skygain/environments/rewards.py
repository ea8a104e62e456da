"""The paper's reward (section VI-C), and shaping that does not change what is optimal."""

from __future__ import annotations

__all__ = ["ENVIRONMENT_ID", "RewardConfig", "rewards"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError

ENVIRONMENT_ID = "skygain/ActiveMapping-v0"
"""name and version; a change of observation, action or reward raises the version"""


@dataclass(frozen=True)
class RewardConfig:
    """The constants; the paper gives none of them.

    Raises:
        InputError: a negative constant, or a discount outside 0..1.
    """

    explore: float = 0.02
    """r_e, for a cell that no UAV has visited"""
    error: float = 0.01
    """r_r per dB of ‖μ − x‖₂ over the unobstructed cells, taken off at step T"""
    shaping: bool = False
    """add γΦ(s′) − Φ(s) with Φ = −r_r ‖μ − x‖₂ before T and Φ = 0 at T"""
    discount: float = 0.99
    """γ"""

    def __post_init__(self) -> None:
        if min(self.explore, self.error) < 0 or not 0 < self.discount <= 1:
            raise InputError(
                f"rewards need explore, error >= 0 and a discount in (0, 1], got {self.explore}, "
                f"{self.error} and {self.discount}"
            )


def rewards(
    config: RewardConfig,
    new_cells: NDArray[np.bool_],
    ended: NDArray[np.bool_],
    error_before_db: NDArray[np.float64],
    error_after_db: NDArray[np.float64],
) -> NDArray[np.float32]:
    """``[survey, uav]`` rewards of one joint step.

    ``new_cells[survey, uav]`` says who found a new cell; ``ended[survey]`` where T was reached; the
    errors are ‖μ − x‖₂ per survey before and after the step. The exploration reward is for 1 ≤ t <
    T, the error's for t = T, as in the paper.
    """
    out = (
        config.explore * (new_cells & ~ended[:, None])
        - config.error * np.where(ended, error_after_db, 0.0)[:, None]
    )
    if config.shaping:
        ahead = np.where(ended, 0.0, -config.error * error_after_db)
        out = out + (config.discount * ahead + config.error * error_before_db)[:, None]
    return out.astype(np.float32)
