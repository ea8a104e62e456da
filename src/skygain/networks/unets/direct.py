"""Our direct network: (city, measurements) → mean and variance, any number of UAVs and any altitude
in one model.

The body is that of the propagation operator. Besides the measured gains and their mask it sees the
same smoothed with three widths (`skygain.networks.unets.inputs`), which carries sparse readings
over the whole map before the first layer. The mean is learned as a correction to that
interpolation.
"""

from __future__ import annotations

__all__ = ["DirectNet"]

import math

from torch import Tensor

from skygain.networks.operator.network import OperatorConfig, ResidualUNet
from skygain.networks.scales import (
    GAIN_CENTRE_DB,
    GAIN_SCALE_DB,
    LARGEST_STD_DB,
    SMALLEST_STD_DB,
)
from skygain.networks.unets.inputs import DIRECT_CHANNELS

OUR_SIZES = OperatorConfig()


class DirectNet(ResidualUNet):
    """Inputs → (mean in dB, log variance), each ``[batch, row, col]`` in float32."""

    def __init__(self, config: OperatorConfig = OUR_SIZES) -> None:
        super().__init__(DIRECT_CHANNELS, config)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        out = self.body(inputs)
        mean = GAIN_CENTRE_DB + GAIN_SCALE_DB * inputs[:, -1].float() + 20.0 * out[:, 0]
        log_variance = math.log(100.0) + 2.0 * out[:, 1]
        return mean, log_variance.clamp(2 * math.log(SMALLEST_STD_DB), 2 * math.log(LARGEST_STD_DB))
