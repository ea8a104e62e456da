"""The command line as a user meets it: real processes, exit codes, one-line errors, nothing
half-written."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from skygain.app.cli import command_line
from skygain.app.requests import COMMANDS

QUICK = ["--predictor", "idw", "--planner", "random-waypoint", "--steps", "10", "--crop", "40"]


def skygain(*args: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from skygain.app.cli import main; main()", *map(str, args)]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, timeout=300, check=False
    )


def only_line(stderr: str) -> str:
    """The one line beside those that tell how far a slow machine has come."""
    (line,) = (each for each in stderr.splitlines() if not each.startswith("survey: "))
    return line


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("survey") / "run"
    done = skygain("survey", *QUICK, "--out", out)
    assert done.returncode == 0, done.stderr
    return out


def test_a_survey_leaves_all_its_files(folder: Path) -> None:
    expected = {
        "results.json",
        "measurements.csv",
        "radio_map.tif",
        "radio_map.qml",
        "radio_map.nc",
        "survey_maps.png",
        "paths.png",
        "rmse_vs_steps.png",
        "report.html",
    }
    assert {p.name for p in folder.iterdir()} == expected


def test_results_hold_the_request_and_scores_over_steps(folder: Path) -> None:
    results = json.loads((folder / "results.json").read_text())
    assert results["config"]["predictor"] == "idw"
    assert results["scores_over_steps"]["step"] == [0, 5, 10]
    assert {"rmse_db", "gof", "nll", "crps_db", "coverage90"} <= set(results["scores_over_steps"])


def test_results_are_not_overwritten_unasked(folder: Path) -> None:
    before = (folder / "results.json").read_bytes()
    refused = skygain("survey", *QUICK, "--out", folder)
    assert refused.returncode == 2
    assert "--overwrite" in refused.stderr
    assert (folder / "results.json").read_bytes() == before


def test_same_seed_same_measurements(folder: Path, tmp_path: Path) -> None:
    assert skygain("survey", *QUICK, "--out", tmp_path).returncode == 0
    assert (tmp_path / "measurements.csv").read_bytes() == (
        folder / "measurements.csv"
    ).read_bytes()


def box_city(path: Path, height: float = 0.0) -> Path:
    """A footprints file: one building that covers everything, or a courtyard of open ground."""
    square = [[0.0, 0.0], [200.0, 0.0], [200.0, 200.0], [0.0, 200.0], [0.0, 0.0]]
    feature = {
        "type": "Feature",
        "properties": {"height": height},
        "geometry": {"type": "Polygon", "coordinates": [square]},
    }
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--predictor", "krigin"], "did you mean 'kriging'"),
        (["--planner", "lawnmover"], "did you mean 'lawnmower'"),
        (["--uavs", "0"], "at least one UAV"),
        (["--uavs", "99999"], "fewer"),
        (["--steps", "-1"], "0 or more"),
        (["--noise-db", "-3"], "0 dB or more"),
        (["--noise-db", "nan"], "0 dB or more"),
        (["--stop-std", "-1"], "above 0"),
        (["--start", "ring"], "unknown --start"),
        (["--city", "atlantis"], "atlantis"),
        (["--city", "missing.tif"], "missing.tif"),
        (["--city", "missing.zarr.zip"], "missing.zarr.zip"),
        (["--city", "sample:999"], "no link 999"),
        (["--altitude", "-5"], "altitude"),
        (["--city", "7", "--transmitter", "somewhere"], "x,y"),
        (["--city", "7", "--transmitter", "nan,3"], "x,y"),
        (["--city", "7", "--propagation", "magic"], "unknown propagation"),
        (["--replay", "missing.csv"], "missing.csv"),
    ],
)
def test_bad_requests_end_in_one_line_and_code_2(
    args: list[str], message: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = skygain("survey", *QUICK, *args, "--out", out, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    line = only_line(done.stderr)
    assert line.startswith("error: ")
    assert message in line
    assert not out.exists() or not any(out.iterdir())


def test_a_transmitter_indoors_is_refused(tmp_path: Path) -> None:
    from skygain.cities import open_city

    city = open_city("7")
    cell = np.argwhere(city.height_m > 5)[0]
    x, y = city.grid.xy_m(cell)
    done = skygain(
        "survey",
        *QUICK,
        "--city",
        "7",
        "--propagation",
        "over-rooftop",
        "--transmitter",
        f"{x},{y}",
        "--out",
        tmp_path,
    )
    assert done.returncode == 2
    assert "inside a building" in done.stderr


@pytest.mark.skipif(
    os.geteuid() == 0 and not Path("/proc/self").exists(),
    reason="needs a place nobody can write to",
)
def test_an_unwritable_folder_is_refused_before_the_flight() -> None:
    done = skygain("survey", *QUICK, "--out", "/proc/self/nothing")
    assert done.returncode == 2
    assert "cannot write" in done.stderr


def test_a_city_without_a_free_cell_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("geopandas")
    path = box_city(tmp_path / "full.geojson", 50.0)
    done = skygain(
        "survey",
        *QUICK,
        "--city",
        path,
        "--crs",
        "EPSG:32617",
        "--propagation",
        "over-rooftop",
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 2
    assert only_line(done.stderr).startswith("error: ")


def test_evaluate_prints_the_table_last(tmp_path: Path) -> None:
    done = skygain(
        "evaluate",
        "--predictors",
        "idw",
        "--planners",
        "random-waypoint",
        "--steps",
        "10",
        "--max-surveys",
        "1",
        "--workers",
        "1",
        "--out",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith((tmp_path / "table.md").read_text() + "\n")


def test_methods_lists_every_name() -> None:
    shown = skygain("methods").stdout
    for name in (
        "kriging",
        "idw",
        "knn",
        "random-waypoint",
        "lawnmower",
        "greedy-variance",
        "union",
    ):
        assert name in shown


def test_doctor_never_crashes() -> None:
    done = skygain("doctor")
    assert done.returncode in (0, 1)
    assert "Python" in done.stdout


def test_an_option_of_several_files_takes_them_after_one_another(tmp_path: Path) -> None:
    """`--cities a b` is what people type."""
    np.savez(tmp_path / "a.npz", gain_db=np.full((30, 30), -90.0), spacing_m=4.0)
    made = tmp_path / "made.zarr.zip"
    words = ["dataset", "import", str(tmp_path / "a.npz"), "--out", str(made), "--splits", "T1"]
    found = CliRunner().invoke(command_line(), words)
    assert found.exit_code == 0, found.exception
    assert "T1          1      1" in found.stdout
    words = ["dataset", "build", "--cities", "7", "8", "--side", "500", "--out", str(made)]
    found = CliRunner().invoke(command_line(), words)
    assert str(found.exception).startswith("--side 500 is more than the smallest city has")


def test_help_names_options_as_they_are_typed() -> None:
    for words, request in COMMANDS.items():
        done = CliRunner().invoke(command_line(), [*words.split(), "--help"])
        assert done.exit_code == 0
        options = done.output.partition("Examples:")[0]
        assert "`" not in options, words
        for one in request.asked():
            # an import speaks of the variables in a file by such names
            if "_" in one.name and words != "dataset import":
                assert not re.search(rf"\b{one.name}\b", options), f"{words}: {one.name}"
