from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.fields.mixture_posterior import MixturePosterior
from skygain.fields.residual_field import CorrelationModel, ResidualField
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.predictors.base import Belief
from skygain.scenario import Scenario
from skygain.testing.planners import check_planner, planner_scenarios


def test_keeps_the_planners_contract(field_predictor):
    planner = create_planner("lookahead", horizon=12, paths=60)
    check_planner(planner, field_predictor, settings=planner_scenarios()[2:8:2])


def test_young_surveys_plan_more_often_where_readings_change_the_plan(
    field_predictor, variance_predictor
):
    scenario = Scenario(City(Grid((20, 20), 4.0), np.zeros((20, 20), dtype=np.float32)))
    swarm = Swarm.deployed(scenario, [(3, 3), (10, 10)], 60)
    readings = Measurements.at(swarm.cells, [-90.0, -95.0])
    belief = variance_predictor.begin(scenario).updated(readings)
    planner = create_planner("lookahead", horizon=15, paths=40, early_steps=1)
    rng = np.random.default_rng(0)
    young = planner.plan(swarm, belief, 60, rng)
    assert young.commit_steps == 5
    swarm = swarm.advanced(young.paths[:, 1])
    assert planner.plan(swarm, belief, 59, rng).commit_steps == 10
    assert (
        planner.plan(swarm, field_predictor.begin(scenario).updated(readings), 59, rng).commit_steps
        == 15
    )


class Disagreement(Belief):
    """Two models that agree everywhere but in the east, and differ most in the far east."""

    def __init__(self, scenario):
        self.scenario, self.measurements = scenario, Measurements.none()

    def updated(self, measurements):
        return self

    def posterior(self):
        rows, cols = self.scenario.grid.shape
        apart = np.where(np.arange(cols) > cols // 2, 20.0, 0.0) * np.ones((rows, 1))
        residual = ResidualField.empty(
            CorrelationModel(nugget=0.9, far_share=0.0), (rows, cols), 4.0
        )
        means = np.stack([-100 + apart, -100 - apart]).reshape(2, -1).astype(np.float32)
        stds = np.full((2, rows * cols), 3.0, dtype=np.float32)
        return MixturePosterior(
            np.full((rows, cols), -100.0),
            9.0 + apart**2,
            np.array([0.5, 0.5], dtype=np.float32),
            means,
            stds,
            residual.table,
            residual.W,
            1.0,
            np.zeros(rows * cols, dtype=bool),
            1.0,
        )


def test_flies_to_where_the_models_disagree():
    scenario = Scenario(City(Grid((15, 31), 4.0), np.zeros((15, 31), dtype=np.float32)))
    swarm = Swarm.deployed(scenario, [(7, 12)], 60)
    plan = create_planner("lookahead", horizon=16).plan(
        swarm, Disagreement(scenario), 60, np.random.default_rng(0)
    )
    assert plan.paths[0, 4:8, 1].max() > 15


def test_needs_a_step_to_look_ahead():
    with pytest.raises(InputError, match="horizon"):
        create_planner("lookahead", horizon=0)
