"""Policy networks: the paper's (Table II), and a compact one with a view centred on the UAV.

Both map what a UAV sees to ``[sample, move, atom]`` logits: of the distribution of the return for
Q-learning, or with a single atom of the choice of a move for imitation.
"""

from __future__ import annotations

__all__ = ["POLICY_NETWORKS", "CentredNetwork", "PaperQNetwork", "policy_network"]

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.flight.moves import N_MOVES
from skygain.ground.errors import InputError
from skygain.networks.policies.inputs import (
    FAR_CHANNELS,
    NEAR_CHANNELS,
    NUMBERS,
    Seen,
    centred_view,
    paper_view,
    turned_view,
)
from skygain.networks.policies.planes import PLANES


class PaperQNetwork(nn.Module):
    """Convolutions of 64-128-256 channels, filters 4, 4, 2, strides 2, 2, 2; dense layers of
    512-256-40-160; ReLU between.

    The table's third layer of 16 × 16 does not follow from 24 × 24 by any stride; with stride 2 it
    is 12 × 12.
    """

    def __init__(self, atoms: int = 40, side: int = 96, dueling: bool = False) -> None:
        if dueling:
            raise InputError(
                "the paper's policy network has no dueling head; choose the network 'centred'"
            )
        super().__init__()
        self.atoms, self.side = atoms, side
        self.features = nn.Sequential(
            nn.Conv2d(len(PLANES), 64, 4, 2, 1),
            nn.ReLU(),
            nn.Conv2d(64, 128, 4, 2, 1),
            nn.ReLU(),
            nn.Conv2d(128, 256, 2, 2),
            nn.ReLU(),
        )
        self.head = nn.Sequential(
            nn.Linear(256 * (side // 8) ** 2, 512),
            nn.ReLU(),
            nn.Linear(512, 256),
            nn.ReLU(),
            nn.Linear(256, 40),
            nn.ReLU(),
            nn.Linear(40, N_MOVES * atoms),
        )

    def inputs(self, seen: Seen, symmetry: int = 0) -> tuple[Tensor, ...]:
        """What the network is called with under a symmetry of the square.

        Raises:
            InputError: the map is larger than the network's.
        """
        return _tensors(paper_view(seen, self.side, symmetry))

    def forward(self, x: Tensor) -> Tensor:
        return self.head(self.features(x).flatten(1)).float().view(-1, N_MOVES, self.atoms)


class CentredNetwork(nn.Module):
    """Two convolutional towers over the two scales of the centred view, joined by dense layers; 0.8
    million weights."""

    def __init__(self, atoms: int = 1, side: int = 0, dueling: bool = False) -> None:
        super().__init__()
        self.atoms, self.dueling = atoms, dueling
        self.near = _tower(len(NEAR_CHANNELS))
        self.far = _tower(len(FAR_CHANNELS))
        self.body = nn.Sequential(
            nn.Linear(64 * (5 * 5 + 4 * 4) + NUMBERS, 256),
            nn.ReLU(),
            nn.Linear(256, 128),
            nn.ReLU(),
        )
        self.head = nn.Linear(128, N_MOVES * atoms)
        self.value = nn.Linear(128, atoms) if dueling else None

    def inputs(self, seen: Seen, symmetry: int = 0) -> tuple[Tensor, ...]:
        """What the network is called with under a symmetry of the square."""
        return _tensors(*turned_view(centred_view(seen), symmetry))

    def forward(self, near: Tensor, far: Tensor, numbers: Tensor) -> Tensor:
        x = self.body(
            torch.cat([self.near(near).flatten(1), self.far(far).flatten(1), numbers], dim=1)
        )
        out = self.head(x).float().view(-1, N_MOVES, self.atoms)
        if self.value is None:
            return out
        return out - out.mean(dim=1, keepdim=True) + self.value(x).float()[:, None]


def _tensors(*arrays: NDArray[np.float32]) -> tuple[Tensor, ...]:
    return tuple(
        t.contiguous(memory_format=torch.channels_last) if t.ndim == 4 else t
        for t in map(torch.from_numpy, arrays)
    )


def _tower(channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels, 32, 3, 2, 1),
        nn.ReLU(),
        nn.Conv2d(32, 64, 3, 2, 1),
        nn.ReLU(),
        nn.Conv2d(64, 64, 3, 2, 1),
        nn.ReLU(),
    )


POLICY_NETWORKS = {"paper": PaperQNetwork, "centred": CentredNetwork}
"""by the name that stands in a run's settings and in a weight file's card"""


def policy_network(shape: dict[str, Any]) -> nn.Module:
    """The network that ``shape`` (keys network, atoms, side, dueling) describes, weights from
    PyTorch's global generator."""
    network = POLICY_NETWORKS[shape["network"]](shape["atoms"], shape["side"], shape["dueling"])
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
