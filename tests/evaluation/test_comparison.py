"""A comparison is paired, reproducible, survives being killed, and does not mix with another
one."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import skygain
from skygain.app.compare import run_comparison
from skygain.datasets.layout import CityRecord
from skygain.datasets.sample import SAMPLE, open_sample
from skygain.datasets.store import ChannelDataset
from skygain.datasets.writer import write_dataset
from skygain.evaluation.comparison import compare
from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.tables import comparison_json, comparison_markdown
from skygain.ground.errors import InputError
from skygain.ground.files import file_digest
from skygain.ground.journal import Journal
from skygain.networks.weights import write_weights
from skygain.survey.methods import MethodSpec, parse_spec
from skygain.survey.origins import method_files

REQUEST = EvaluateRequest(
    predictors=("idw", "knn"),
    planners=("random-waypoint", "lawnmower"),
    data="sample",
    steps=20,
    record_every=10,
    max_surveys=1,
    workers=1,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("comparison")
    run_comparison(replace(REQUEST, out=out, workers=1))
    return out


def test_outputs_are_complete(folder: Path) -> None:
    results = json.loads((folder / "results.json").read_text())
    assert results["table"] == (folder / "table.md").read_text()
    assert set(results["methods"]) == {m.label for m in REQUEST.pairs}
    assert (folder / "rmse_vs_steps.png").read_bytes()[:4] == b"\x89PNG"
    assert len((folder / "rollouts.jsonl").read_text().splitlines()) == 1 + 4


def test_a_killed_run_goes_on_and_ends_in_the_same_table(folder: Path, tmp_path: Path) -> None:
    lines = (folder / "rollouts.jsonl").read_text().splitlines(keepends=True)
    cut = lines[1][: len(lines[1]) // 2]
    (tmp_path / "rollouts.jsonl").write_text(lines[0] + lines[2] + cut)
    flown: list[str] = []
    resumed = compare(
        replace(REQUEST, out=tmp_path, workers=2),
        progress=lambda done, total, label: flown.append(label),
    )
    assert len(flown) == 3
    whole = compare(replace(REQUEST, out=folder))
    for label, named in whole.scores.items():
        for name, values in named.items():
            assert np.array_equal(values, resumed.scores[label][name], equal_nan=True)


def test_planners_of_one_case_start_alike(folder: Path) -> None:
    """Two predictors flown by the random planner measure the same cells, so both see as many
    readings."""
    lines = [json.loads(line) for line in (folder / "rollouts.jsonl").read_text().splitlines()[1:]]
    measured = {line["method"]: line["measured"] for line in lines}
    assert measured["idw / random-waypoint"] == measured["knn / random-waypoint"]


def test_another_comparison_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match=r"steps changed; to begin anew, delete .*rollouts\.jsonl"):
        compare(replace(REQUEST, steps=30, out=folder))


def _written(path: Path, like: ChannelDataset, records: list[CityRecord]) -> None:
    write_dataset(
        path,
        records,
        grid=like.grid,
        altitudes_m=like.altitudes_m,
        attributes=like.attributes,
    )


def test_a_data_set_replaced_at_its_path_is_told(tmp_path: Path) -> None:
    """The content counts, not the name: the same file elsewhere goes on."""
    data, elsewhere = tmp_path / "cities.zarr.zip", tmp_path / "moved.zarr.zip"
    dataset = open_sample()
    records = [dataset.record(i) for i in range(dataset.n_cities)]
    _written(data, dataset, records)
    request = replace(
        REQUEST, methods=("idw / lawnmower",), predictors=(), planners=(), steps=3, out=tmp_path
    )
    before = compare(replace(request, data=str(data)))
    shutil.copy(data, elsewhere)
    records[-1] = replace(records[-1], gain_db=records[-1].gain_db - 3)
    _written(data, dataset, records)
    with pytest.raises(InputError, match="data changed"):
        compare(replace(request, data=str(data)))
    again = compare(replace(request, data=str(elsewhere)))
    assert again.scores.keys() == before.scores.keys()
    anew = compare(replace(request, data=str(data), out=tmp_path / "anew", max_surveys=None))
    assert len(anew.cities) > 1


def test_weights_trained_again_are_told(tmp_path: Path) -> None:
    weights = tmp_path / "mine.safetensors"
    card = {"policy": {}}
    write_weights(weights, {"w": np.zeros(2, np.float32)}, card)
    label = f"idw / imitation:weights={weights}"
    files = method_files(MethodSpec.of_label(label))
    assert set(files) == {"mine.safetensors"}
    journal = tmp_path / "rollouts.jsonl"
    request = replace(REQUEST, methods=(label,), predictors=(), planners=(), out=tmp_path)
    belongs_to = request.settings | {"data": file_digest(SAMPLE), "skygain": skygain.__version__}
    with Journal(journal, belongs_to) as kept:
        scores = {"rmse_db": [1.0] * len(request.record_steps)}
        record = {"case": 0, "city": 0, "method": label, "scores": scores, "delays": {"d": 1.0}}
        kept.append(record | {"files": files})
    write_weights(weights, {"w": np.ones(2, np.float32)}, card)
    with pytest.raises(InputError, match=r"mine\.safetensors changed"):
        compare(request)


def test_a_line_that_is_no_rollout_is_told(folder: Path, tmp_path: Path) -> None:
    header = (folder / "rollouts.jsonl").read_text().splitlines(keepends=True)[0]
    for line in ('{"case": 1}', "[]", "{", '{"case": 1, "method": "a", "scores": 3}'):
        (tmp_path / "rollouts.jsonl").write_text(f"{header}{line}\n")
        with pytest.raises(InputError, match="line 2"):
            compare(replace(REQUEST, out=tmp_path))


def test_table_says_difference_zero_for_a_method_against_itself(folder: Path) -> None:
    same = replace(REQUEST, predictors=("idw",), planners=("lawnmower",), out=folder)
    comparison = compare(same)
    doubled = replace(comparison, request=same)
    doubled.scores["copy / lawnmower"] = comparison.scores["idw / lawnmower"]
    doubled.delays["copy / lawnmower"] = comparison.delays["idw / lawnmower"]
    assert "| copy / lawnmower | +0.00 [–]" in comparison_markdown(doubled)
    assert comparison_json(doubled)["paired"][0]["rmse_db"][-1]["mean"] == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"predictors": ("krigging",)}, "did you mean 'kriging'"),
        ({"planners": ("lawnmower:lane=2:nonsense",)}, "name:key=value"),
        ({"planners": ("lawnmower:nonsense=2",)}, "no option 'nonsense'"),
        ({"data": "/nowhere/x.zarr.zip"}, "x.zarr.zip"),
        ({"split": "T9"}, "T9"),
        ({"altitude_m": 12.5}, "12.5"),
    ],
)
def test_bad_requests_are_one_clear_line(change: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        compare(replace(REQUEST, **change, out=tmp_path))


@pytest.mark.parametrize(
    "change",
    [{"steps": 0}, {"record_every": 0}, {"max_surveys": 0}, {"noise_db": -1.0}, {"workers": 0}],
)
def test_impossible_configurations_are_refused(change: dict) -> None:
    with pytest.raises(InputError):
        replace(REQUEST, **change)


def test_the_transmitter_is_told_only_on_request() -> None:
    assert parse_spec("a:x=1:y=two") == ("a", {"x": 1, "y": "two"})
    assert (
        MethodSpec("knn+tx", "lawnmower").build_predictor()
        is MethodSpec("knn", "lawnmower").build_predictor()
    )


def test_whole_maps_and_other_windows(tmp_path: Path) -> None:
    """The size of the surveyed window is part of what is compared."""
    small = compare(replace(REQUEST, crop=60, steps=5, out=tmp_path / "small"))
    whole = compare(replace(REQUEST, crop=0, steps=5, out=tmp_path / "whole"))
    assert "windows of 60 × 60 cells" in comparison_markdown(small)
    assert "whole maps" in comparison_markdown(whole)
    assert small.request.settings != whole.request.settings
    label = whole.request.pairs[0].label
    assert small.scores[label]["rmse_db"][0, -1] != whole.scores[label]["rmse_db"][0, -1]
    with pytest.raises(InputError, match="0 for whole maps"):
        replace(REQUEST, crop=-1)


def test_methods_can_be_paired_one_by_one(folder: Path) -> None:
    request = replace(
        REQUEST,
        predictors=("idw",),
        planners=("lawnmower",),
        methods=("knn / random-waypoint", "idw / lawnmower"),
    )
    assert [m.label for m in request.pairs] == ["idw / lawnmower", "knn / random-waypoint"]
    table = comparison_markdown(
        compare(replace(request, out=folder))
    )  # flown already: the product and the pairs share one journal
    assert "| knn / random-waypoint |" in table
    assert "Flight saved" not in table
    assert len(replace(request, predictors=(), planners=()).pairs) == 2
    with pytest.raises(InputError, match="predictor / planner"):
        replace(request, methods=("knn lawnmower",))
