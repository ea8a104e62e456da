"""A request is declared once: Python, files and the command line make the same object."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import click.testing
import numpy as np
import pytest

import skygain as sg
from skygain.app.chart import run_map
from skygain.app.cli import command_line, for_command_line
from skygain.app.config import read_config
from skygain.app.fly import fly, run_survey
from skygain.app.requests import COMMANDS, MapRequest, SurveyRequest, TrainPredictorRequest
from skygain.ground.declared import Request, named, part
from skygain.ground.errors import InputError
from skygain.survey.requests import CityRequest

QUICK = SurveyRequest(predictor="idw", planner="random-waypoint", steps=10, crop=40)
SAMPLE = SurveyRequest(city="sample:2")


@dataclass(frozen=True, kw_only=True)
class Colours(Request):
    """Colours

    Of things.
    """

    red: int = 3
    """how red"""
    blue_hz: float = named(2e9, flag="blue-ghz", scale=1e9)
    """how blue"""


@dataclass(frozen=True, kw_only=True)
class Paint(Colours):
    """Paint it."""

    where: Path
    """what to paint"""
    shiny: bool = False
    """polish it"""


def test_fields_are_told_group_by_group_with_their_docstrings() -> None:
    told = [(one.name, one.flag, one.group, one.text) for one in Paint.asked()]
    assert told == [
        ("red", "red", "Colours", "how red"),
        ("blue_hz", "blue-ghz", "Colours", "how blue"),
        ("where", "where", "", "what to paint"),
        ("shiny", "shiny", "", "polish it"),
    ]
    assert part(Paint(where="wall", red=4), Colours) == {"red": 4, "blue_hz": 2e9}


@pytest.mark.parametrize("request_type", COMMANDS.values())
def test_every_option_of_every_command_says_what_it_means(request_type: type[Request]) -> None:
    assert all(one.text for one in request_type.asked())
    assert request_type.__doc__
    flags = [one.flag for one in request_type.asked()]
    assert len(set(flags)) == len(flags)


@pytest.mark.parametrize("words", COMMANDS)
def test_the_help_of_every_command_names_every_option(words: str) -> None:
    shown = click.testing.CliRunner().invoke(command_line(), [*words.split(), "--help"])
    assert shown.exit_code == 0
    for one in COMMANDS[words].asked():
        assert (one.name.upper() if one.argument else f"--{one.flag}") in shown.output


def test_texts_and_values_make_the_same_request() -> None:
    typed = SurveyRequest(
        uavs="5",
        altitude_m="20",
        box="1,2,3,4",
        where='PCI=A,name="a, b"',
        return_to_start="true",
        transmitter=(120, 80),
    )
    given = SurveyRequest(
        uavs=5,
        altitude_m=20.0,
        box=(1.0, 2.0, 3.0, 4.0),
        where={"PCI": "A", "name": "a, b"},
        return_to_start=True,
        transmitter="120,80",
    )
    assert typed == given


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"uavs": "three"}, "`uavs` must be a whole number, got 'three'"),
        ({"uavs": 2.5}, "`uavs` must be a whole number"),
        ({"uavs": None}, "`uavs` must be a whole number"),
        ({"box": "1,2,3"}, "`box` must be 4 numbers"),
        ({"where": "PCI"}, "`where` must be name=value"),
        ({"return_to_start": "maybe"}, "`return_to_start` must be true or false"),
        ({"uav": 3}, "did you mean 'uavs'"),
        ({"crop": 1}, "`crop` must be 2 cells"),
        ({"crop": -1}, "`crop` must be 2 cells"),
        ({"frequency_hz": 0}, "`frequency_hz` must be above 0"),
        ({"min_distance_m": -1}, "`min_distance_m` must be 0 m or more"),
    ],
)
def test_what_cannot_be_used_is_named_by_its_parameter(values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SurveyRequest.of(values)


def test_what_is_missing_is_named() -> None:
    with pytest.raises(InputError, match="`data` is missing"):
        TrainPredictorRequest.of({"recipe": "operator"})


def test_errors_name_parameters_in_python_and_options_on_the_command_line() -> None:
    with pytest.raises(InputError) as caught:
        SurveyRequest(uavs=0)
    assert "`uavs=1`" in str(caught.value)
    assert "--uavs 1 or more" in for_command_line(str(caught.value), SurveyRequest)
    assert for_command_line("`frequency_hz` and `nothing`", SurveyRequest) == (
        "--frequency-ghz and nothing"
    )


def test_options_override_a_file_and_groups_only_order_it(tmp_path: Path) -> None:
    path = tmp_path / "survey.toml"
    path.write_text(
        'seed = 4\n[swarm]\nuavs = 5\nmin-distance-m = 8\n[recording.where]\nPCI = "A"\n'
    )
    values = read_config(SurveyRequest, path)
    assert values == {"seed": 4, "uavs": 5, "min_distance_m": 8, "where": {"PCI": "A"}}
    path.write_text("uavs = ")
    with pytest.raises(InputError, match=r"survey\.toml"):
        read_config(SurveyRequest, path)
    with pytest.raises(InputError, match="cannot read"):
        read_config(SurveyRequest, tmp_path / "absent.json")


def test_results_can_be_flown_again(tmp_path: Path) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    run_survey(replace(QUICK, out=first, seed=3))
    run = [sys.executable, "-m", "skygain", "survey", "--out", str(again)]
    subprocess.run([*run, "--config", str(first / "results.json")], check=True, timeout=300)
    for name in ("measurements.csv", "radio_map.nc"):
        assert (first / name).read_bytes() == (again / name).read_bytes()
    stored = json.loads((again / "results.json").read_text())["config"]
    assert SurveyRequest.of(read_config(SurveyRequest, again / "results.json")) == replace(
        QUICK, seed=3
    )
    assert "out" not in stored


def test_a_survey_of_no_steps_measures_the_start(tmp_path: Path) -> None:
    told = run_survey(replace(QUICK, steps=0, out=tmp_path / "none"))
    assert "0 steps, 3 readings" in told
    assert "nan" not in told


def test_a_window_of_96_cells_is_one_and_a_file_is_whole(tmp_path: Path) -> None:
    """96 typed by hand is no default: it crops a file too."""
    pytest.importorskip("geopandas")
    path = tmp_path / "court.geojson"
    ring = [[[0.0, 0.0], [600.0, 0.0], [600.0, 600.0], [0.0, 600.0], [0.0, 0.0]]]
    hole = [[20.0, 20.0], [20.0, 580.0], [580.0, 580.0], [580.0, 20.0], [20.0, 20.0]]
    feature = {
        "type": "Feature",
        "properties": {"height": 20},
        "geometry": {"type": "Polygon", "coordinates": [*ring, hole]},
    }
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    place = sg.SurveyRequest(city=path, crs="EPSG:32617", propagation="gudmundson", spacing_m=4.0)
    whole = sg.open_world(place, rng=0).city.grid.shape
    assert min(whole) > 96
    assert sg.open_world(replace(place, crop=96), rng=0).city.grid.shape == (96, 96)
    assert sg.open_world(replace(place, crop=0), rng=0).city.grid.shape == whole


def test_open_world_takes_a_name_or_a_request() -> None:
    named_world = sg.open_world("sample:2", rng=5)
    asked = sg.open_world(SAMPLE, rng=5)
    assert named_world.transmitter_m == asked.transmitter_m
    assert np.array_equal(named_world.truth_db, asked.truth_db, equal_nan=True)
    assert named_world.scenario().grid.shape == (96, 96)
    with pytest.raises(InputError, match="leave `transmitter` out"):
        sg.open_world(sg.SurveyRequest(city="sample", transmitter="3,4"))
    with pytest.raises(InputError, match="`propagation=union`"):
        sg.open_world(sg.SurveyRequest(city="7", propagation="raytrace"))


def test_the_same_request_is_the_same_survey_and_shows_itself() -> None:
    one, two = fly(QUICK), fly(QUICK)
    assert one.result.measurements.gain_db.tolist() == two.result.measurements.gain_db.tolist()
    for shown in (one, one.result, one.posterior):
        assert len(repr(shown).splitlines()) <= 10
        assert shown._repr_html_().count("<img") == 1
    maps = one.result.to_xarray()
    assert np.array_equal(np.isnan(maps["mean_db"]), ~one.scenario.outdoor)
    assert np.allclose(one.to_xarray()["mean_db"], maps["mean_db"], atol=1e-3, equal_nan=True)


def test_city_options_have_the_names_of_read_city() -> None:
    from skygain.cities import CityOptions

    options = set(CityRequest.__annotations__) - {"city"}
    assert options <= set(CityOptions.__annotations__)


def test_every_name_of_the_face_is_there_and_loaded_late() -> None:
    assert all(getattr(sg, name) is not None for name in sg.__all__)
    code = "import sys, skygain; sys.exit('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == 0
    with pytest.raises(AttributeError, match="nonsense"):
        sg.nonsense  # noqa: B018


def test_help_loads_no_numpy() -> None:
    code = (
        "import sys\nfrom skygain.app.cli import command_line\n"
        "command_line().main(['survey', '--help'], standalone_mode=False)\n"
        "sys.exit('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode == 0


def test_readings_of_a_survey_can_be_flown_over_again(tmp_path: Path) -> None:
    """The recorded world: its file is read by the group that declares its options."""
    run_survey(replace(QUICK, out=tmp_path / "first"))
    recorded = tmp_path / "first" / "measurements.csv"
    again = fly(SurveyRequest(replay=recorded, predictor="idw", uavs=1, steps=5, start="spread"))
    assert "measurements.csv" in again.title
    known = json.loads((tmp_path / "first" / "results.json").read_text())["survey"]
    assert np.isfinite(again.outdoor_truth_db).sum() <= known["measured_cells"]


def test_unless_told_otherwise_the_best_method_flies_and_says_what_it_knew(tmp_path) -> None:
    told = run_survey(SurveyRequest(city="sample:9", steps=2, crop=40, out=tmp_path / "flown"))
    assert "told the buildings, not where the transmitter is" in told
    config = json.loads((tmp_path / "flown" / "results.json").read_text())["config"]
    assert (config["predictor"], config["planner"]) == ("operator", "sequential-greedy")


def test_a_recording_is_mapped_by_kriging_unless_told_otherwise() -> None:
    campaign = Path(__file__).parents[2] / "examples" / "data" / "campaign.csv"
    where = {"pci": "101"}
    outcome = fly(SurveyRequest(replay=campaign, where=where, uavs=1, steps=2))
    assert outcome.config["predictor"] == "kriging-blind"
    assert "neither buildings nor where the transmitter is" in outcome.told


def test_the_latest_survey_is_replaced_but_nothing_else(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_survey(QUICK)
    run_survey(replace(QUICK, seed=1))
    results = tmp_path / "surveys" / "latest" / "results.json"
    assert json.loads(results.read_text())["config"]["seed"] == 1
    results.write_text('{"mine": 1}')
    with pytest.raises(InputError, match="overwrite"):
        run_survey(QUICK)


def test_the_latest_map_is_replaced_but_nothing_else(tmp_path, monkeypatch) -> None:
    campaign = Path(__file__).parents[2] / "examples" / "data" / "campaign.csv"
    monkeypatch.chdir(tmp_path)
    request = MapRequest(readings=(campaign,), where={"pci": "101"}, validate=False, spacing_m=8.0)
    run_map(request)
    assert "readings in" in run_map(replace(request, threshold_db=-100.0))
    results = tmp_path / "maps" / "latest" / "results.json"
    results.write_text('{"mine": 1}')
    with pytest.raises(InputError, match="overwrite"):
        run_map(request)


def test_a_refused_request_leaves_nothing_to_go_on_with(tmp_path) -> None:
    with pytest.raises(InputError, match="no link 999"):
        run_survey(replace(QUICK, city="sample:999", out=tmp_path))
    assert not list(tmp_path.iterdir())
