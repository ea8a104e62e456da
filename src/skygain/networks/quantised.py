"""Large weight matrices in 4 or 8 bits: what lets a dense layer of 21 million weights ship.

A matrix is cut into groups of consecutive weights of a row. Each group keeps its smallest value and
a step in float16, and every weight the nearest of the 16 or 256 values in between. A network
computes in float32; on ONNX Runtime matrices of 4 bits stay as they are and are multiplied with
directly, which takes an eighth of the memory's time.
"""

from __future__ import annotations

__all__ = ["CENTRE", "GROUP", "dequantised", "multipliable", "quantised"]

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

GROUP = 64
"""weights that share a smallest value and a step"""
CENTRE = 8
"""code of 4 bits that a multiplication takes for nothing"""
SUFFIXES = (".q4", ".q8", ".low", ".step")


def quantised(name: str, weight: NDArray[np.floating], bits: int) -> dict[str, NDArray]:
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
    groups = weight.astype(np.float32).reshape(weight.shape[0], -1, GROUP)
    low = groups.min(axis=-1).astype(np.float16)
    # Steps are rounded up to float16, so that the largest weight of a group stays within reach.
    step = (groups.max(axis=-1) - low.astype(np.float32)) / (2**bits - 1) * np.float32(1 + 2**-10)
    step = np.maximum(step, np.float32(6e-8)).astype(np.float16)
    code = (groups - low.astype(np.float32)[..., None]) / step.astype(np.float32)[..., None]
    code = np.clip(np.rint(code), 0, 2**bits - 1).astype(np.uint8).reshape(weight.shape)
    if bits == 4:
        code = code[:, 0::2] | (code[:, 1::2] << 4)
    return {f"{name}.q{bits}": np.ascontiguousarray(code), f"{name}.low": low, f"{name}.step": step}


def dequantised(arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """``arrays`` with every quantised matrix as float32 again, under its own name."""
    out = {key: value for key, value in arrays.items() if not key.endswith(SUFFIXES)}
    for key, code in arrays.items():
        name, _, kind = key.rpartition(".")
        if kind not in ("q4", "q8"):
            continue
        low, step = (arrays[f"{name}.{part}"].astype(np.float32) for part in ("low", "step"))
        weight = np.empty((*low.shape, GROUP), dtype=np.float32)
        if kind == "q4":
            pairs = code.reshape(*low.shape, GROUP // 2)
            weight[..., 0::2], weight[..., 1::2] = pairs & 15, pairs >> 4
        else:
            weight[:] = code.reshape(weight.shape)
        weight *= step[..., None]
        weight += low[..., None]
        out[name] = weight.reshape(len(code), -1)
    return out


def multipliable(arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """What multiplies with matrices of 4 bits as they are: ``{name.q4, name.step, name.middle}``.

    A weight is low + step·code = step·(code − 8) + middle, so a product with x is one with the
    codes ``q4[out, group, byte]`` and one of ``middle[out, group]`` with the sums of x over groups;
    ``step[out * group]``.
    """
    out: dict[str, NDArray] = {}
    for key, code in arrays.items():
        name, _, kind = key.rpartition(".")
        if kind == "q4":
            low, step = (arrays[f"{name}.{part}"].astype(np.float32) for part in ("low", "step"))
            out[key] = code.reshape(*low.shape, GROUP // 2)
            out[f"{name}.step"] = step.ravel()
            out[f"{name}.middle"] = low + CENTRE * step
    return out
