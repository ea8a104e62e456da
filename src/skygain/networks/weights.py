"""Weights that ship with the package or were trained here, and the card that says where they come
from.

A weight file is safetensors; the card stands in its header and, readable, beside it. Weights are
looked for by name in the package first, then in `runs_folder`, where `train_predictor` leaves them;
a file of one's own is given by its path.
"""

from __future__ import annotations

__all__ = ["export_weights", "find_weights", "load_network", "runs_folder", "weight_file"]

import json
import os
from pathlib import Path
from typing import Any

import torch
from torch import nn

from skygain.ground.errors import InputError
from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.quantised import dequantised, quantised
from skygain.networks.unets.paper import PaperUNets

LARGE = 1_000_000
"""weights beyond which a matrix is worth quantising"""
PACKAGE_WEIGHTS = Path(__file__).parents[1] / "data" / "weights"


def runs_folder() -> Path:
    """Where runs go unless told otherwise: ``$SKYGAIN_CACHE/runs``, by default
    ``~/.cache/skygain/runs``."""
    return Path(os.environ.get("SKYGAIN_CACHE", Path.home() / ".cache" / "skygain")) / "runs"


def find_weights(name: str) -> Path:
    """The weight file called ``name``.

    Raises:
        InputError: there is none; the message says which command makes it.
    """
    for path in (
        PACKAGE_WEIGHTS / f"{name}.safetensors",
        runs_folder() / name / f"{name}.safetensors",
    ):
        if path.exists():
            return path
    raise InputError(
        f"the weights {name!r} do not ship with this version and were not trained here; make them "
        "with: "
        f"skygain train predictor --recipe {name} (a data set is needed: skygain dataset --help)"
    )


def weight_file(name: str | Path) -> Path:
    """The file ``name`` if it ends in ``.safetensors``, else the weights of that name."""
    return Path(name) if str(name).endswith(".safetensors") else find_weights(str(name))


def export_weights(checkpoint: Path, path: Path, card: dict[str, Any], bits: int = 0) -> None:
    """Write the averaged weights of a run as a float16 weight file with ``card`` in its header, and
    the card as JSON beside it.

    With ``bits`` 4 or 8, matrices of more than a million weights are quantised.
    """
    tensors, meta = load_checkpoint(checkpoint)
    half: dict[str, torch.Tensor] = {}
    for key, value in tensors.items():
        name = key.removeprefix("average.")
        if key == name:
            continue
        if bits and value.ndim == 2 and value.numel() > LARGE:
            half |= quantised(name, value, bits)
        else:
            half[name] = value.to(torch.float16)
    card = {
        **card,
        "steps": meta["step"],
        "training_seconds": round(meta["seconds"]),
        "scores": meta["scores"],
        **_recipe(meta),
    }
    save_checkpoint(path, half, card)
    path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n")


def load_network(network: nn.Module, name: str | Path, *, adapt: bool = False) -> dict[str, Any]:
    """Fill ``network`` with the weights called ``name`` (or in the file ``name``), set it to
    evaluation, and return their card.

    With ``adapt`` weights of a network that sees more may begin the training of one that sees less.
    """
    path = weight_file(name)
    tensors, card = load_checkpoint(path)
    if any(key.startswith("average.") for key in tensors):  # a run's own checkpoint
        tensors = {
            key.removeprefix("average."): value
            for key, value in tensors.items()
            if key.startswith("average.")
        }
    tensors = dequantised(tensors)
    state = {
        key: value.float() if value.is_floating_point() else value for key, value in tensors.items()
    }
    if adapt and isinstance(network, PaperUNets):
        state = network.adapted(state)
    missing, unexpected = network.load_state_dict(state, strict=False)
    missing = [key for key in missing if not key.endswith("num_batches_tracked")]
    if missing or unexpected:
        raise InputError(
            f"{path} does not fit this network (first mismatch: {(missing + unexpected)[0]}); "
            "export it again"
        )
    network.eval()
    return card


def _recipe(meta: dict[str, Any]) -> dict[str, Any]:
    config = {key: value for key, value in meta["config"].items() if key not in ("data", "out")}
    config["start_from"] = "/".join(
        Path(config.get("start_from", "")).parts[-2:]
    )  # no folder of this machine
    return {"samples": meta["step"] * config["batch_size"], "recipe": config}
