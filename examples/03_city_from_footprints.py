"""A city from building footprints, its gain over the rooftops, and a survey with noisy receivers
that stops when sure enough."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skygain.cities import open_city
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.instruments.simulated import NoiseConfig, NoisyInstrument
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.propagation import PROPAGATION
from skygain.scenario import Scenario
from skygain.survey.loop import Survey, SurveyConfig

city = open_city(Path(__file__).parent / "data" / "buildings.geojson", spacing_m=4.0)
west, south, _, _ = city.grid.bounds_m
transmitter = (west + 50.0, south + 100.0, 1.5)
truth = PROPAGATION.create(
    "over-rooftop", city=city, transmitters_m=[transmitter], altitudes_m=[10.0]
)[0, 0]

rng = np.random.default_rng(1)
scenario = Scenario(city, transmitter_m=transmitter)
instrument = NoisyInstrument(truth, NoiseConfig(std_db=2.0), np.random.default_rng(2))
survey = Survey(
    scenario,
    create_predictor("kriging-blind"),
    create_planner("lawnmower"),
    instrument,
    SurveyConfig(stop_std_db=6.0),
)
result = survey.fly(
    Swarm.deployed(scenario, start_cells("cluster", scenario, 4, rng), steps=250), rng
)

error = (result.belief.posterior().mean_db - truth)[scenario.outdoor]
print(
    f"stopped by {result.stopped!r} after {result.swarm.steps_flown} steps, RMSE "
    f"{np.sqrt(np.mean(error**2)):.2f} dB"
)
