"""Networks on PyTorch, for who trains them and for who asks for ``runtime="torch"``.

Answers are those of ONNX Runtime in float32. Where the processor computes in bfloat16, does so
faster and to the same answer on a fixed input, convolutions run in it: the maps then differ by
some hundredths of a decibel.
"""

from __future__ import annotations

__all__ = ["bf16_pays", "function", "load_network", "load_policy"]

import contextlib
import functools
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.ground.errors import InputError
from skygain.networks.operator.locator import LocatorNet
from skygain.networks.operator.network import OperatorConfig, PropagationOperator
from skygain.networks.policies.network import policy_network
from skygain.networks.policies.weights import definition_of, policy_file
from skygain.networks.processor import bf16_instructions
from skygain.networks.runtime import DEFINITIONS, Arrays, Definition, Function
from skygain.networks.unets.direct import DirectNet
from skygain.networks.unets.paper import PaperUNets
from skygain.networks.weights import Weights, read_weights

BF16_DIFFERENCE = 0.01
"""largest share of root mean square by which bfloat16 may differ from float32"""


def load_network(network: nn.Module, name: str | Path, *, adapt: bool = False) -> dict[str, Any]:
    """Fill ``network`` with the weights called ``name`` (or in the file ``name``), set it to
    evaluation, and return their card.

    With ``adapt`` weights of a network that sees more may begin the training of one that sees less.
    """
    weights = read_weights(name)
    _fill(network, weights, adapt)
    return weights.card


def _fill(network: nn.Module, weights: Weights, adapt: bool = False) -> None:
    state = {key: torch.from_numpy(value) for key, value in weights.arrays.items()}
    if adapt and isinstance(network, PaperUNets):
        state = network.adapted(state)
    missing, unexpected = network.load_state_dict(state, strict=False)
    missing = [key for key in missing if not key.endswith("num_batches_tracked")]
    if missing or unexpected:
        raise InputError(
            f"{weights.path} does not fit this network (first mismatch: "
            f"{(missing + unexpected)[0]}); export it again"
        )
    network.eval()


def module_of(definition: Definition, weights: Weights) -> nn.Module:
    """The network in PyTorch, filled.

    Raises:
        InputError: the weights are another network's.
    """
    net = weights.task.get("net")
    sizes = [OperatorConfig(**net)] if net else []
    if definition.name.startswith("policy-"):
        network = policy_network(weights.card["policy"])
    elif definition.name == "paper-unet":
        first = weights.arrays.get("mean.encoder.0.weight")
        network = PaperUNets(first is not None and first.shape[1] == 1)
    else:
        kind = {"operator": PropagationOperator, "locator": LocatorNet, "unet": DirectNet}
        network = kind[definition.name](*sizes)
    _fill(network, weights)
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def load_policy(weights: str | Path) -> nn.Module:
    """The network of a trained policy, by name or file.

    Raises:
        InputError: there are no such weights, or the file is no policy's.
    """
    found = read_weights(policy_file(weights))
    return module_of(DEFINITIONS[definition_of(found.card, found.path)], found)


def function(definition: Definition, weights: Weights) -> Function:
    """The network as a function of arrays.

    Raises:
        InputError: the weights are another network's.
    """
    network, faster = module_of(definition, weights), bf16_pays()
    call = network.logits if isinstance(network, LocatorNet) else network
    if isinstance(network, PaperUNets):
        network.frozen(torch.bfloat16 if faster else torch.float32)
        faster = False  # the network itself is in bfloat16 now

    def answer(*inputs: NDArray[np.float32]) -> Arrays:
        with torch.inference_mode(), _autocast(faster):
            found = call(*(_tensor(array) for array in inputs))
        several = found if isinstance(found, tuple) else (found,)
        return tuple(tensor.float().numpy() for tensor in several)

    return answer


def _tensor(array: NDArray[np.float32]) -> Tensor:
    tensor = torch.from_numpy(np.ascontiguousarray(array))
    return tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor


def _autocast(wanted: bool) -> Any:
    return torch.autocast("cpu", dtype=torch.bfloat16) if wanted else contextlib.nullcontext()


@functools.cache
def bf16_pays() -> bool:
    """Whether bfloat16 is native to this processor and, on a fixed stack of plain and strided
    convolutions, faster than float32 and of the same answer; measured once per process."""
    if not bf16_instructions():
        return False
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(4, 48, 48, 48, generator=generator).to(memory_format=torch.channels_last)
    filters = [
        torch.randn(96, width, size, size, generator=generator) / (width * size**2) ** 0.5
        for width, size in ((48, 2), (96, 3), (96, 3))
    ]

    def answer(fast: bool) -> Tensor:
        with torch.inference_mode(), _autocast(fast):
            y = nn.functional.conv2d(x, filters[0], stride=2)
            for weight in filters[1:]:
                y = nn.functional.conv2d(torch.relu(y), weight, padding=1)
            return y.float()

    slow, fast = answer(False), answer(True)
    agrees = (slow - fast).square().mean() <= BF16_DIFFERENCE**2 * slow.square().mean()
    return bool(agrees) and _seconds(answer, True) < _seconds(answer, False)


def _seconds(answer: Any, fast: bool) -> float:
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        answer(fast)
        times.append(time.perf_counter() - begun)
    return min(times)
