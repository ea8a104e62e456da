"""The locator network: evidence maps of `transmitter_evidence` → log probability of every square to
hold the transmitter."""

from __future__ import annotations

__all__ = ["LocatorNet"]

import torch
from torch import Tensor, nn

from skygain.networks.operator.evidence import EVIDENCE_CHANNELS, TEMPERED
from skygain.networks.operator.network import OperatorConfig, ResidualUNet
from skygain.networks.scales import OPEN_LOGITS

OPEN = EVIDENCE_CHANNELS.index("open")
SIZES = OperatorConfig(stem=24, widths=(40, 64, 96), blocks=(1, 1, 2))


class LocatorNet(ResidualUNet):
    """``[batch, channel, row, col]`` → log probability ``[batch, row * col]``, minus infinity where
    nothing can stand; `logits` is the same as a map and not yet normalised.

    The network corrects the tempered likelihood it is given and starts from it.
    """

    def __init__(self, config: OperatorConfig = SIZES) -> None:
        super().__init__(len(EVIDENCE_CHANNELS), config)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]
        self.power = nn.Parameter(torch.tensor(5.0))

    def logits(self, inputs: Tensor) -> Tensor:
        """``[batch, row, col]``"""
        correction = OPEN_LOGITS * self.body(inputs)[:, 0]
        logits = self.power * inputs[:, TEMPERED].float() + correction
        return logits.masked_fill(inputs[:, OPEN] <= 0, -torch.inf)

    def forward(self, inputs: Tensor) -> Tensor:
        return torch.log_softmax(self.logits(inputs).flatten(1), dim=1)
