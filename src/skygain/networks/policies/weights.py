"""Weight files of policies: half precision, large dense layers in bytes.

The paper's policy network has 19 million weights, 99 % of them in one dense layer. Stored as bytes
(`quantised`), they take a quarter of the space.
"""

from __future__ import annotations

__all__ = ["export_policy", "load_policy", "policy_file"]

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from skygain.ground.errors import InputError
from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.policies.network import policy_network
from skygain.networks.quantised import dequantised, quantised
from skygain.networks.weights import LARGE, find_weights


def export_policy(state: dict[str, Tensor], path: Path, card: dict[str, Any]) -> None:
    """Write the weights ``state`` with ``card`` (its key ``policy`` describes the network) to
    ``path``, and the card as JSON beside it."""
    tensors: dict[str, Tensor] = {}
    for key, value in state.items():
        if value.ndim == 2 and value.numel() >= LARGE:
            tensors |= quantised(key, value, 8)
        else:
            tensors[key] = value.to(torch.float16).contiguous()
    save_checkpoint(path, tensors, card)
    path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n")


def policy_file(weights: str | Path) -> Path:
    """The file ``weights`` if it ends in ``.safetensors``, else that of the policy of this name.

    Raises:
        InputError: there is none; the message says which command makes it.
    """
    path = Path(weights)
    if path.suffix == ".safetensors":
        return path
    try:
        return find_weights(str(weights))
    except InputError:
        raise InputError(
            f"the policy {str(weights)!r} does not ship with this version and was not trained "
            "here; make it with: "
            f"skygain train policy --recipe {weights} --data CITIES.zarr.zip"
        ) from None


def load_policy(weights: str | Path) -> tuple[nn.Module, Tensor | None]:
    """A trained policy by name or file: the network, and the support of its returns (``None`` for
    an imitator).

    Raises:
        InputError: there are no such weights, or the file is no policy's.
    """
    path = policy_file(weights)
    tensors, card = load_checkpoint(path)
    if "policy" not in card:
        raise InputError(f"{path} holds no policy; give a file written by `skygain train policy`")
    shape = card["policy"]
    network = policy_network(shape)
    state = {key: value.float() for key, value in dequantised(tensors).items()}
    missing, unexpected = network.load_state_dict(state, strict=False)
    if missing or unexpected:
        raise InputError(
            f"{path} does not fit its network (first mismatch: {(missing + unexpected)[0]}); "
            "export it again"
        )
    network.eval()
    z = (
        None
        if shape["atoms"] == 1
        else torch.linspace(shape["v_min"], shape["v_max"], shape["atoms"])
    )
    return network, z
