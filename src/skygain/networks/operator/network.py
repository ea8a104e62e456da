"""The propagation operator: (city, transmitter position) → mean and variance of the gain at every
cell.

No measurement enters. The network is a small residual U-Net on the inputs of `path_features`: a
full-resolution stem that keeps shadow edges sharp, most of the work at half and quarter resolution,
and attention over the coarsest map for what happens across the city (reflections, canyons). It is
convolutional throughout, so a map of any size will do.
"""

from __future__ import annotations

__all__ = ["OperatorConfig", "PropagationOperator", "ResidualUNet"]

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from skygain.networks.operator.features import CHANNELS
from skygain.networks.scales import FREE_SPACE_5GHZ_DB, LARGEST_STD_DB, SMALLEST_STD_DB


@dataclass(frozen=True)
class OperatorConfig:
    """Sizes of the network."""

    stem: int = 16
    """channels at full resolution"""
    widths: tuple[int, int, int] = (48, 96, 160)
    """channels at 1/2, 1/4 and 1/8 resolution"""
    blocks: tuple[int, int, int] = (1, 1, 3)
    """residual blocks at these resolutions on the way down (the way up has 1 at 1/4 and 2 at
    1/2)"""
    heads: int = 4
    """attention heads at the coarsest resolution"""


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.BatchNorm2d(width), nn.BatchNorm2d(width)
        self.conv1 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        y = self.conv1(F.relu(self.norm1(x)))
        return x + self.conv2(F.relu(self.norm2(y)))


class _Attention(nn.Module):
    """Self-attention between all cells of a coarse map; where a cell lies comes from the inputs,
    which hold distance and direction."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.BatchNorm2d(width)
        self.qkv = nn.Conv2d(width, 3 * width, 1)
        self.out = nn.Conv2d(width, width, 1)

    def forward(self, x: Tensor) -> Tensor:
        b, c, rows, cols = x.shape
        q, k, v = (
            self.qkv(self.norm(x))
            .reshape(b, 3, self.heads, c // self.heads, rows * cols)
            .transpose(-1, -2)
            .unbind(1)
        )
        y = F.scaled_dot_product_attention(q, k, v)
        return x + self.out(y.transpose(-1, -2).reshape(b, c, rows, cols))


class ResidualUNet(nn.Module):
    """The body shared with the direct network: ``[batch, channel, row, col]`` → ``[batch, 2, row,
    col]`` in float32."""

    def __init__(self, channels: int, config: OperatorConfig) -> None:
        super().__init__()
        self.config = config
        s, (w1, w2, w3), (b1, b2, b3) = config.stem, config.widths, config.blocks
        self.stem = nn.Conv2d(channels, s, 3, padding=1)
        self.down1 = nn.Conv2d(s, w1, 2, stride=2)
        self.enc1 = nn.Sequential(*(_Residual(w1) for _ in range(b1)))
        self.down2 = nn.Conv2d(w1, w2, 2, stride=2)
        self.enc2 = nn.Sequential(*(_Residual(w2) for _ in range(b2)))
        self.down3 = nn.Conv2d(w2, w3, 2, stride=2)
        self.enc3 = nn.Sequential(
            *(_Residual(w3) for _ in range(b3 - 1)), _Attention(w3, config.heads), _Residual(w3)
        )
        self.up2 = nn.ConvTranspose2d(w3, w2, 2, stride=2)
        self.dec2 = _Residual(w2)
        self.up1 = nn.ConvTranspose2d(w2, w1, 2, stride=2)
        self.dec1 = nn.Sequential(*(_Residual(w1) for _ in range(2)))
        self.up0 = nn.ConvTranspose2d(w1, s, 2, stride=2)
        self.merge = nn.Conv2d(2 * s, s, 3, padding=1)
        self.head = nn.Conv2d(s, 2, 3, padding=1)

    def body(self, inputs: Tensor) -> Tensor:
        """The two output maps; edges are repeated up to a multiple of 8 cells and cut off again."""
        rows, cols = inputs.shape[-2:]
        padded = (
            F.pad(inputs, (0, -cols % 8, 0, -rows % 8), mode="replicate")
            if rows % 8 or cols % 8
            else inputs
        )
        x0 = F.relu(self.stem(padded))
        x1 = self.enc1(self.down1(x0))
        x2 = self.enc2(self.down2(x1))
        x3 = self.enc3(self.down3(x2))
        y2 = self.dec2(self.up2(x3) + x2)
        y1 = self.dec1(self.up1(y2) + x1)
        y0 = F.relu(self.merge(torch.cat([F.relu(self.up0(y1)), x0], dim=1)))
        return self.head(y0)[..., :rows, :cols].float()


class PropagationOperator(ResidualUNet):
    """``[batch, channel, row, col]`` inputs → (mean in dB, log variance), each ``[batch, row,
    col]`` in float32."""

    def __init__(self, config: OperatorConfig = OperatorConfig()) -> None:
        super().__init__(len(CHANNELS), config)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        out = self.body(inputs)
        free_space = FREE_SPACE_5GHZ_DB - 20.0 * (
            inputs[:, CHANNELS.index("log_distance")].float() + 2.0
        )
        mean = free_space + 20.0 * out[:, 0]
        log_variance = (math.log(100.0) + 2.0 * out[:, 1]).clamp(
            2 * math.log(SMALLEST_STD_DB), 2 * math.log(LARGEST_STD_DB)
        )
        return mean, log_variance
