"""Optimisers to and from named tensors, so that a checkpoint needs no pickle."""

from __future__ import annotations

__all__ = ["autocast", "optimiser_tensors", "restore_optimiser", "under"]

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor


def optimiser_tensors(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """``index.key`` → tensor for everything Adam remembers of each parameter."""
    state = optimiser.state_dict()["state"]
    return {
        f"{index}.{key}": value for index, entry in state.items() for key, value in entry.items()
    }


def restore_optimiser(optimiser: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    """The inverse of `optimiser_tensors`."""
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        index, _, key = name.partition(".")
        # fused Adam walks through memory, so its moments must lie as the parameter does (channels
        # last)
        if value.ndim:
            value = torch.empty_like(parameters[int(index)], dtype=value.dtype).copy_(value)
        state.setdefault(int(index), {})[key] = value
    optimiser.load_state_dict(
        {"state": state, "param_groups": optimiser.state_dict()["param_groups"]}
    )


def under(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose names begin with ``prefix``, without it."""
    return {
        key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)
    }


def autocast(wanted: bool) -> Callable[[], Any]:
    """Contexts of bfloat16 autocast if ``wanted`` and the CPU computes in it natively."""
    native = torch.backends.mkldnn.is_available() and bool(
        torch.ops.mkldnn._is_mkldnn_bf16_supported()
    )
    return functools.partial(torch.autocast, "cpu", dtype=torch.bfloat16, enabled=wanted and native)
