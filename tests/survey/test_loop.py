"""The loop measures what it flies over, stops when told, and takes no illegal plan."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments.simulated import PerfectInstrument
from skygain.planners import Plan, Planner, create_planner
from skygain.predictors import create_predictor
from skygain.scenario import Scenario
from skygain.survey.loop import Survey, SurveyConfig


@pytest.fixture
def flight(rng: np.random.Generator) -> tuple[Survey, Swarm, np.ndarray]:
    height = np.zeros((20, 20))
    height[5:9, 5:9] = 25.0
    scenario = Scenario(City(Grid((20, 20), 4.0), height))
    truth = -90 + np.cumsum(rng.normal(size=(20, 20)), axis=1)
    survey = Survey(
        scenario,
        create_predictor("idw"),
        create_planner("random-waypoint"),
        PerfectInstrument(truth),
    )
    return survey, Swarm.deployed(scenario, [(0, 0), (19, 19)], 30), truth


def test_every_cell_flown_over_is_measured_once_per_visit(flight: tuple) -> None:
    survey, swarm, truth = flight
    result = survey.fly(swarm, np.random.default_rng(1))
    assert result.stopped == "steps"
    assert result.swarm.steps_flown == 30
    assert len(result.measurements) == 2 * 31
    cells = result.swarm.history.transpose(1, 0, 2).reshape(-1, 2)
    assert (result.measurements.cell == cells).all()
    assert np.allclose(result.measurements.gain_db, truth[cells[:, 0], cells[:, 1]])
    assert result.measurements.time_s.tolist() == np.repeat(np.arange(31.0), 2).tolist()


def test_same_seed_same_survey(flight: tuple) -> None:
    survey, swarm, _ = flight
    first, second, other = (
        survey.fly(swarm, np.random.default_rng(s)).swarm.history for s in (1, 1, 2)
    )
    assert (first == second).all()
    assert not (first == other).all()


def test_the_map_does_not_depend_on_the_number_of_threads(rng: np.random.Generator) -> None:
    height = np.zeros((40, 40))
    height[10:20, 10:20] = 25.0
    scenario = Scenario(City(Grid((40, 40), 4.0), height))
    truth = -90 + np.cumsum(rng.normal(size=(40, 40)), axis=1)
    maps = []
    for threads in (1, 2):
        survey = Survey(
            scenario,
            create_predictor("kriging-blind"),
            create_planner("sequential-greedy", horizon=20, width=30),
            PerfectInstrument(truth),
        )
        swarm = Swarm.deployed(scenario, [(0, 0), (39, 39), (0, 39)], 60)
        with threadpool_limits(limits=threads, user_api="blas"):
            posterior = survey.fly(swarm, np.random.default_rng(1)).posterior
        maps.append((posterior.mean_db.tobytes(), posterior.variance_db2.tobytes()))
    assert maps[0] == maps[1]


def test_the_observer_sees_every_step(flight: tuple) -> None:
    survey, swarm, _ = flight
    seen: list[int] = []
    survey.fly(swarm, np.random.default_rng(1), lambda step, s, b: seen.append(len(b.measurements)))
    assert seen == [2 * (step + 1) for step in range(31)]


def test_stops_early_once_certain_enough(flight: tuple) -> None:
    survey, swarm, _ = flight
    full = survey.fly(swarm, np.random.default_rng(1))
    certain = full.posterior.expected_rmse_db(survey.scenario.outdoor) + 0.3
    early = Survey(
        survey.scenario,
        survey.predictor,
        survey.planner,
        survey.instrument,
        SurveyConfig(stop_std_db=certain),
    )
    result = early.fly(swarm, np.random.default_rng(1))
    assert result.stopped == "stop-std"
    assert result.swarm.steps_flown < 30
    assert result.posterior.expected_rmse_db(survey.scenario.outdoor) < certain
    with pytest.raises(InputError, match="above 0"):
        SurveyConfig(stop_std_db=0.0)


def test_an_interrupt_keeps_what_was_learnt(flight: tuple) -> None:
    survey, swarm, _ = flight

    def interrupt(step: int, *_: object) -> None:
        if step == 7:
            raise KeyboardInterrupt

    result = survey.fly(swarm, np.random.default_rng(1), interrupt)
    assert result.stopped == "interrupted"
    assert len(result.measurements) == len(result.belief.measurements) == 2 * 8


def test_no_steps_still_measures_the_start(flight: tuple) -> None:
    survey, swarm, _ = flight
    result = survey.fly(Swarm.deployed(survey.scenario, swarm.cells, 0), np.random.default_rng(1))
    assert len(result.measurements) == 2


def test_an_illegal_plan_is_not_flown(flight: tuple) -> None:
    survey, swarm, _ = flight

    class Teleport(Planner):
        def plan(
            self, swarm: Swarm, belief: object, horizon: int, rng: np.random.Generator
        ) -> Plan:
            return Plan(np.stack([swarm.cells, swarm.cells[::-1]], axis=1), commit_steps=1)

    with pytest.raises(ValueError, match="jumps"):
        Survey(survey.scenario, survey.predictor, Teleport(), survey.instrument).fly(
            swarm, np.random.default_rng(1)
        )
