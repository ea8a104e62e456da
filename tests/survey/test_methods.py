"""Methods by name: options are checked before anything is built, one's own classes can be named."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path

import pytest

from skygain.ground.errors import InputError
from skygain.planners import PLANNERS
from skygain.predictors import PREDICTORS
from skygain.survey.methods import MethodSpec, options_of, planner, predictor

OWN = """
from dataclasses import dataclass
from skygain.predictors.interpolators.knn import KnnPredictor

@dataclass(frozen=True)
class Mine(KnnPredictor):
    k: int = 2
    \"\"\"how many\"\"\"

def other():
    return object()
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("knn:k=2.5", "k of predictor 'knn' must be a whole number, got 2.5"),
        ("knn:k=true", "k of predictor 'knn' must be a whole number, got True"),
        ("knn:n=3", "no option 'n'; known: k"),
        ("knn:k", "name:key=value"),
        ("kriging:parameters=x", "give a file written by `skygain train kriging`"),
        ("kriging-blind:trend=quadratic", "no option 'trend'; known: parameters"),
        ("kriging:refit=3", "must be true or false"),
        ("kriging-blind:refit=maybe", "must be true or false"),
        ("nowhere.at.all:Predictor", "package.module:Class"),
        ("skygain.predictors:Nothing", "package.module:Class"),
        ("krigin", "did you mean 'kriging'"),
    ],
)
def test_bad_methods_are_one_line_that_names_what_is_allowed(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        predictor(text)
    assert "\n" not in str(caught.value)


def test_options_reach_the_factory() -> None:
    assert predictor("knn:k=7").k == 7
    assert predictor("knn", k=7).k == 7
    assert planner("lookahead:horizon=12:paths=90").paths == 90
    with_it, without = MethodSpec("knn+tx", "spiral"), MethodSpec("knn", "spiral")
    assert with_it.build_predictor() is without.build_predictor()


@pytest.mark.parametrize("registry", [PREDICTORS, PLANNERS])
def test_every_default_is_of_a_kind_that_the_option_takes(registry) -> None:  # type: ignore[no-untyped-def]
    for name in registry.names():
        try:
            factory = registry.factory(name)
        except ImportError:  # an extra that is not installed
            continue
        for option in options_of(factory):
            assert option.takes(option.default), (name, option)


def test_ones_own_class_flies_by_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_methods.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    assert predictor("own_methods:Mine").k == 2
    assert predictor("own_methods:Mine:k=4").k == 4
    with pytest.raises(InputError, match="not a predictor"):
        predictor("own_methods:other")


def test_entry_points_bring_names(monkeypatch: pytest.MonkeyPatch) -> None:
    brought = importlib.metadata.EntryPoint(
        "nearest", "skygain.predictors.interpolators.knn:KnnPredictor", "skygain.predictors"
    )
    monkeypatch.setattr(
        importlib.metadata,
        "entry_points",
        lambda group: [brought] if group == "skygain.predictors" else [],
    )
    assert "nearest" in PREDICTORS.names()
    assert predictor("nearest:k=3").k == 3
    PREDICTORS._factories.pop("nearest")
