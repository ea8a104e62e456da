"""A city from building footprints, its gain over the rooftops, and a survey with noisy receivers
that stops when sure enough."""

from __future__ import annotations

import json
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


def block(x: float, y: float, height: float) -> dict:
    """A square building of 40 m as a GeoJSON feature."""
    ring = [[x, y], [x + 40, y], [x + 40, y + 40], [x, y + 40], [x, y]]
    return {
        "type": "Feature",
        "properties": {"height": height},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


features = [block(x, y, 15.0 + (x + y) % 23) for x in (0, 60, 120, 180) for y in (0, 60, 120, 180)]
Path("blocks.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))

city = open_city("blocks.geojson", spacing_m=4.0, crs="local")
transmitter = (50.0, 110.0, 1.5)
truth = PROPAGATION.create(
    "over-rooftop", city=city, transmitters_m=[transmitter], altitudes_m=[10.0]
)[0, 0]

rng = np.random.default_rng(1)
scenario = Scenario(city, transmitter_m=transmitter)
instrument = NoisyInstrument(truth, NoiseConfig(std_db=2.0), np.random.default_rng(2))
survey = Survey(
    scenario,
    create_predictor("kriging"),
    create_planner("lawnmower"),
    instrument,
    SurveyConfig(stop_std_db=8.0),
)
result = survey.fly(
    Swarm.deployed(scenario, start_cells("cluster", scenario, 2, rng), steps=150), rng
)

error = (result.belief.posterior().mean_db - truth)[scenario.outdoor]
print(
    f"stopped by {result.stopped!r} after {result.swarm.steps_flown} steps, RMSE "
    f"{np.sqrt(np.mean(error**2)):.2f} dB"
)
