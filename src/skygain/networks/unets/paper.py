"""The paper's U-Nets to its Table I: one network for the mean, an equal one for the variance.

Layer by layer (paper, section V-A and Table I): convolutions of 4 × 4 with
16-16-32-32-64-64-128-128 channels, every second one followed by 2 × 2 max pooling; a dense layer of
4608; four "deconvolutions" (upsampling, then convolution) of 128-64-32-16 channels, each fed with
the layer before it and the encoder layer of its own size (8, 7, 5, 3); a last convolution that also
sees layer 1. The mean's hidden layers use ReLU, the variance's tanh, as the paper says; a tanh
output could not be a variance, so the last layer of the variance gives its logarithm instead.
"""

from __future__ import annotations

__all__ = ["PaperUNet", "PaperUNets", "UpsampledConv2d"]

import copy
import itertools
import math
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from skygain.networks.scales import (
    GAIN_CENTRE_DB,
    GAIN_SCALE_DB,
    PAPER_LARGEST_STD_DB,
    SMALLEST_STD_DB,
)

GAIN_CHANNEL = 1
"""of the inputs of a pair that sees the map"""
ENCODER = (16, 16, 32, 32, 64, 64, 128, 128)
DECODER = ((256, 128), (256, 64), (128, 32), (64, 16))


class UpsampledConv2d(nn.Conv2d):
    """A 4 × 4 convolution of the image upsampled twofold (nearest neighbour), without ever making
    the upsampled image.

    Four taps over pairs of equal values are three taps over the values, other ones for even than
    for odd outputs: a 3 × 3 convolution with four outputs per channel, 36 products in place of 64.
    Border as in the other layers.
    """

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(in_channels, out_channels, 4)
        self.kept: tuple[Tensor, Tensor] | None = None
        """the filters worked out once and for all, in a network that is not trained any more"""

    def filters(self) -> tuple[Tensor, Tensor]:
        """Weights and biases of the equivalent 3 × 3 convolution."""
        # out, in, row tap, col tap → out, row phase, col phase, in, row tap, col tap
        phases = torch.stack(
            [torch.stack(_phases(rows, 3), dim=1) for rows in _phases(self.weight, 2)], dim=1
        )
        bias: Tensor = self.bias  # type: ignore[assignment]
        return phases.flatten(0, 2), bias.repeat_interleave(4)

    def forward(self, x: Tensor) -> Tensor:
        weight, bias = self.kept or self.filters()
        return F.pixel_shuffle(F.conv2d(x, weight, bias, padding=1), 2)


class PaperUNet(nn.Module):
    """One U-Net of Table I: ``[batch, channel, 96, 96]`` → ``[batch, 96, 96]``."""

    def __init__(self, channels: int, activation: str) -> None:
        super().__init__()
        choices: dict[str, Callable[[Tensor], Tensor]] = {"relu": F.relu, "tanh": torch.tanh}
        self.activation = choices[activation]
        widths = (channels, *ENCODER)
        self.encoder = nn.ModuleList(nn.Conv2d(a, b, 4) for a, b in itertools.pairwise(widths))
        self.dense = nn.Linear(4608, 4608)
        self.decoder = nn.ModuleList(UpsampledConv2d(a, b) for a, b in DECODER)
        self.last = nn.Conv2d(32, 1, 4)
        self.frozen = False
        """whether the last layer computes in single precision whatever the others do"""

    def forward(self, x: Tensor) -> Tensor:
        layers = []
        for i, conv in enumerate(self.encoder):
            x = _same(conv, x)
            if (
                i % 2 == 1
                # both activations rise, so they change places with the maximum and see a quarter of
                # the cells
            ):
                x = F.max_pool2d(x, 2)
            x = self.activation(x)
            layers.append(x)
        y = (
            self.activation(self.dense(x.flatten(1)))
            .reshape(x.shape)
            .contiguous(memory_format=torch.channels_last)
        )
        for conv, skip in zip(self.decoder, (8, 7, 5, 3), strict=True):
            y = self.activation(conv(torch.cat([y, layers[skip - 1]], dim=1)))
        y = torch.cat([y, layers[0]], dim=1)
        return _same(self.last, y.float() if self.frozen else y)[:, 0]


class PaperUNets(nn.Module):
    """The pair: inputs → (mean in dB, log variance), each ``[batch, row, col]`` in float32."""

    def __init__(self, blind: bool = False) -> None:
        super().__init__()
        self.blind = blind
        self.mean = PaperUNet(1 if blind else 2, "relu")
        self.variance = PaperUNet(1 if blind else 2, "tanh")

    def adapted(self, state: dict[str, Tensor]) -> dict[str, Tensor]:
        """Weights of the pair that sees the map made to fit this one: a blind pair leaves out the
        filters of the height map."""
        first = [key for key in state if key.endswith("encoder.0.weight")] if self.blind else []
        return state | {
            key: state[key][:, GAIN_CHANNEL : GAIN_CHANNEL + 1]
            for key in first
            if state[key].shape[1] == 2
        }

    def frozen(self, dtype: torch.dtype) -> PaperUNets:
        """Made ready to answer in ``dtype``, never to be trained again: filters worked out once.

        The last layers stay in single precision, so that the answer is not rounded to steps of a
        bfloat16.
        """
        self.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        for layer in self.modules():
            if isinstance(layer, UpsampledConv2d):
                weight, bias = layer.filters()
                layer.kept = (
                    weight.to(dtype).contiguous(memory_format=torch.channels_last),
                    bias.to(dtype),
                )
        for net in (self.mean, self.variance):
            last = copy.deepcopy(net.last)
            net.to(dtype)
            net.last, net.frozen = last, True
        return self

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        inputs = inputs.to(self.mean.dense.weight.dtype)
        mean = GAIN_CENTRE_DB + GAIN_SCALE_DB * self.mean(inputs).float()
        log_variance = math.log(15.0**2) + self.variance(inputs).float()
        lowest, highest = 2 * math.log(SMALLEST_STD_DB), 2 * math.log(PAPER_LARGEST_STD_DB)
        return mean, log_variance.clamp(lowest, highest)


def _same(conv: nn.Module, x: Tensor) -> Tensor:
    # An even filter cannot be centred: one more row and column of zeros goes to the north and east.
    return conv(F.pad(x, (1, 2, 1, 2)))


def _phases(weight: Tensor, dim: int) -> tuple[Tensor, Tensor]:
    """The three-tap filters of even and of odd outputs along ``dim`` of a four-tap filter."""
    a, b, c, d = weight.unbind(dim)
    return torch.stack([a, b + c, d], dim), torch.stack([torch.zeros_like(a), a + b, c + d], dim)
