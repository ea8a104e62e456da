"""`skygain methods` says what a method is, and how good it was."""

from __future__ import annotations

import pytest

from skygain.app.explain import run_methods
from skygain.app.requests import MethodsRequest
from skygain.ground.errors import InputError


@pytest.mark.parametrize("name", ["operator", "sequential-greedy", "mcts"])
def test_a_method_tells_its_score_and_on_what_data(name: str) -> None:
    told = run_methods(MethodsRequest(name=name))
    assert name in told.splitlines()[0]
    scores = [line for line in told.splitlines() if " dB [" in line]
    assert scores
    assert all(name in line for line in scores)
    assert all("data set version" in line or ".zarr.zip" in line for line in scores)
    numbers = [float(line.split(" dB [")[0].split()[-1]) for line in scores]
    assert numbers == sorted(numbers)


def test_a_method_without_a_record_says_nothing_of_scores() -> None:
    assert " dB [" not in run_methods(MethodsRequest(name="thin-plate"))


def test_a_name_that_is_none_gets_a_near_one() -> None:
    with pytest.raises(InputError, match="lookahead"):
        run_methods(MethodsRequest(name="lookahed"))
