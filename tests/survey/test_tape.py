"""A flight that was cut off anywhere goes on to the same end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.ground.journal import Journal
from skygain.instruments.simulated import NoiseConfig, NoisyInstrument
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.scenario import Scenario
from skygain.survey.loop import Survey, SurveyResult
from skygain.survey.tape import FlightTape

STEPS = 24


def fly(path: Path | None, planner: str = "random-waypoint") -> SurveyResult:
    """One noisy survey; the same every time, on tape if there is a path."""
    height = np.zeros((16, 16))
    height[5:9, 5:9] = 25.0
    scenario = Scenario(City(Grid((16, 16), 4.0), height))
    truth = -90 + np.cumsum(np.random.default_rng(4).normal(size=(16, 16)), axis=1)
    noise, flight = np.random.default_rng(1), np.random.default_rng(2)
    instrument = NoisyInstrument(truth, NoiseConfig(std_db=2.0, loss_probability=0.2), noise)
    survey = Survey(
        scenario, create_predictor("kriging-blind"), create_planner(planner), instrument
    )
    swarm = Swarm.deployed(scenario, [(0, 0), (15, 15)], STEPS)
    if path is None:
        return survey.fly(swarm, flight)
    with Journal(path, {"seed": 1}) as journal:
        return survey.fly(swarm, flight, tape=FlightTape(journal, [noise, flight]))


def same(one: SurveyResult, two: SurveyResult) -> bool:
    """Whether paths, readings and maps agree to the last bit."""
    a, b = one.belief.posterior(), two.belief.posterior()
    return (
        np.array_equal(one.swarm.history, two.swarm.history)
        and np.array_equal(one.measurements.gain_db, two.measurements.gain_db)
        and np.array_equal(one.measurements.cell, two.measurements.cell)
        and np.array_equal(a.mean_db, b.mean_db)
        and np.array_equal(a.variance_db2, b.variance_db2)
    )


@pytest.mark.parametrize("planner", ["random-waypoint", "sequential-greedy"])
def test_a_tape_changes_nothing(tmp_path: Path, planner: str) -> None:
    assert same(fly(None, planner), fly(tmp_path / "tape", planner))


@pytest.mark.parametrize("left", [1, 2, 3, 12, 19, 26])
def test_cut_off_anywhere_it_goes_on_to_the_same_end(tmp_path: Path, left: int) -> None:
    path = tmp_path / "tape"
    whole = fly(path)
    lines = path.read_bytes().splitlines(keepends=True)
    assert len(lines) > left
    path.write_bytes(b"".join(lines[:left]) + lines[left][: len(lines[left]) // 2])
    assert same(whole, fly(path))
    assert path.read_bytes().count(b"\n") == len(lines)


def test_a_finished_flight_is_told_again_without_flying(tmp_path: Path) -> None:
    path = tmp_path / "tape"
    whole = fly(path)
    before = path.read_bytes()
    again = fly(path)
    assert same(whole, again)
    assert path.read_bytes() == before
    assert [r.planning_s for r in again.journal] == [r.planning_s for r in whole.journal]


def test_a_tape_of_another_shape_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tape"
    with Journal(path, {"seed": 1}) as journal:
        journal.append({"plan": [], "random": [{}, {}]})
    with pytest.raises(InputError, match="does not fit this survey"):
        fly(path)
