"""What does not fit into memory is refused before the flight, with the way out."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.app.fly import fly
from skygain.app.progress import Progress
from skygain.app.requests import SurveyRequest
from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments.simulated import PerfectInstrument
from skygain.planners import create_planner
from skygain.predictors import PREDICTORS, create_predictor
from skygain.scenario import Scenario
from skygain.survey import memory
from skygain.survey.loop import Survey


def test_a_survey_that_does_not_fit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand cells a side: local Kriging flies where the others would need gigabytes."""
    monkeypatch.setattr(memory, "free_bytes", lambda: 2e9)
    shape = (1000, 1000)
    scenario = Scenario(City(Grid(shape, 4.0), np.zeros(shape)))
    swarm = Swarm.deployed(scenario, [(0, 0), (9, 9)], 1000)
    instrument = PerfectInstrument(np.full(shape, -90.0))
    for name in ("kriging-blind", "kriging-inferred", "operator"):
        survey = Survey(scenario, create_predictor(name), create_planner("lawnmower"), instrument)
        with pytest.raises(InputError, match=r"2\.0 GB are free; give `predictor=local-kriging`"):
            survey.fly(swarm, np.random.default_rng(0))
    assert memory.demand_memory(create_predictor("local-kriging"), scenario, 2002) < 2e9


def test_every_predictor_of_ours_tells_what_it_takes() -> None:
    for name in ("kriging", "kriging-inferred", "local-kriging", "thin-plate", "operator", "unet"):
        predictor = PREDICTORS.create(name)
        small, large = (predictor.memory_bytes(cells, 600) for cells in (96**2, 10**6))
        assert 0 < small < large
        assert small < 1e9


def test_much_memory_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []

    class Heard(Progress):
        def note(self, line: str) -> None:
            notes.append(line)

    monkeypatch.setattr("skygain.app.fly.WORTH_TELLING", 0.0)
    fly(SurveyRequest(city="sample:9", predictor="idw", planner="lawnmower", steps=2), Heard())
    assert any(line.startswith("memory: up to") for line in notes)


def test_this_machine_says_what_is_free() -> None:
    assert (memory.free_bytes() or 1.0) > 0
