"""Training the cheap gain model of one path."""

import pytest
import torch

from skygain.datasets.sample import SAMPLE
from skygain.networks.operator.path_model import PathModel
from skygain.training import train_predictor
from skygain.training.checkpoints import load_checkpoint


def test_training_writes_a_file_that_loads(tmp_path):
    result = train_predictor("path-model", SAMPLE, tmp_path, rounds=40)
    again = PathModel.load(tmp_path / "path-model.safetensors")
    assert 0 < result.scores["rmse_db"] < 60
    assert [matrix.shape for matrix, _ in again.layers] == [(13, 48), (48, 48), (48, 2)]


def test_a_killed_run_ends_with_the_same_bytes(tmp_path):
    def killed(record):
        if record["step"] == 40:  # said before the checkpoint of this round is written
            raise KeyboardInterrupt

    whole = train_predictor("path-model", SAMPLE, tmp_path / "whole", rounds=45)
    with pytest.raises(KeyboardInterrupt):
        train_predictor("path-model", SAMPLE, tmp_path / "parts", rounds=45, report=killed)
    parts = train_predictor("path-model", SAMPLE, tmp_path / "parts", rounds=45)
    one, two = (load_checkpoint(run.checkpoint)[0] for run in (whole, parts))
    assert one.keys() == two.keys()
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert parts.scores == whole.scores
