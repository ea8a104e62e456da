"""A long command says what it does: in a pipe by lines, with the time left."""

from __future__ import annotations

import pytest

from skygain.app import progress
from skygain.app.progress import SILENT, shown_progress


def test_a_pipe_hears_phases_and_what_is_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_FIRST_S", 0.01)
    monkeypatch.setattr(progress, "_MOST_S", 0.01)
    heard = ""
    with shown_progress("survey") as told:
        told.phase("flying")
        told(5, 20, "RMSE 9.1 dB")
        while "5/20" not in heard:
            heard += capsys.readouterr().err
    assert "survey: flying 5/20" in heard
    assert "left, RMSE 9.1 dB" in heard


def test_what_takes_no_second_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with shown_progress("survey") as told:
        told.phase("flying")
        told(20, 20)
    SILENT.phase("flying")
    SILENT(1, 2)
    assert capsys.readouterr().err == ""
