"""The judge of candidates: its sums, its inputs, its two implementations, and its training."""

from importlib.resources import files

import numpy as np
import pytest
import torch

from skygain.ground.errors import InputError
from skygain.networks.checkpoints import save_checkpoint
from skygain.networks.operator.judge import INPUTS, TERMS, CandidateJudge, error_terms, judge_inputs
from skygain.networks.weights import find_weights
from skygain.training import train_predictor
from skygain.training.judge import _Network

SAMPLE = files("skygain") / "data" / "sample.zarr.zip"


@pytest.fixture
def readings(rng):
    z, whitened = rng.standard_t(2, size=(2, 40, 7)).astype(np.float32)
    return z, whitened, rng.uniform(2, 15, (40, 7)).astype(np.float32), rng.uniform(-150, -60, 40)


def test_terms_add_up_over_sets_of_readings(readings):
    z, whitened, std, gain = readings
    first, second = (
        error_terms(z[part], whitened[part], std[part], gain[part])
        for part in (slice(0, 13), slice(13, 40))
    )
    assert first.shape == (len(TERMS), 7)
    assert np.allclose(first + second, error_terms(*readings), rtol=1e-4, atol=1e-4)


def test_a_candidate_that_agrees_better_looks_better(readings):
    z, whitened, std, gain = readings
    z, whitened, std = (np.repeat(a[:, :1], 2, axis=1) for a in (z, whitened, std))
    z[:, 1] *= 3
    whitened[:, 1] *= 3
    inputs = judge_inputs(
        error_terms(z, whitened, std, gain), 40, np.full(2, 0.5), np.full(2, 10), np.full(2, 8.0)
    )
    assert inputs.shape == (2, INPUTS)
    assert (inputs[0, :17] == 0).all()
    assert (inputs[1, :17] < 0).all()


def test_candidates_are_judged_alike_in_any_order(readings, rng):
    order = rng.permutation(7)
    sums, mass = error_terms(*readings), rng.dirichlet(np.ones(7))
    squares, spread = rng.integers(1, 30, 7), rng.uniform(0, 20, 7)
    plain = judge_inputs(sums, 40, mass, squares, spread)
    assert np.array_equal(
        plain[order], judge_inputs(sums[:, order], 40, mass[order], squares[order], spread[order])
    )


def test_numpy_and_pytorch_judge_alike(tmp_path, rng):
    torch.manual_seed(0)
    inputs = torch.from_numpy(rng.normal(size=(9, INPUTS)).astype(np.float32))
    network = _Network(inputs, 5)
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
    options = {"pool": tmp_path / "pool", "report": said.append, "weight_decay": 0.0}
    first = train_predictor("judge", SAMPLE, tmp_path / "a", rounds=1, **options)
    flights = [line for line in said if "pool" in line]
    assert {line["split"] for line in flights} == {"T2", "T3"}
    longer = train_predictor("judge", SAMPLE, tmp_path / "b", rounds=40, **options)
    assert [line for line in said if "pool" in line] == flights
    losses = [line["loss"] for line in said if "loss" in line]
    assert losses[-1] < losses[0]
    assert set(first.scores) == {"cross_entropy", "rmse_db", "rmse_of_nearest_db"}
    assert CandidateJudge.load(longer.checkpoint).linear.shape == (INPUTS,)
    with pytest.raises(InputError, match="no option 'max_seconds'"):
        train_predictor("judge", SAMPLE, tmp_path, max_seconds=3.0)
