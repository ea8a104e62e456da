"""A training that is killed or told to end goes on to the very weights of one left alone."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

from skygain.datasets.sample import SAMPLE

from .processes import SIGNALS, TRIALS, ended, small_disk, wait_for_lines

pytest.importorskip("torch")

TRAIN = """
import sys
from skygain.app import commands
from skygain.app.signals import stopping, Terminated
from skygain.ground.errors import InputError
from skygain.training import train_predictor
from skygain.training.run import stop_runs
try:
    with stopping(stop_runs, commands.STOPPING):
        train_predictor(
            "unet", sys.argv[1], sys.argv[2], finish=8, batch_size=2, validation_samples=32,
            checkpoint_seconds=0.0, validate_steps=2, workers=1, bf16=False,
        )
except InputError as error:
    sys.exit(f"error: {error}")
except Terminated as end:
    sys.exit(128 + end.number)
"""


def training(folder: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", TRAIN, str(SAMPLE), str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    code, _, err = ended(training(folder))
    assert code == 0, err
    return (folder / "unet.safetensors").read_bytes()


def weights(path: Path) -> dict[str, bytes]:
    """Every array of a weight file; its card tells the time taken, which is not the same."""
    from safetensors.numpy import load_file

    return {key: value.tobytes() for key, value in load_file(path).items()}


@pytest.mark.parametrize("trial", range(max(1, TRIALS // 4)))
def test_killed_anywhere_it_goes_on_to_the_same_weights(
    tmp_path: Path, whole: bytes, trial: int
) -> None:
    (tmp_path / "whole.safetensors").write_bytes(whole)
    number = SIGNALS[(trial + 1) % len(SIGNALS)]
    child = training(tmp_path)
    wait_for_lines(tmp_path / "log.jsonl", random.Random(trial).randint(1, 3), child)
    child.send_signal(number)
    code, _, err = ended(child)
    assert code in (0, -number, 128 + number)
    if code == 128 + number:
        assert "finished and saved" in err
        assert "Traceback" not in err
    code, _, err = ended(training(tmp_path))
    assert code == 0, err
    assert weights(tmp_path / "unet.safetensors") == weights(tmp_path / "whole.safetensors")


def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 200) as disk:
        code, _, err = ended(training(disk.path))
        assert code == 1
        assert "No space left" in err
        assert "Traceback" not in err
