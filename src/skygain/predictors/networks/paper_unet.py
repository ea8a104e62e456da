"""The paper's predictor: two U-Nets that turn (city, measurements) into a mean and a variance per
cell (paper, section V)."""

from __future__ import annotations

__all__ = ["PaperUNetPredictor", "map_blind_unet"]

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.networks.runtime import Network, load
from skygain.networks.scales import PAPER_SIDE
from skygain.networks.unets.inputs import paper_inputs
from skygain.predictors.base import Predictor
from skygain.predictors.networks.network_belief import NetworkBelief
from skygain.predictors.networks.trained_for import TrainedFor
from skygain.scenario import Scenario

NETWORKS_BYTES = 4.5e8
"""what both networks take with their weights"""


@dataclass(frozen=True)
class PaperUNetPredictor(Predictor):
    """Trained for maps of 96 × 96 cells of 4 m, one altitude and one number of UAVs; smaller maps
    are embedded in open ground."""

    weights: str | Path = "paper-unet"
    """name or file of the weights"""
    blind: bool = False
    """the map-blind twin"""
    runtime: str = "onnx"
    """what runs the network, see `skygain.networks.runtime`"""

    needs_gain: ClassVar[bool] = True

    def memory_bytes(self, cells: int, readings: int) -> float:
        """The two networks, whatever the map."""
        return super().memory_bytes(cells, readings) + NETWORKS_BYTES

    def begin(self, scenario: Scenario) -> NetworkBelief:
        """The belief before the first measurement.

        Raises:
            InputError: the map is larger than the network's, or flight and prediction differ in
                altitude.
        """
        if max(scenario.grid.shape) > PAPER_SIDE:
            raise InputError(
                f"the paper's U-Net answers for maps of up to {PAPER_SIDE} × {PAPER_SIDE} cells, "
                f"got {scenario.grid.shape}; crop the city or use the predictor 'operator'"
            )
        _ = self._network
        return NetworkBelief.begun(scenario, self._evaluate)

    def outside_training(
        self, scenario: Scenario, *, uavs: int | None = None, quantity: str = "gain"
    ) -> str:
        task = self._network.weights.task
        altitude_m = float(task.get("altitude_m", 10.0))
        trained = TrainedFor((altitude_m, altitude_m), task.get("uavs"))
        return trained.unlike(self.weights, scenario, uavs, quantity)

    @cached_property
    def _network(self) -> Network:
        return load("paper-unet", self.weights, self.runtime)

    def _evaluate(
        self, scenarios: Sequence[Scenario], gain: NDArray[np.float32], measured: NDArray[np.bool_]
    ) -> tuple[NDArray, NDArray]:
        rows, cols = gain.shape[1:]
        room = ((0, 0), (0, PAPER_SIDE - rows), (0, PAPER_SIDE - cols))
        heights = np.stack([s.city.height_m for s in scenarios])
        inputs = paper_inputs(
            np.pad(heights, room), np.pad(gain, room), np.pad(measured, room), blind=self.blind
        )
        mean, log_variance = self._network(inputs)
        return mean[:, :rows, :cols], np.exp(log_variance[:, :rows, :cols])


def map_blind_unet(
    weights: str | Path = "paper-unet-mapblind", runtime: str = "onnx"
) -> PaperUNetPredictor:
    """The same network without the height map (paper, section VIII-E)."""
    return PaperUNetPredictor(weights=weights, blind=True, runtime=runtime)
