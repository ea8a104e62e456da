"""A weight file becomes a function of arrays, and every runtime gives the same one."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.networks.graphs import export_onnx, graph_of, write_graph
from skygain.networks.operator.evidence import EVIDENCE_CHANNELS
from skygain.networks.operator.features import CHANNELS
from skygain.networks.policies.inputs import FAR, FAR_CHANNELS, NEAR, NEAR_CHANNELS, NUMBERS
from skygain.networks.policies.planes import PLANES
from skygain.networks.processor import bf16_instructions
from skygain.networks.runtime import DEFINITIONS, Network, load, n_threads
from skygain.networks.unets.inputs import DIRECT_CHANNELS
from skygain.networks.weights import find_weights, graph_file, read_weights, write_weights

AGREE = 1e-3
"""dB, nats or logits by which runtimes may differ in float32"""
SHIPPED = {
    "operator": "operator",
    "locator": "locator",
    "unet": "unet",
    "paper-unet": "paper-unet",
    "dqn": "policy-centred",
    "imitation": "policy-centred",
}


def channels(definition, blind=False):
    return {
        "operator": len(CHANNELS),
        "locator": len(EVIDENCE_CHANNELS),
        "unet": DIRECT_CHANNELS,
        "paper-unet": 1 if blind else 2,
        "policy-paper": len(PLANES),
    }[definition]


def inputs_for(definition, rng, size=3, shape=(24, 32), blind=False):
    if definition == "policy-centred":
        shapes = ((len(NEAR_CHANNELS), NEAR, NEAR), (len(FAR_CHANNELS), FAR, FAR), (NUMBERS,))
        return tuple(rng.random((size, *s), dtype=np.float32) for s in shapes)
    shape = {"paper-unet": (96, 96), "policy-paper": (48, 48)}.get(definition, shape)
    return (rng.standard_normal((size, channels(definition, blind), *shape), dtype=np.float32),)


def alike(one, two):
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        assert a.shape == b.shape
        assert a.dtype == b.dtype == np.float32
        finite = np.isfinite(a)
        assert np.array_equal(finite, np.isfinite(b))
        assert np.abs(a[finite] - b[finite]).max() <= AGREE


def in_float32(definition, weights):
    """The same network on PyTorch, never in bfloat16."""
    torch_runtime = pytest.importorskip(
        "skygain.networks.torch_runtime", reason="PyTorch is not installed"
    )
    kind, found = DEFINITIONS[definition], read_weights(weights)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch_runtime, "bf16_pays", lambda: False)
        return Network(kind, found, torch_runtime.function(kind, found))


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("shape", [(24, 32), (33, 17)])
def test_shipped_weights_answer_as_on_pytorch(name, shape, rng):
    definition = SHIPPED[name]
    if definition.startswith(("policy", "paper")) and shape != (24, 32):
        pytest.skip("this network's maps have one size")
    maps = inputs_for(definition, rng, shape=shape)
    alike(load(definition, name)(*maps), in_float32(definition, name)(*maps))


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_graphs_are_what_the_code_makes(name):
    weights = read_weights(name)
    graph = graph_file(weights.path).read_bytes()
    assert graph == graph_of(DEFINITIONS[SHIPPED[name]], weights)
    assert len(graph) < 40_000


def untrained(definition, folder, **options):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from skygain.networks.operator.network import OperatorConfig, PropagationOperator
    from skygain.networks.policies.network import policy_network
    from skygain.networks.unets.paper import PaperUNets

    torch.manual_seed(0)
    card = {"name": "untrained"}
    if definition == "operator":
        sizes = {"stem": 4, "widths": [8, 8, 8], "blocks": [2, 1, 3], "heads": 2}
        network = PropagationOperator(OperatorConfig(**sizes))
        card["recipe"] = {"task": {"net": sizes}}
    elif definition == "paper-unet":
        network = PaperUNets(**options)
    else:
        card["policy"] = {"side": 48, "v_min": 0.0, "v_max": 1.0, **options}
        network = policy_network(card["policy"])
    write_weights(folder / "w.safetensors", network.state_dict(), card)
    return folder / "w.safetensors"


@pytest.mark.parametrize(
    ("definition", "options"),
    [
        ("operator", {}),
        ("paper-unet", {"blind": True}),
        ("policy-paper", {"network": "paper", "atoms": 5, "dueling": False}),
        ("policy-centred", {"network": "centred", "atoms": 7, "dueling": False}),
        ("policy-centred", {"network": "centred", "atoms": 7, "dueling": True}),
    ],
)
def test_networks_of_other_sizes_answer_as_on_pytorch(definition, options, tmp_path, rng):
    file = untrained(definition, tmp_path, **options)
    maps = inputs_for(definition, rng, blind=options.get("blind", False))
    expected = in_float32(definition, file)(*maps)
    alike(load(definition, file)(*maps), expected)
    write_graph("paper-unet-mapblind" if options.get("blind") else definition, file)
    alike(load(definition, file)(*maps), expected)


def test_an_answer_depends_on_its_own_sample_alone(rng, monkeypatch):
    network = load("operator", "operator")
    (maps,) = inputs_for("operator", rng, size=9, shape=(16, 24))
    alone = [np.concatenate(c) for c in zip(*(network(m[None]) for m in maps), strict=True)]
    for threads in ("1", "3"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        assert all(map(np.array_equal, network(maps), alone))


def test_threads_are_those_of_the_environment_or_all(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3,2")
    assert n_threads() == 3
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert 1 <= n_threads() <= (os.cpu_count() or 1)


def test_the_torch_runtime_agrees_in_whatever_it_computes(rng):
    pytest.importorskip("torch", reason="PyTorch is not installed")
    (maps,) = inputs_for("operator", rng, shape=(48, 48))
    answers = [load("operator", "operator", runtime)(maps) for runtime in ("onnx", "torch")]
    for found, expected in zip(*answers, strict=True):
        assert np.sqrt(np.mean((found - expected) ** 2)) < 0.3


def test_bf16_is_a_flag_of_the_processor(tmp_path):
    def found(flags):
        file = tmp_path / f"{len(flags)}"
        file.write_text(f"processor : 0\nflags\t\t: fpu {flags}\n")
        return bf16_instructions(file)

    assert found("avx512bw avx512vl avx512dq") == ""
    assert found("avx512bw avx512_bf16") == "avx512"
    assert found("avx512_bf16 amx_bf16 amx_tile") == "amx"
    assert bf16_instructions(tmp_path / "absent") == ""


def test_a_processor_without_bf16_never_computes_in_it(monkeypatch):
    torch_runtime = pytest.importorskip(
        "skygain.networks.torch_runtime", reason="PyTorch is not installed"
    )
    monkeypatch.setattr(torch_runtime, "bf16_instructions", lambda: "")
    assert torch_runtime.bf16_pays.__wrapped__() is False


def test_an_exported_file_answers_alone(tmp_path, rng):
    onnxruntime = pytest.importorskip("onnxruntime")
    path = tmp_path / "new" / "locator.onnx"
    export_onnx("locator", path)
    (maps,) = inputs_for("locator", rng)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    alike(session.run(None, {"inputs": maps}), load("locator", "locator")(maps))


def test_what_cannot_run_is_named(tmp_path, rng):
    with pytest.raises(InputError, match="no runtime is called 'tensors'; known: onnx, torch"):
        load("operator", "operator", "tensors")
    with pytest.raises(InputError, match="does not fit this network"):
        load("operator", write_without_graph("unet", tmp_path))
    with pytest.raises(InputError, match="holds the network 'unet', expected 'operator'"):
        load("operator", "unet")
    with pytest.raises(InputError, match="known: operator"):
        export_onnx("kriging", tmp_path / "k.onnx", weights=find_weights("judge"))
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"no weights")
    with pytest.raises(InputError, match="not a weight file of Skygain"):
        load("operator", broken)


def write_without_graph(name, folder):
    weights = read_weights(name)
    write_weights(folder / f"{name}.safetensors", weights.arrays, weights.card)
    return folder / f"{name}.safetensors"


WITHOUT_TORCH = """
import sys


class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "onnx"):
            raise ImportError(f"{name} is not installed here")


sys.meta_path.insert(0, Absent())
from skygain.app.cli import main

folder = sys.argv[1]
for predictor, planner in (("operator", "lookahead"), ("unet", "dqn"), ("paper-unet", "imitation")):
    call = ["survey", "--city", "sample:9", "--predictor", predictor, "--planner", planner]
    sys.argv = ["skygain", *call, "--steps", "4", "--out", f"{folder}/{predictor}"]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
"""


def test_everything_learned_flies_without_torch(tmp_path):
    """In an interpreter where neither torch nor onnx can be imported."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, str(tmp_path)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    for predictor in ("operator", "unet", "paper-unet"):
        scores = json.loads((tmp_path / predictor / "results.json").read_text())["scores"]
        assert 1.0 < scores["rmse_db"] < 60.0
