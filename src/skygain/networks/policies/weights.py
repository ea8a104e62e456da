"""Weight files of policies: half precision, large dense layers in bytes.

The paper's policy network has 19 million weights, 99 % of them in one dense layer. Stored as bytes
(`quantised`), they take a quarter of the space.
"""

from __future__ import annotations

__all__ = ["definition_of", "export_policy", "policy_file"]

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skygain.ground.errors import InputError, did_you_mean
from skygain.networks.weights import (
    POLICIES,
    TRAINABLE,
    find_weights,
    packed,
    trained_here,
    write_weights,
)


def export_policy(state: Mapping[str, Any], path: Path, card: dict[str, Any]) -> None:
    """Write the weights ``state`` with ``card`` (its key ``policy`` describes the network) to
    ``path``, and the card as JSON beside it."""
    write_weights(path, packed(state, bits=8), card)


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
        if str(weights) not in POLICIES:
            raise InputError(
                f"there is no policy {str(weights)!r} (a file ends in .safetensors); "
                f"{did_you_mean(str(weights), sorted({*POLICIES, *trained_here()} - {*TRAINABLE}))}"
            ) from None
        raise InputError(
            f"the policy {str(weights)!r} does not ship with this version and was not trained "
            "here; make it with: "
            f"skygain train policy --recipe {weights} --data CITIES.zarr.zip"
        ) from None


def definition_of(card: dict[str, Any], path: Path) -> str:
    """The definition of the network that the card of a policy's file describes.

    Raises:
        InputError: the file is no policy's.
    """
    if "policy" not in card:
        raise InputError(f"{path} holds no policy; give a file written by `skygain train policy`")
    return f"policy-{card['policy']['network']}"
