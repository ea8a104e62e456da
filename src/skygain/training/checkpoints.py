"""State of a run on disk: tensors as safetensors, everything else as JSON, nothing ever unpickled.

A checkpoint is written beside the old one and renamed, so a kill at any moment leaves a whole one.
"""

from __future__ import annotations

__all__ = ["load_checkpoint", "save_checkpoint"]

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write


def save_checkpoint(path: Path, tensors: dict[str, Tensor], meta: dict[str, Any]) -> None:
    """Write ``tensors`` and ``meta`` (JSON) to the single file ``path``, atomically."""
    from safetensors.torch import save

    held = {k: v.detach().contiguous() for k, v in tensors.items()}
    with atomic_write(path) as part:
        # the library's own writing hides what is wrong with a disk
        part.write_bytes(save(held, metadata={"skygain": json.dumps(meta)}))


def load_checkpoint(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The tensors and the meta data of ``path``.

    Raises:
        InputError: the file is missing or no checkpoint of ours.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            meta = json.loads((file.metadata() or {})["skygain"])
            return {key: torch.clone(file.get_tensor(key)) for key in file.keys()}, meta  # noqa: SIM118 - not a dict
    except (OSError, SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path} is not a Skygain checkpoint ({error}); give a file written by `skygain train`"
        ) from error
