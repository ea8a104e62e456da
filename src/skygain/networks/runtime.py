"""What runs a trained network: a weight file becomes a function of NumPy arrays.

`load` gives the function. The default runtime is ONNX Runtime, which the base installation has;
``"torch"`` asks for PyTorch, which the extra ``train`` brings. Both answer alike in float32. A
batch and a map may have any size where the network's definition allows it.

An answer depends on its own sample alone: each network computes on one thread, and several threads
share a batch. So results do not depend on the number of threads.
"""

from __future__ import annotations

__all__ = ["DEFINITIONS", "GRAPH_KEY", "RUNTIMES", "Definition", "Network", "load", "n_threads"]

import importlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.networks.weights import Weights, read_weights

Arrays = tuple[NDArray[np.float32], ...]
Function = Callable[..., Arrays]
"""inputs ``[sample, …]`` in float32 → outputs ``[sample, …]`` in float32"""

GRAPH_KEY = "skygain"
"""of a graph's metadata: the name of its definition"""
RUNTIMES = {
    "onnx": "skygain.networks.onnx_runtime",
    "torch": "skygain.networks.torch_runtime",
}
"""name → module with ``function(definition, weights)``"""


@dataclass(frozen=True)
class Definition:
    """One kind of network, whatever its weights."""

    name: str
    """what cards and graphs call it"""
    inputs: tuple[str, ...] = ("inputs",)
    """names of what goes in"""
    outputs: tuple[str, ...] = ("mean_db", "log_variance")
    """names of what comes out"""
    multiple: int = 1
    """rows and columns of its maps come in multiples of this; `Network` repeats the edge as far as
    needed and cuts the answer"""
    at_once: int = 4
    """samples of a batch that one thread computes together"""


DEFINITIONS = {
    d.name: d
    for d in (
        Definition("operator", multiple=8),
        Definition("locator", outputs=("logits",), multiple=8),
        Definition("unet", multiple=8),
        Definition("paper-unet"),
        Definition("policy-centred", ("near", "far", "numbers"), ("logits",), at_once=64),
        Definition("policy-paper", outputs=("logits",)),
    )
}


@dataclass(frozen=True, eq=False)
class Network:
    """A trained network, called with its inputs, each ``[sample, …]``."""

    definition: Definition
    """what kind of network"""
    weights: Weights
    """with their card"""
    function: Function
    """what the runtime made of them"""

    def __call__(self, *inputs: NDArray[np.float32]) -> Arrays:
        """The outputs, each ``[sample, …]``."""
        shape, multiple = inputs[0].shape, self.definition.multiple
        room = [-n % multiple for n in shape[2:]]
        if any(room):
            pad = ((0, 0), (0, 0), *((0, n) for n in room))
            whole = self._shared(*(np.pad(array, pad, mode="edge") for array in inputs))
            rows, cols = shape[2:]
            return tuple(array[..., :rows, :cols] for array in whole)
        return self._shared(*inputs)

    def _shared(self, *inputs: NDArray[np.float32]) -> Arrays:
        size, step = len(inputs[0]), self.definition.at_once
        if size <= step:
            return self.function(*inputs)
        parts = [
            tuple(array[first : first + step] for array in inputs) for first in range(0, size, step)
        ]
        with ThreadPoolExecutor(n_threads()) as pool:
            found = list(pool.map(lambda part: self.function(*part), parts))
        return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def load(definition: str, weights: str | Path, runtime: str = "onnx") -> Network:
    """The network ``definition`` with the weights of that name (or in that file), run by
    ``runtime``.

    Raises:
        InputError: no such runtime, no such weights, or those of another network.
        MissingExtraError: the runtime is not installed.
    """
    if runtime not in RUNTIMES:
        raise InputError(f"no runtime is called {runtime!r}; known: {', '.join(RUNTIMES)}")
    kind, found = DEFINITIONS[definition], read_weights(weights)
    return Network(kind, found, importlib.import_module(RUNTIMES[runtime]).function(kind, found))


def n_threads() -> int:
    """Threads that share a batch: ``OMP_NUM_THREADS`` where it is set, as in every worker process
    of ours, else one for each processor this process may use."""
    wanted = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    if wanted.isdecimal() and int(wanted):
        return int(wanted)
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1
