"""The judge: PyTorch's twin of the network in use, and its training."""

import numpy as np
import pytest
import torch

from skygain.datasets.sample import SAMPLE
from skygain.ground.errors import InputError
from skygain.networks.operator.judge import INPUTS, CandidateJudge
from skygain.networks.weights import find_weights
from skygain.training import train_predictor
from skygain.training.checkpoints import save_checkpoint
from skygain.training.judge import JudgeNetwork


def test_numpy_and_pytorch_judge_alike(tmp_path, rng):
    torch.manual_seed(0)
    inputs = torch.from_numpy(rng.normal(size=(9, INPUTS)).astype(np.float32))
    network = JudgeNetwork(inputs, 5)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    save_checkpoint(tmp_path / "judge.safetensors", network.tensors(), {})
    judge = CandidateJudge.load(tmp_path / "judge.safetensors")
    with torch.inference_mode():
        expected = network(inputs).exp().numpy()
    assert np.allclose(judge.probability(inputs.numpy()), expected, atol=1e-5)
    with pytest.raises(InputError, match="no weights of a judge"):
        CandidateJudge.load(find_weights("path-model"))
    sharper = judge.probability(inputs.numpy(), 2.0)
    assert np.allclose(sharper, expected**2 / (expected**2).sum(), atol=1e-5)


def test_training_flies_once_and_lowers_the_error(tmp_path):
    said = []
    options = {"pool": str(tmp_path / "pool"), "report": said.append, "weight_decay": 0.0}
    first = train_predictor("judge", SAMPLE, tmp_path / "a", rounds=1, **options)
    flights = [line for line in said if "pool" in line]
    assert {line["split"] for line in flights} == {"T2", "T3"}
    train_predictor("judge", SAMPLE, tmp_path / "b", rounds=40, **options)
    assert [line for line in said if "pool" in line] == flights
    losses = [line["loss"] for line in said if "loss" in line]
    assert losses[-1] < losses[0]
    assert set(first.scores) == {"cross_entropy", "rmse_db", "rmse_of_nearest_db"}
    assert CandidateJudge.load(tmp_path / "b" / "judge.safetensors").linear.shape == (INPUTS,)
    with pytest.raises(InputError, match="no setting `finish`"):
        train_predictor("judge", SAMPLE, tmp_path, finish=3)
