"""Pictures are drawn for every kind of survey and leave the caller's matplotlib alone."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.reports.curves import rmse_curves, rmse_picture
from skygain.reports.outcome import Outcome
from skygain.reports.pictures import paths_picture, survey_maps

Make = Callable[..., Outcome]


def size_of(path: Path) -> tuple[int, int]:
    """Width and height from the PNG's header."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])


@pytest.mark.parametrize(
    ("truth", "crs"), [("full", None), ("partial", "EPSG:32617"), (None, None)]
)
def test_every_kind_of_survey_has_its_pictures(
    make_outcome: Make, tmp_path: Path, truth: str | None, crs: str | None
) -> None:
    outcome = make_outcome(truth=truth, crs=crs, title="$broken^{maths & a very long name " * 9)
    for draw in (survey_maps, paths_picture, rmse_picture):
        draw(outcome, tmp_path / "picture.png")
        assert min(size_of(tmp_path / "picture.png")) > 400
    assert [path.name for path in tmp_path.iterdir()] == ["picture.png"]


def test_a_survey_without_frames_or_readings_still_has_pictures(
    make_outcome: Make, tmp_path: Path
) -> None:
    flown = make_outcome(truth=None)
    outcome = replace(
        flown, frames=(), result=replace(flown.result, measurements=Measurements.none())
    )
    for draw in (survey_maps, rmse_picture):
        draw(outcome, tmp_path / "picture.png")


def test_same_survey_same_picture(make_outcome: Make, tmp_path: Path) -> None:
    for name in ("first.png", "second.png"):
        rmse_picture(make_outcome(), tmp_path / name)
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def test_settings_of_the_caller_are_untouched(make_outcome: Make, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    rmse_picture(make_outcome(), tmp_path / "picture.png")
    assert dict(mpl.rcParams) == before


def test_matplotlib_is_loaded_only_to_draw() -> None:
    code = "import sys, skygain.reports.pictures; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_twelve_methods_fit_in_one_figure(tmp_path: Path) -> None:
    steps = np.arange(25, 201, 25)
    curves = {
        f"predictor-{k} / planner-with-a-long-name-{k}": (
            steps,
            9 + k - steps / 50,
            8 + k - steps / 50,
            steps,
        )
        for k in range(12)
    }
    curves["reached nothing"] = (steps, np.full(8, np.nan), np.full(8, np.nan), np.full(8, np.nan))
    rmse_curves(curves, tmp_path / "curves.png")
    assert min(size_of(tmp_path / "curves.png")) > 400


def test_curves_that_cannot_be_drawn_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one method"):
        rmse_curves({}, tmp_path / "curves.png")
    with pytest.raises(InputError, match="'a' needs steps, mean, low and high of one length"):
        rmse_curves({"a": ([1, 2], [1.0], [1.0], [1.0])}, tmp_path / "curves.png")
    assert not list(tmp_path.iterdir())
