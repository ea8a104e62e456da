"""ONNX graphs of the networks, without weights.

A graph is made from the names and shapes of the weights it will be given; they are declared as data
that lies elsewhere. Only this module needs the package ``onnx``. That a graph answers as the
network in PyTorch is a test.
"""

from __future__ import annotations

__all__ = ["definition_for", "export_onnx", "graph_of", "write_graph"]

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from onnx import ModelProto, TensorProto, helper, numpy_helper

from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.networks.operator.evidence import EVIDENCE_CHANNELS, TEMPERED
from skygain.networks.operator.features import CHANNELS as PATH_CHANNELS
from skygain.networks.policies.inputs import FAR, FAR_CHANNELS, NEAR, NEAR_CHANNELS, NUMBERS
from skygain.networks.policies.planes import PLANES
from skygain.networks.policies.weights import definition_of
from skygain.networks.quantised import GROUP
from skygain.networks.runtime import DEFINITIONS, GRAPH_KEY, Definition
from skygain.networks.scales import (
    FREE_SPACE_5GHZ_DB,
    GAIN_CENTRE_DB,
    GAIN_SCALE_DB,
    LARGEST_STD_DB,
    OPEN_LOGITS,
    PAPER_LARGEST_STD_DB,
    PAPER_SIDE,
    SMALLEST_STD_DB,
)
from skygain.networks.unets.inputs import DIRECT_CHANNELS
from skygain.networks.weights import Weights, graph_file, read_weights

OPSET, IR_VERSION = 17, 8
"""old enough for every ONNX Runtime that `pyproject.toml` allows"""
MICROSOFT = "com.microsoft"
"""domain of the operations that only ONNX Runtime has"""
HEADS = 4
"""attention heads, where the card does not say"""


class _Graph:
    """Nodes in the making. A method adds some and returns the name of their output."""

    def __init__(self, weights: Weights) -> None:
        self.weights = weights
        self.nodes: list[Any] = []
        self.used: dict[str, TensorProto] = {}

    def node(self, kind: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        names = [f"{kind}_{len(self.nodes)}_{k}" for k in range(outputs)]
        self.nodes.append(helper.make_node(kind, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def misfit(self, name: str) -> InputError:
        return InputError(
            f"{self.weights.path} does not fit this network (first mismatch: {name}); "
            "export it again"
        )

    def weight(self, name: str) -> str:
        array = self.weights.arrays.get(name, self.weights.codes.get(name))
        if array is None:
            raise self.misfit(name)
        whole = array.dtype == np.uint8
        tensor = TensorProto(name=name, data_type=TensorProto.UINT8 if whole else TensorProto.FLOAT)
        tensor.dims.extend(array.shape)
        tensor.data_location = TensorProto.EXTERNAL
        tensor.external_data.add(key="location", value="weights")
        self.used[name] = tensor
        return name

    def shape(self, name: str) -> tuple[int, ...]:
        self.weight(name)
        return self.weights.arrays[name].shape

    def constant(self, value: ArrayLike, kind: type = np.float32) -> str:
        array: NDArray[Any] = np.asarray(value, dtype=kind)
        name = f"constant_{len(self.used)}"
        self.used[name] = numpy_helper.from_array(array, name)
        return name

    def affine(self, x: str, factor: float, offset: float | str) -> str:
        scaled = self.node("Mul", x, self.constant(factor))
        added = offset if isinstance(offset, str) else self.constant(offset)
        return self.node("Add", scaled, added)

    def conv(self, x: str, name: str, pads: int | list[int] = 0, stride: int = 1) -> str:
        inputs = [x, self.weight(f"{name}.weight")]
        if f"{name}.bias" in self.weights.arrays:
            inputs.append(self.weight(f"{name}.bias"))
        padding = [pads] * 4 if isinstance(pads, int) else pads
        return self.node("Conv", *inputs, pads=padding, strides=[stride] * 2)

    def transposed(self, x: str, name: str) -> str:
        weight, bias = self.weight(f"{name}.weight"), self.weight(f"{name}.bias")
        return self.node("ConvTranspose", x, weight, bias, strides=[2, 2])

    def norm(self, x: str, name: str) -> str:
        parts = ("weight", "bias", "running_mean", "running_var")
        return self.node("BatchNormalization", x, *(self.weight(f"{name}.{p}") for p in parts))

    def relu(self, x: str) -> str:
        return self.node("Relu", x)

    def dense(self, x: str, name: str) -> str:
        if f"{name}.weight.q4" in self.weights.codes:
            return self.coded(x, f"{name}.weight", f"{name}.bias")
        weight, bias = self.weight(f"{name}.weight"), self.weight(f"{name}.bias")
        return self.node("Gemm", x, weight, bias, transB=1)

    def coded(self, x: str, name: str, bias: str) -> str:
        """A dense layer whose matrix stays in 4 bits, see `quantised.multipliable`."""
        out, groups = self.weights.codes[f"{name}.middle"].shape
        self.used[name] = TensorProto()  # nobody asks for it unpacked
        size = {"K": groups * GROUP, "N": out, "bits": 4, "block_size": GROUP}
        inputs = x, self.weight(f"{name}.q4"), self.weight(f"{name}.step")
        product = self.node("MatMulNBits", *inputs, domain=MICROSOFT, **size)
        grouped = self.reshape(x, [-1, groups, GROUP])
        sums = self.node("ReduceSum", grouped, self.constant([2], np.int64), keepdims=0)
        middle = self.weight(f"{name}.middle")
        return self.node(
            "Add", product, self.node("Gemm", sums, middle, self.weight(bias), transB=1)
        )

    def channel(self, x: str, index: int) -> str:
        return self.node("Gather", x, self.constant(index, np.int64), axis=1)

    def reshape(self, x: str, shape: list[int]) -> str:
        return self.node("Reshape", x, self.constant(shape, np.int64))

    def clip(self, x: str, smallest_std_db: float, largest_std_db: float) -> str:
        low, high = (2 * math.log(std) for std in (smallest_std_db, largest_std_db))
        return self.node("Clip", x, self.constant(low), self.constant(high))


def _residual(g: _Graph, x: str, name: str) -> str:
    y = g.conv(g.relu(g.norm(x, f"{name}.norm1")), f"{name}.conv1", 1)
    return g.node("Add", x, g.conv(g.relu(g.norm(y, f"{name}.norm2")), f"{name}.conv2", 1))


def _attention(g: _Graph, x: str, name: str, heads: int) -> str:
    width = g.shape(f"{name}.out.weight")[0]
    qkv = g.conv(g.norm(x, f"{name}.norm"), f"{name}.qkv")
    apart = g.node("Split", g.reshape(qkv, [0, 3, heads, width // heads, -1]), outputs=3, axis=1)
    q, k, v = (g.reshape(part, [0, heads, width // heads, -1]) for part in apart)
    q = g.node("Transpose", q, perm=[0, 1, 3, 2])  # sample, head, cell, part
    scale = g.constant(1 / math.sqrt(width // heads))
    share = g.node("Softmax", g.node("Mul", g.node("MatMul", q, k), scale), axis=-1)
    y = g.node("MatMul", v, g.node("Transpose", share, perm=[0, 1, 3, 2]))
    y = g.node("Reshape", y, g.node("Shape", x))
    return g.node("Add", x, g.conv(y, f"{name}.out"))


def _body(g: _Graph) -> tuple[str, str]:
    """The two maps of a residual U-Net, see `skygain.networks.operator.network`."""

    def stage(x: str, name: str) -> str:
        for k in range(len(g.weights.arrays)):
            if f"{name}.{k}.conv1.weight" in g.weights.arrays:
                x = _residual(g, x, f"{name}.{k}")
            elif f"{name}.{k}.qkv.weight" in g.weights.arrays:
                x = _attention(g, x, f"{name}.{k}", heads)
            else:
                break
        return x

    heads = g.weights.task.get("net", {}).get("heads", HEADS)
    x0 = g.relu(g.conv("inputs", "stem", 1))
    x1 = stage(g.conv(x0, "down1", stride=2), "enc1")
    x2 = stage(g.conv(x1, "down2", stride=2), "enc2")
    x3 = stage(g.conv(x2, "down3", stride=2), "enc3")
    y2 = _residual(g, g.node("Add", g.transposed(x3, "up2"), x2), "dec2")
    y1 = stage(g.node("Add", g.transposed(y2, "up1"), x1), "dec1")
    joined = g.node("Concat", g.relu(g.transposed(y1, "up0")), x0, axis=1)
    y0 = g.conv(g.relu(g.conv(joined, "merge", 1)), "head", 1)
    return g.channel(y0, 0), g.channel(y0, 1)


def _log_variance(g: _Graph, out: str) -> str:
    return g.clip(g.affine(out, 2.0, math.log(100.0)), SMALLEST_STD_DB, LARGEST_STD_DB)


def _operator(g: _Graph) -> tuple[str, ...]:
    mean, spread = _body(g)
    distance = g.channel("inputs", PATH_CHANNELS.index("log_distance"))
    free_space = g.affine(distance, -20.0, FREE_SPACE_5GHZ_DB - 40.0)
    return g.affine(mean, 20.0, free_space), _log_variance(g, spread)


def _direct(g: _Graph) -> tuple[str, ...]:
    mean, spread = _body(g)
    smooth = g.affine(g.channel("inputs", -1), GAIN_SCALE_DB, GAIN_CENTRE_DB)
    return g.affine(mean, 20.0, smooth), _log_variance(g, spread)


def _locator(g: _Graph) -> tuple[str, ...]:
    logits, _ = _body(g)
    tempered = g.node("Mul", g.channel("inputs", TEMPERED), g.weight("power"))
    closed = g.node(
        "LessOrEqual", g.channel("inputs", EVIDENCE_CHANNELS.index("open")), g.constant(0.0)
    )
    return (
        g.node("Where", closed, g.constant(-math.inf), g.affine(logits, OPEN_LOGITS, tempered)),
    )


SAME = [1, 1, 2, 2]
"""zeros around a map for a 4 × 4 filter: one row and column more to the north and east"""


def _upsampled(g: _Graph, x: str, skip: str, name: str, activation: str) -> str:
    """A 4 × 4 convolution of two maps upsampled twofold as four smaller ones of each, of three taps
    for even and of two for odd rows and columns, see `skygain.networks.unets.paper`."""
    taps = np.zeros(
        (2, 3, 4)
    )  # phase, tap of three, tap of four; the first tap of odd ones is none
    taps[0, [0, 1, 1, 2], range(4)] = taps[1, [1, 1, 2, 2], range(4)] = 1
    parts = []
    for row, col in np.ndindex(2, 2):
        above = g.node("MatMul", g.constant(taps[row, row:]), g.weight(f"{name}.weight"))
        both = g.node("MatMul", above, g.constant(taps[col, col:].T))
        pads = [1 - row, 1 - col, 1, 1]
        mine, skipped = g.node("Split", both, outputs=2, axis=1)
        y = g.node("Conv", x, mine, g.weight(f"{name}.bias"), pads=pads)
        z = g.node("Conv", skip, skipped, pads=pads)
        parts.append(g.node(activation, g.node("Add", y, z)))
    joined = g.node("Concat", *parts, axis=1)
    return g.node("DepthToSpace", joined, blocksize=2, mode="DCR")


def _last(g: _Graph, x: str, name: str) -> str:
    """A 4 × 4 convolution with one output as a 7 × 7 one of stride 4 with sixteen, which a
    processor computes together."""
    into = g.shape(f"{name}.weight")[1]
    taps = np.zeros((4, 7, 4))  # output of four, tap of seven, tap of four
    for k in range(4):
        taps[k, range(k, k + 4), range(4)] = 1
    rows = g.node("MatMul", g.constant(taps.reshape(28, 4)), g.weight(f"{name}.weight"))
    both = g.node("MatMul", rows, g.constant(taps.reshape(28, 4).T))
    apart = g.reshape(both, [into, 4, 7, 4, 7])
    filters = g.reshape(g.node("Transpose", apart, perm=[1, 3, 0, 2, 4]), [16, into, 7, 7])
    y = g.node("Conv", x, filters, pads=SAME, strides=[4, 4])
    whole = g.node("DepthToSpace", y, blocksize=4)
    return g.node("Add", whole, g.reshape(g.weight(f"{name}.bias"), [1, 1, 1, 1]))


def _paper_one(g: _Graph, name: str, activation: str) -> str:
    x, layers = "inputs", []
    for k in range(8):
        x = g.conv(x, f"{name}.encoder.{k}", SAME)
        if k % 2:
            x = g.node("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2])
        x = g.node(activation, x)
        layers.append(x)
    y = g.node(activation, g.dense(g.node("Flatten", x), f"{name}.dense"))
    y = g.reshape(y, [-1, g.shape(f"{name}.encoder.7.weight")[0], 6, 6])
    for k, skip in enumerate((8, 7, 5, 3)):
        y = _upsampled(g, y, layers[skip - 1], f"{name}.decoder.{k}", activation)
    out = _last(g, g.node("Concat", y, layers[0], axis=1), f"{name}.last")
    return g.channel(out, 0)


def _paper(g: _Graph) -> tuple[str, ...]:
    mean = g.affine(_paper_one(g, "mean", "Relu"), GAIN_SCALE_DB, GAIN_CENTRE_DB)
    spread = g.affine(_paper_one(g, "variance", "Tanh"), 1.0, math.log(15.0**2))
    return mean, g.clip(spread, SMALLEST_STD_DB, PAPER_LARGEST_STD_DB)


def _perceptron(g: _Graph, x: str, name: str, last: bool) -> str:
    """Dense layers ``name.0``, ``name.2``, …; ReLU between them and, if ``last``, at the end."""
    k = 0
    while f"{name}.{k}.weight" in g.weights.arrays:
        x, k = g.dense(x, f"{name}.{k}"), k + 2
        if last or f"{name}.{k}.weight" in g.weights.arrays:
            x = g.relu(x)
    return x


def _centred(g: _Graph) -> tuple[str, ...]:
    towers = []
    for x in ("near", "far"):
        y = x
        for k in (0, 2, 4):
            y = g.relu(g.conv(y, f"{x}.{k}", 1, 2))
        towers.append(g.node("Flatten", y))
    x = _perceptron(g, g.node("Concat", *towers, "numbers", axis=1), "body", True)
    out = g.reshape(g.dense(x, "head"), [-1, 4, g.shape("head.weight")[0] // 4])
    if "value.weight" in g.weights.arrays:
        centred = g.node("Sub", out, g.node("ReduceMean", out, axes=[1], keepdims=1))
        value = g.reshape(g.dense(x, "value"), [-1, 1, g.shape("value.weight")[0]])
        out = g.node("Add", centred, value)
    return (out,)


def _paper_policy(g: _Graph) -> tuple[str, ...]:
    x = "inputs"
    for k, pads in ((0, 1), (2, 1), (4, 0)):
        x = g.relu(g.conv(x, f"features.{k}", pads, 2))
    out = _perceptron(g, g.node("Flatten", x), "head", False)
    return (g.reshape(out, [-1, 4, g.shape("head.6.weight")[0] // 4]),)


MAKERS: dict[str, Callable[[_Graph], tuple[str, ...]]] = {
    "operator": _operator,
    "locator": _locator,
    "unet": _direct,
    "paper-unet": _paper,
    "policy-centred": _centred,
    "policy-paper": _paper_policy,
}


class _Input(NamedTuple):
    """One input that is a map."""

    first: str
    """the filter that reads it, which tells how many channels these weights want"""
    channels: tuple[int, ...]
    """how many there may be"""
    size: tuple[int | str, int | str] = ("row", "col")
    """rows and columns; names where they vary"""


SQUARE = (PAPER_SIDE, PAPER_SIDE)
INPUTS = {
    ("operator", "inputs"): _Input("stem.weight", (len(PATH_CHANNELS),)),
    ("locator", "inputs"): _Input("stem.weight", (len(EVIDENCE_CHANNELS),)),
    ("unet", "inputs"): _Input("stem.weight", (DIRECT_CHANNELS,)),
    ("paper-unet", "inputs"): _Input("mean.encoder.0.weight", (1, 2), SQUARE),
    ("policy-centred", "near"): _Input("near.0.weight", (len(NEAR_CHANNELS),), (NEAR, NEAR)),
    ("policy-centred", "far"): _Input("far.0.weight", (len(FAR_CHANNELS),), (FAR, FAR)),
    ("policy-paper", "inputs"): _Input("features.0.weight", (len(PLANES),)),
}


def graph_of(definition: Definition, weights: Weights) -> bytes:
    """The graph that takes ``weights``, as the bytes of an ONNX file without any of them.

    Raises:
        InputError: these are not the weights of such a network.
    """
    return _model(definition, weights).SerializeToString(deterministic=True)


def definition_for(name: str, weights: Weights) -> Definition:
    """What kind of network the weights called ``name`` are for: the one that the name begins with,
    as in ``paper-unet-mapblind``; a policy's card says it.

    Raises:
        InputError: no such network.
    """
    if "policy" in weights.card:
        return DEFINITIONS[definition_of(weights.card, weights.path)]
    found = next((kind for kind in DEFINITIONS if name.startswith(kind)), None)
    if found is None:
        known = ", ".join(kind for kind in DEFINITIONS if not kind.startswith("policy-"))
        raise InputError(f"no network is called {name!r}; known: {known} and policies")
    return DEFINITIONS[found]


def write_graph(name: str, weights: Path) -> Path:
    """Write the graph of the weights called ``name`` in the file ``weights`` beside it; returns
    where."""
    path, found = graph_file(weights), read_weights(weights)
    graph = graph_of(definition_for(name, found), found)
    with atomic_write(path) as tmp:
        tmp.write_bytes(graph)
    return path


def export_onnx(name: str, path: str | Path, *, weights: str | Path | None = None) -> None:
    """Write the network ``name`` with its weights (or those in the file ``weights``) as the one
    ONNX file ``path``, for other programs. Batch and map may have any size.

    Raises:
        InputError: no such network or weights, or those of another network.
    """
    found = replace(read_weights(name if weights is None else weights), codes={})
    model = _model(definition_for(name, found), found)
    for tensor in model.graph.initializer:
        if tensor.data_location == TensorProto.EXTERNAL:
            tensor.CopyFrom(numpy_helper.from_array(found.arrays[tensor.name], tensor.name))
    with atomic_write(path) as tmp:
        tmp.write_bytes(model.SerializeToString())


def _model(definition: Definition, weights: Weights) -> ModelProto:
    g = _Graph(weights)
    outputs = MAKERS[definition.name](g)
    if left := [key for key in weights.arrays if key not in g.used]:
        raise g.misfit(left[0])
    for made, wanted in zip(outputs, definition.outputs, strict=True):
        g.nodes.append(helper.make_node("Identity", [made], [wanted]))
    graph = helper.make_graph(
        g.nodes,
        definition.name,
        [_input(name, definition.name, g) for name in definition.inputs],
        [_value(name, None) for name in definition.outputs],
        [tensor for tensor in g.used.values() if tensor.name],
    )
    imports = [helper.make_opsetid("", OPSET)]
    if weights.codes:
        imports.append(helper.make_opsetid(MICROSOFT, 1))
    model = helper.make_model(graph, opset_imports=imports, ir_version=IR_VERSION)
    model.metadata_props.add(key=GRAPH_KEY, value=definition.name)
    return model


def _input(name: str, definition: str, g: _Graph) -> Any:
    if name == "numbers":
        return _value(name, ["sample", NUMBERS])
    maps = INPUTS[definition, name]
    channels = g.shape(maps.first)[1]
    if channels not in maps.channels:
        raise g.misfit(maps.first)
    return _value(name, ["sample", channels, *maps.size])


def _value(name: str, shape: list[int | str] | None) -> Any:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
