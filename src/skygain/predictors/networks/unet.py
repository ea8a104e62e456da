"""Our direct network as a predictor: any map, any number of UAVs, any path, 10 to 30 m, one
model."""

from __future__ import annotations

__all__ = ["UNetPredictor"]

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.predictors.base import Predictor
from skygain.predictors.networks.network_belief import NetworkBelief
from skygain.scenario import Scenario


@dataclass(frozen=True)
class UNetPredictor(Predictor):
    """See `skygain.networks.unets.direct`."""

    weights: str | Path = "unet"
    """name or file of the weights"""

    def begin(self, scenario: Scenario) -> NetworkBelief:
        _ = self._network
        return NetworkBelief.begun(scenario, self._evaluate)

    @cached_property
    def _network(self) -> Any:
        from skygain.networks.unets.direct import DirectNet
        from skygain.networks.weights import load_network

        network = DirectNet()
        load_network(network, self.weights)
        return network

    def _evaluate(
        self, scenarios: Sequence[Scenario], gain: NDArray[np.float32], measured: NDArray[np.bool_]
    ) -> tuple[NDArray, NDArray]:
        import torch

        from skygain.networks.unets.direct import direct_inputs

        height = torch.from_numpy(np.stack([s.city.height_m for s in scenarios]))
        altitude = torch.tensor([float(s.prediction_altitude_m) for s in scenarios])
        with torch.inference_mode():
            inputs = direct_inputs(
                height, torch.from_numpy(gain), torch.from_numpy(measured), altitude
            )
            mean, log_variance = self._network(inputs)
        return mean.numpy(), torch.exp(log_variance).numpy()
