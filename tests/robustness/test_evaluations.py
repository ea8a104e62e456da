"""A comparison that is killed, or that fills the disk, goes on to the same table."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from .processes import ended, skygain, small_disk, wait_for_lines

ASKED = (
    "evaluate", "--methods", "idw / lawnmower,knn / random-waypoint,kriging-blind / lawnmower",
    "--max-surveys", "2", "--steps", "25", "--workers", "1",
)  # fmt: skip


def result(folder: Path) -> object:
    """What has to be the same after any death: the scores."""
    return {
        (line["case"], line["method"]): line["scores"]
        for line in map(json.loads, (folder / "rollouts.jsonl").read_text().splitlines()[1:])
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> object:
    folder = tmp_path_factory.mktemp("whole")
    code, _, err = ended(skygain(*ASKED, "--out", folder))
    assert code == 0, err
    return result(folder)


def test_ended_it_goes_on_to_the_same_table(tmp_path: Path, whole: object) -> None:
    number = signal.SIGTERM
    child = skygain(*ASKED, "--out", tmp_path)
    wait_for_lines(tmp_path / "rollouts.jsonl", 1 + 3, child)
    child.send_signal(number)
    code, _, err = ended(child)
    assert code in (0, -number, 128 + number)
    if code == 128 + number:
        assert "the same command goes on" in err
        assert "Traceback" not in err
    kept = (tmp_path / "rollouts.jsonl").read_bytes()
    code, _, err = ended(skygain(*ASKED, "--out", tmp_path))
    assert code == 0, err
    assert result(tmp_path) == whole
    complete = kept[: kept.rfind(b"\n") + 1]
    assert (tmp_path / "rollouts.jsonl").read_bytes().startswith(complete)


def test_a_full_disk_keeps_what_is_flown(tmp_path: Path, whole: object) -> None:
    with small_disk(tmp_path / "disk", 8) as disk:
        code, _, err = ended(skygain(*ASKED, "--out", disk.path))
        assert code == 2, err
        assert "No space left" in err
        assert "the same command goes on" in err
        assert "Traceback" not in err
        disk.enlarge()
        code, _, err = ended(skygain(*ASKED, "--out", disk.path))
        assert code == 0, err
        assert result(disk.path) == whole
