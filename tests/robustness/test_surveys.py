"""Kills, signals, full disks and strangers' files: nothing measured is lost.

Many more kills: test_kills.py.
"""

from __future__ import annotations

import json
import random
import signal
import time
from pathlib import Path

import pytest

from .processes import SIGNALS, TRIALS, ended, skygain, small_disk, wait_for_lines

ASKED = (
    "survey", "--city", "sample:9", "--predictor", "kriging-blind", "--planner",
    "random-waypoint", "--steps", "60", "--noise-db", "2",
)  # fmt: skip


def result(folder: Path) -> tuple[bytes, object]:
    """What has to be the same after any death: the readings, and the scores."""
    found = json.loads((folder / "results.json").read_text())
    return (folder / "measurements.csv").read_bytes(), found["scores"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, object]:
    folder = tmp_path_factory.mktemp("whole") / "survey"
    code, _, err = ended(skygain(*ASKED, "--out", folder))
    assert code == 0, err
    assert not (folder / "flight.jsonl").exists()
    return result(folder)


@pytest.mark.parametrize("trial", range(2))
def test_killed_anywhere_it_goes_on_to_the_same_end(
    tmp_path: Path, whole: tuple[bytes, object], trial: int
) -> None:
    rng = random.Random(trial)
    folder = tmp_path / "survey"
    number = SIGNALS[trial % len(SIGNALS)]
    child = skygain(*ASKED, "--out", folder)
    wait_for_lines(folder / "flight.jsonl", rng.randint(1, 62), child)
    child.send_signal(number)
    code, _, err = ended(child)
    assert code in (0, -number, 128 + number)
    if code == 128 + number:
        assert f"skygain survey --resume {folder}" in err
        assert "Traceback" not in err
    if code:
        code, _, err = ended(skygain("survey", "--resume", folder))
        assert code == 0, err
    assert result(folder) == whole
    assert not [p for p in folder.iterdir() if p.name.startswith((".", "flight"))]


def test_an_interrupt_is_answered_writes_what_was_learnt_and_can_go_on(
    tmp_path: Path, whole: tuple[bytes, object]
) -> None:
    folder = tmp_path / "survey"
    child = skygain(*ASKED, "--out", folder)
    wait_for_lines(folder / "flight.jsonl", 10, child)
    child.send_signal(signal.SIGINT)
    code, _, err = ended(child)
    assert code == 0, err
    assert "stopping: the step under way is finished" in err
    assert "interrupted" in (folder / "results.json").read_text()
    assert ended(skygain("survey", "--resume", folder))[0] == 0
    assert result(folder) == whole


def test_an_interrupt_of_compiled_code_before_the_flight_is_answered(tmp_path: Path) -> None:
    folder = tmp_path / "survey"
    child = skygain("survey", "--city", "9", "--spacing", "2", "--crop", "0", "--out", folder)
    assert child.stderr is not None
    for line in child.stderr:
        if "computing the truth" in line:
            break
    sent = time.monotonic()
    child.send_signal(signal.SIGINT)
    for line in child.stderr:
        if "nothing was measured yet" in line:
            break
    assert time.monotonic() - sent < 2  # a second, and one for a busy machine
    assert ended(child)[0] == 130
    assert not (folder / "flight.jsonl").exists()


def test_a_folder_has_one_survey_at_a_time(tmp_path: Path) -> None:
    folder = tmp_path / "survey"
    first = skygain(*ASKED, "--out", folder)
    wait_for_lines(folder / "flight.jsonl", 2, first)
    code, _, err = ended(skygain(*ASKED, "--out", folder, "--overwrite"))
    assert (code, "in use by another run" in err) == (2, True), err
    assert ended(first)[0] == 0


@pytest.mark.parametrize("name", ["measurements.csv", "report.html"])
def test_a_strangers_file_stays(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    code, _, err = ended(skygain(*ASKED, "--out", tmp_path))
    assert code == 2
    assert "--overwrite" in err
    assert (tmp_path / name).read_text() == "mine"


def test_a_survey_cut_off_is_not_begun_anew_unasked(tmp_path: Path) -> None:
    folder = tmp_path / "survey"
    child = skygain(*ASKED, "--out", folder)
    wait_for_lines(folder / "flight.jsonl", 5, child)
    child.kill()
    ended(child)
    code, _, err = ended(skygain(*ASKED, "--out", folder))
    assert code == 2
    assert f"--resume {folder}" in err


def test_nothing_to_resume_is_told(tmp_path: Path) -> None:
    code, _, err = ended(skygain("survey", "--resume", tmp_path))
    assert code == 2
    assert "no journal" in err


@pytest.mark.parametrize("blocks", [24, 300] if TRIALS > 1 else [24])
def test_a_full_disk_keeps_the_flight(
    tmp_path: Path, whole: tuple[bytes, object], blocks: int
) -> None:
    with small_disk(tmp_path / "disk", blocks) as disk:
        code, _, err = ended(skygain(*ASKED, "--out", disk.path / "survey"))
        assert code == 2, err
        assert "No space left" in err
        assert "Traceback" not in err
        disk.enlarge()
        code, _, err = ended(skygain("survey", "--resume", disk.path / "survey"))
        assert code == 0, err
        assert result(disk.path / "survey") == whole
