"""A training that is killed or told to end goes on to the very weights of one left alone."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from skygain.datasets.sample import SAMPLE

from .processes import ended, small_disk, started, wait_for_lines

pytest.importorskip("torch")

BEGUN = """
import sys
from skygain.app import commands
from skygain.app.signals import stopping, Terminated
from skygain.ground.errors import InputError
from skygain.training import train_predictor
from skygain.training.policies.recipes import train_policy
from skygain.training.run import stop_runs
try:
    with stopping(stop_runs, commands.STOPPING):
        {}
except InputError as error:
    sys.exit(f"error: {{error}}")
except Terminated as end:
    sys.exit(128 + end.number)
"""
TRAIN = {
    "unet": BEGUN.format(
        "train_predictor('unet', sys.argv[1], sys.argv[2], finish=8, batch_size=2, workers=1,"
        " validation_samples=32, checkpoint_seconds=0.0, validate_steps=2, bf16=False)"
    ),
    "dqn-rewards-only": BEGUN.format(
        "train_policy('dqn-rewards-only', sys.argv[1], sys.argv[2], total_steps=60, side=32,"
        " predictor='idw', split='T1', steps=8, lanes=2, n_uavs=2, warmup=24, capacity=80,"
        " batch_size=8, learn_every=2, checkpoint_steps=5, log_steps=5, bf16=False)"
    ),
}


def training(folder: Path, recipe: str = "unet") -> subprocess.Popen[str]:
    command = [sys.executable, "-c", TRAIN[recipe], str(SAMPLE), str(folder)]
    return started(command)


@pytest.fixture(scope="module", params=list(TRAIN))
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The weights of a training left alone."""
    folder = tmp_path_factory.mktemp("whole")
    code, _, err = ended(training(folder, request.param))
    assert code == 0, err
    return folder / f"{request.param}.safetensors"


def weights(path: Path) -> dict[str, bytes]:
    """Every array of a weight file; its card tells the time taken, which is not the same."""
    from safetensors.numpy import load_file

    return {key: value.tobytes() for key, value in load_file(path).items()}


def test_ended_it_goes_on_to_the_same_weights(tmp_path: Path, whole: Path) -> None:
    number = signal.SIGTERM
    child = training(tmp_path, whole.stem)
    wait_for_lines(tmp_path / "log.jsonl", 2, child)
    child.send_signal(number)
    code, _, err = ended(child)
    assert code in (0, -number, 128 + number)
    if code == 128 + number:
        assert "finished and saved" in err
        assert "Traceback" not in err
    code, _, err = ended(training(tmp_path, whole.stem))
    assert code == 0, err
    assert weights(tmp_path / whole.name) == weights(whole)


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 200) as disk:
        code, _, err = ended(training(disk.path))
        assert code == 1
        assert "No space left" in err
        assert "Traceback" not in err
