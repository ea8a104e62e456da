"""Fly one survey over a city that ships with the package, and look at the error as it falls."""

from __future__ import annotations

import numpy as np

from skygain.datasets.cases import survey_cases
from skygain.datasets.sample import open_sample
from skygain.evaluation.rollout import Recorder
from skygain.flight.swarm import Swarm
from skygain.instruments.simulated import PerfectInstrument
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.survey.loop import Survey

case = survey_cases(open_sample(), "T4", n_uavs=3)[0]
scenario = case.scenario()
survey = Survey(
    scenario,
    create_predictor("kriging"),
    create_planner("greedy-variance"),
    PerfectInstrument(case.truth_db),
)

recorder = Recorder(frozenset(range(25, 201, 25)), case.truth_db)
result = survey.fly(
    Swarm.deployed(scenario, case.start_cells, steps=200), np.random.default_rng(0), recorder
)

for frame in recorder.frames:
    print(
        f"after {frame.step:3d} steps: RMSE {frame.scores['rmse_db']:5.2f} dB, predicted "
        f"{frame.scores['expected_rmse_db']:5.2f} dB"
    )

assert recorder.frames[-1].scores["rmse_db"] < recorder.frames[0].scores["rmse_db"]
print(
    f"{len(result.measurements)} readings in "
    f"{result.measurements.visited(scenario.grid.shape).sum()} cells"
)
