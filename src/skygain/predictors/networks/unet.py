"""Our direct network as a predictor: any map, any number of UAVs, any path, 10 to 30 m, one
model."""

from __future__ import annotations

__all__ = ["UNetPredictor"]

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from skygain.networks.runtime import Network, load
from skygain.networks.unets.inputs import direct_inputs
from skygain.predictors.base import Predictor
from skygain.predictors.networks.network_belief import NetworkBelief
from skygain.predictors.networks.trained_for import TrainedFor
from skygain.scenario import Scenario

LAYERS_BYTES = 1200.0
"""per cell, of what the network's layers hold at a time"""


@dataclass(frozen=True)
class UNetPredictor(Predictor):
    """See `skygain.networks.unets.direct`."""

    weights: str | Path = "unet"
    """name or file of the weights"""
    runtime: str = "onnx"
    """what runs the network, see `skygain.networks.runtime`"""

    needs_gain: ClassVar[bool] = True

    def memory_bytes(self, cells: int, readings: int) -> float:
        """The network's layers."""
        return super().memory_bytes(cells, readings) + LAYERS_BYTES * cells

    def begin(self, scenario: Scenario) -> NetworkBelief:
        _ = self._network
        return NetworkBelief.begun(scenario, self._evaluate)

    def outside_training(
        self, scenario: Scenario, *, uavs: int | None = None, quantity: str = "gain"
    ) -> str:
        return TrainedFor((10.0, 30.0)).unlike(self.weights, scenario, uavs, quantity)

    @cached_property
    def _network(self) -> Network:
        return load("unet", self.weights, self.runtime)

    def _evaluate(
        self, scenarios: Sequence[Scenario], gain: NDArray[np.float32], measured: NDArray[np.bool_]
    ) -> tuple[NDArray, NDArray]:
        heights = np.stack([s.city.height_m for s in scenarios])
        altitudes = np.array([s.prediction_altitude_m for s in scenarios])
        mean, log_variance = self._network(direct_inputs(heights, gain, measured, altitudes))
        return mean, np.exp(log_variance)
