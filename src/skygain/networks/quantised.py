"""Large weight matrices in 4 or 8 bits: what lets a dense layer of 21 million weights ship.

A matrix is cut into groups of consecutive weights of a row. Each group keeps its smallest value and
a step in float16, and every weight the nearest of the 16 or 256 values in between (asymmetric
uniform quantisation, as in the weight-only formats used for language models). Only the file is
small; a loaded network computes in float32.
"""

from __future__ import annotations

__all__ = ["dequantised", "quantised"]

import torch
from torch import Tensor

GROUP = 64
"""weights that share a smallest value and a step"""
SUFFIXES = (".q4", ".q8", ".low", ".step")


def quantised(name: str, weight: Tensor, bits: int) -> dict[str, Tensor]:
    """``weight[out, in]`` as ``{name.q4 | name.q8, name.low, name.step}``; two 4-bit weights share
    a byte.

    Raises:
        ValueError: bits other than 4 and 8, or rows that no number of whole groups fills.
    """
    if bits not in (4, 8):
        raise ValueError(f"bits must be 4 or 8, got {bits}")
    if weight.ndim != 2 or weight.shape[1] % GROUP:
        raise ValueError(
            f"expected a matrix with rows of a multiple of {GROUP} weights, got shape "
            f"{tuple(weight.shape)}"
        )
    groups = weight.float().reshape(weight.shape[0], -1, GROUP)
    low = groups.amin(-1).half()
    # Steps are rounded up to float16, so that the largest weight of a group stays within reach.
    step = ((groups.amax(-1) - low.float()) / (2**bits - 1) * (1 + 2**-10)).clamp(min=6e-8).half()
    code = (
        ((groups - low.float()[..., None]) / step.float()[..., None])
        .round()
        .clamp(0, 2**bits - 1)
        .to(torch.uint8)
    )
    code = code.reshape(weight.shape)
    if bits == 4:
        code = code[:, 0::2] | (code[:, 1::2] << 4)
    return {f"{name}.q{bits}": code.contiguous(), f"{name}.low": low, f"{name}.step": step}


def dequantised(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """``tensors`` with every quantised matrix as float32 again, under its own name."""
    out = {key: value for key, value in tensors.items() if not key.endswith(SUFFIXES)}
    for key, code in tensors.items():
        name, _, kind = key.rpartition(".")
        if kind not in ("q4", "q8"):
            continue
        if kind == "q4":
            code = torch.stack([code & 15, code >> 4], dim=-1).flatten(1)
        low, step = tensors[f"{name}.low"].float(), tensors[f"{name}.step"].float()
        groups = code.reshape(code.shape[0], -1, GROUP).float()
        out[name] = (groups * step[..., None] + low[..., None]).reshape(code.shape)
    return out
