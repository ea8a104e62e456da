"""Networks on ONNX Runtime, the default.

The graph of a network stands in a file of some kilobytes beside its weights and holds none of
them: they are handed over when the session begins. Where that file is missing, as for weights
trained here, the graph is made anew if the package ``onnx`` is installed.
"""

from __future__ import annotations

__all__ = ["function", "session"]

from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError, require
from skygain.networks.runtime import GRAPH_KEY, Arrays, Definition, Function
from skygain.networks.weights import Weights, graph_file

QUIET = 4
"""severity of what ONNX Runtime may print: fatal errors only; ours say it in a line"""


def session(graph: bytes, arrays: dict[str, NDArray[np.float32]]) -> Any:
    """An inference session of ``graph`` with its weights, on one thread that does not spin."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    options.log_severity_level = QUIET
    values = [onnxruntime.OrtValue.ortvalue_from_numpy(array) for array in arrays.values()]
    options.add_external_initializers(list(arrays), values)
    return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


def function(definition: Definition, weights: Weights) -> Function:
    """The network as a function of arrays.

    Raises:
        InputError: the weights are another network's, or there is no graph and no ``onnx`` to make
            one.
    """
    path = graph_file(weights.path)
    if path.exists():
        graph = path.read_bytes()
    else:
        require("onnx", "train")
        from skygain.networks.graphs import graph_of

        graph = graph_of(definition, weights)
    try:
        run = session(graph, weights.handed)
        kind = run.get_modelmeta().custom_metadata_map.get(GRAPH_KEY)
    except Exception as error:  # the library's errors have no common base of their own
        reason = str(error).splitlines()[0]
        raise InputError(
            f"{weights.path} does not fit the network {definition.name!r} ({reason}); "
            "export it again"
        ) from error
    if kind != definition.name:
        raise InputError(
            f"{weights.path} holds the network {kind!r}, expected {definition.name!r}; "
            "give weights of that network"
        )
    outputs = list(definition.outputs)

    def answer(*inputs: NDArray[np.float32]) -> Arrays:
        return tuple(run.run(outputs, dict(zip(definition.inputs, inputs, strict=True))))

    return answer
