"""Networks as ONNX files, for on-board computers without PyTorch.

The file holds the network alone: inputs are those of the network (`path_features` for the operator,
`direct_inputs` and `paper_inputs` for the U-Nets, `evidence_channels` for the locator), outputs a
mean in dB and a log variance, or the locator's log probabilities. The exported file is run once
beside PyTorch, and nothing is written if they disagree.
"""

from __future__ import annotations

__all__ = ["NETWORKS", "export_onnx"]

import logging
import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import nn

from skygain.ground.errors import InputError, require
from skygain.networks.weights import load_network

TOLERANCE = 1e-3
"""dB (or nats) by which ONNX Runtime may differ from PyTorch"""


def _operator() -> tuple[nn.Module, int]:
    from skygain.networks.operator.features import CHANNELS
    from skygain.networks.operator.network import PropagationOperator

    return PropagationOperator(), len(CHANNELS)


def _locator() -> tuple[nn.Module, int]:
    from skygain.networks.operator.evidence import CHANNELS
    from skygain.networks.operator.locator import LocatorNet

    return LocatorNet(), len(CHANNELS)


def _direct() -> tuple[nn.Module, int]:
    from skygain.networks.unets.direct import CHANNELS, DirectNet

    return DirectNet(), CHANNELS


def _paper(blind: bool) -> tuple[nn.Module, int]:
    from skygain.networks.unets.paper import PaperUNets

    return PaperUNets(blind), 1 if blind else 2


NETWORKS: dict[str, Callable[[], tuple[nn.Module, int]]] = {
    "operator": _operator,
    "locator": _locator,
    "unet": _direct,
    "paper-unet": lambda: _paper(False),
    "paper-unet-mapblind": lambda: _paper(True),
}
"""name → (network, number of input channels)"""


def export_onnx(
    name: str,
    path: str | Path,
    *,
    weights: str | Path | None = None,
    shape: tuple[int, int] = (96, 96),
) -> float:
    """Write the network ``name`` with its weights (or the file ``weights``) for maps of ``shape``
    cells as the ONNX file ``path``.

    The batch may have any size. Returns the largest difference to PyTorch on random inputs, dB.

    Raises:
        InputError: no such network, no weights for it, or ONNX Runtime disagrees with PyTorch by
            more than `TOLERANCE`.
        MissingExtraError: the extra ``onnx`` is not installed.
    """
    if name not in NETWORKS:
        raise InputError(f"no network is called {name!r}; known: {', '.join(NETWORKS)}")
    require("onnxscript", "onnx")
    runtime = require("onnxruntime", "onnx")
    network, channels = NETWORKS[name]()
    load_network(network, weights if weights is not None else name)
    example = torch.randn(2, channels, *shape, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        answer = network(example)
    expected = [part.numpy() for part in (answer if isinstance(answer, tuple) else (answer,))]
    names = ["mean_db", "log_variance"] if len(expected) == 2 else ["log_probability"]
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        part = Path(folder) / "network.onnx"
        torch.onnx.export(
            network,
            (example,),
            part,
            input_names=["inputs"],
            output_names=names,
            dynamic_shapes={"inputs": {0: torch.export.Dim("batch", min=1)}},
            dynamo=True,
            external_data=False,
            verbose=False,
        )
        session = runtime.InferenceSession(part, providers=["CPUExecutionProvider"])
        found = session.run(None, {"inputs": example.numpy()})
        worst = max(
            float(np.abs(_finite(a) - _finite(b)).max())
            for a, b in zip(found, expected, strict=True)
        )
        if worst > TOLERANCE:
            raise InputError(
                f"ONNX Runtime differs from PyTorch by {worst:.2g}, more than {TOLERANCE:g}; "
                "nothing was written"
            )
        os.replace(part, path)
    return worst


def _finite(values: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(values), values, -1e4)
