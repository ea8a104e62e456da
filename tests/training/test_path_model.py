"""Training the cheap gain model of one path."""

from pathlib import Path

import skygain
from skygain.networks.operator.path_model import PathModel
from skygain.training import train_predictor

SAMPLE = Path(skygain.__file__).parent / "data" / "sample.zarr.zip"


def test_training_writes_a_file_that_loads(tmp_path):
    result = train_predictor("path-model", SAMPLE, tmp_path, rounds=40)
    again = PathModel.load(result.checkpoint)
    assert 0 < result.scores["rmse_db"] < 60
    assert [matrix.shape for matrix, _ in again.layers] == [(13, 48), (48, 48), (48, 2)]
