"""What a network was trained for, and in what a survey differs from it."""

from __future__ import annotations

__all__ = ["TrainedFor"]

import math
from dataclasses import dataclass
from pathlib import Path

from skygain.networks.scales import TRAINED_SPACING_M
from skygain.scenario import Scenario


@dataclass(frozen=True)
class TrainedFor:
    """The surveys of a network's training."""

    altitudes_m: tuple[float, float]
    """lowest and highest altitude of flight and map"""
    uavs: int | None = None
    """how many UAVs there were; ``None`` for any number"""
    spacing_m: float = TRAINED_SPACING_M
    """side of a cell"""

    def unlike(
        self, weights: str | Path, scenario: Scenario, uavs: int | None, quantity: str
    ) -> str:
        """One line that says what is different in a survey, empty where nothing is.

        Args:
            weights: name or file of the network.
            scenario: of the survey.
            uavs: how many fly; ``None`` where nobody does.
            quantity: ``"gain"`` in dB, or another that the readings are of.
        """
        low, high = self.altitudes_m
        trained, here = [], []
        if uavs is not None and self.uavs is not None and uavs != self.uavs:
            trained.append(f"{self.uavs} UAVs")
            here.append(f"{uavs} UAVs" if uavs != 1 else "1 UAV")
        if not low <= scenario.prediction_altitude_m <= high:
            trained.append(f"{low:g} m above ground" if low == high else f"{low:g} to {high:g} m")
            here.append(f"{scenario.prediction_altitude_m:g} m")
        if not math.isclose(scenario.grid.spacing_m, self.spacing_m, rel_tol=1e-3):
            trained.append(f"cells of {self.spacing_m:g} m")
            here.append(f"of {scenario.grid.spacing_m:g} m")
        if quantity != "gain":
            trained.append("gains in dB")
            here.append("levels in dBm")
        if not trained:
            return ""
        name = Path(weights).stem
        return (
            f"the network {name} was trained for {', '.join(trained)}, here are "
            f"{', '.join(here)}: its map may be far off, and surer than it should be"
        )
