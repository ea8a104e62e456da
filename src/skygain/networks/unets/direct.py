"""Our direct network: (city, measurements) → mean and variance, any number of UAVs and any altitude
in one model.

The body is that of the propagation operator. What it sees of the survey is, besides the measured
gains and their mask, the same
smoothed with three widths: a normalised convolution carries sparse readings over the whole map
before the first layer, which a small network would otherwise spend its depth on. The mean is
learned as a correction to that interpolation.
"""

from __future__ import annotations

__all__ = ["DirectNet", "direct_inputs"]

import math

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from skygain.networks.operator.network import OperatorConfig, ResidualUNet

CENTRE_DB = -120.0
SCALE_DB = 30.0
WIDTHS = (2.0, 6.0, 18.0)
"""standard deviations in cells of the smoothing kernels"""
CHANNELS = 5 + 2 * len(WIDTHS)
OUR_SIZES = OperatorConfig()


def direct_inputs(
    height_m: Tensor, gain_db: Tensor, measured: Tensor, altitude_m: Tensor
) -> Tensor:
    """``[batch, channel, row, col]``; the last channel is the interpolation the network corrects.

    ``gain_db`` counts at ``measured`` cells only; both and ``height_m`` are ``[batch, row, col]``,
    ``altitude_m`` is ``[batch]``.
    """
    with torch.autocast(height_m.device.type, enabled=False):
        mask = measured.float()
        gain = (gain_db.float() - CENTRE_DB) / SCALE_DB * mask
        altitude = altitude_m.float()[:, None, None].expand_as(height_m)
        channels = [
            height_m / 20.0,
            (height_m >= altitude).float(),
            altitude / 20.0 - 1.0,
            mask,
            gain,
        ]
        overall = gain.sum((1, 2)) / mask.sum((1, 2)).clamp(min=1.0)
        estimate = overall[:, None, None].expand_as(gain)
        for width in reversed(
            WIDTHS
        ):  # from the widest: each finer one falls back on the coarser where it has no data
            weight, value = _smoothed(mask, width), _smoothed(gain, width)
            estimate = (value + 0.02 * estimate) / (weight + 0.02)
            channels += [torch.log(weight + 1e-3) / 5.0, estimate]
        return torch.stack(channels, dim=1).contiguous(memory_format=torch.channels_last)


class DirectNet(ResidualUNet):
    """Inputs → (mean in dB, log variance), each ``[batch, row, col]`` in float32."""

    def __init__(self, config: OperatorConfig = OUR_SIZES) -> None:
        super().__init__(CHANNELS, config)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        out = self.body(inputs)
        mean = CENTRE_DB + SCALE_DB * inputs[:, -1].float() + 20.0 * out[:, 0]
        return mean, (math.log(100.0) + 2.0 * out[:, 1]).clamp(math.log(0.5**2), math.log(40.0**2))


def _smoothed(x: Tensor, width: float) -> Tensor:
    reach = int(2.5 * width)
    line = torch.exp(-0.5 * (torch.arange(-reach, reach + 1, device=x.device) / width) ** 2)
    y = F.conv2d(x[:, None], line.view(1, 1, 1, -1), padding=(0, reach))
    return F.conv2d(y, line.view(1, 1, -1, 1), padding=(reach, 0))[:, 0]
