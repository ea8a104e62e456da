"""How training uses the machine: device, bfloat16 and threads are chosen here and nowhere else."""

from __future__ import annotations

__all__ = ["autocast", "best_device", "computes_bf16", "threads"]

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

from skygain.networks.processor import bf16_instructions


def best_device() -> torch.device:
    """CUDA where there is one, else the processor."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def computes_bf16(device: torch.device) -> bool:
    """Whether ``device`` has instructions for bfloat16; without them it is slower than float32."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return bool(bf16_instructions())


def autocast(wanted: bool, device: torch.device = torch.device("cpu")) -> Callable[[], Any]:  # noqa: B008 - never changed
    """Contexts of bfloat16 autocast if ``wanted`` and ``device`` computes in it."""
    enabled = wanted and computes_bf16(device)
    return functools.partial(torch.autocast, device.type, dtype=torch.bfloat16, enabled=enabled)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """``count`` threads inside each operation of PyTorch. Small networks want one: several would
    only wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
