"""ONNX files answer as PyTorch does."""

import numpy as np
import pytest
import torch

from skygain.ground.errors import InputError
from skygain.networks.checkpoints import save_checkpoint
from skygain.networks.onnx_export import TOLERANCE, export_onnx
from skygain.networks.operator.evidence import CHANNELS
from skygain.networks.operator.locator import LocatorNet


def test_a_network_answers_the_same_without_pytorch(tmp_path):
    runtime = pytest.importorskip("onnxruntime", reason="the extra 'onnx' is not installed")
    pytest.importorskip("onnxscript", reason="the extra 'onnx' is not installed")
    torch.manual_seed(0)
    network = LocatorNet().eval()
    save_checkpoint(tmp_path / "w.safetensors", network.state_dict(), {"name": "untrained"})
    path = tmp_path / "new" / "locator.onnx"
    assert (
        export_onnx("locator", path, weights=tmp_path / "w.safetensors", shape=(16, 24))
        <= TOLERANCE
    )
    inputs = torch.rand(3, len(CHANNELS), 16, 24)
    with torch.inference_mode():
        expected = network(inputs).numpy()
    found = runtime.InferenceSession(path).run(None, {"inputs": inputs.numpy()})[0]
    assert np.allclose(found, expected, atol=TOLERANCE)
    assert [p.name for p in path.parent.iterdir()] == ["locator.onnx"]


def test_the_shipped_operator_answers_the_same_without_pytorch(tmp_path):
    pytest.importorskip("onnxruntime", reason="the extra 'onnx' is not installed")
    pytest.importorskip("onnxscript", reason="the extra 'onnx' is not installed")
    assert export_onnx("operator", tmp_path / "operator.onnx", shape=(24, 32)) <= TOLERANCE


def test_an_unknown_network_is_named(tmp_path):
    with pytest.raises(InputError, match="known: operator"):
        export_onnx("kriging", tmp_path / "k.onnx")
    assert not any(tmp_path.iterdir())
