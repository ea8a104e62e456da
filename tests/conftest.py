"""Fixtures shared by the whole suite."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from skygain.evaluation.outcome import Outcome


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with the large data sets that are not part of the product; tests that need it skip where it is absent."""
    root = Path(os.environ.get("SKYGAIN_SHARED", Path(__file__).parents[1].parent / "shared")) / "data"
    if not (root / "manhattan-v0.zarr.zip").exists():
        pytest.skip("the shared data sets are absent; set SKYGAIN_SHARED to the folder that holds data/manhattan-v0.zarr.zip")
    return root


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240229)


@pytest.fixture(scope="session")
def make_outcome() -> Callable[..., Outcome]:
    """A small real survey, flown anew for each call: a map that is no square, with a high and a low building and a no-fly zone."""
    from skygain.city import City
    from skygain.evaluation.outcome import Outcome
    from skygain.evaluation.rollout import Recorder
    from skygain.grid import Grid
    from skygain.instruments.simulated import PerfectInstrument
    from skygain.planners import create_planner
    from skygain.predictors import create_predictor
    from skygain.scenario import Scenario
    from skygain.survey import Survey
    from skygain.swarm import Swarm

    def make(*, crs: str | None = None, truth: str | None = "full", name: str = "test town", **told: Any) -> Outcome:
        height = np.zeros((12, 18))
        height[6:9, 4:10], height[2:4, 12:16] = 24.0, 6.0
        no_fly = np.zeros((12, 18), dtype=bool)
        no_fly[0:2, 16:] = True
        origin = (691234.0, 3985876.0) if crs else (2.0, 2.0)
        city = City(Grid((12, 18), 4.0, origin, crs), height, name=name)
        scenario = Scenario(city, no_fly=no_fly, transmitter_m=(origin[0] + 20.0, origin[1] + 8.0, 1.5))
        distance_m = np.hypot(*np.meshgrid(np.arange(18) - 5.0, np.arange(12) - 2.0)) * 4.0
        gain_db = -55 - 30 * np.log10(np.maximum(distance_m, 2.0)) + np.random.default_rng(5).normal(size=(12, 18))
        known = {"full": gain_db, "partial": np.where(np.arange(18) % 3 == 0, gain_db, np.nan), None: None}[truth]
        recorder = Recorder(frozenset(range(0, 31, 5)), known, keep_maps=True)
        survey = Survey(scenario, create_predictor("idw"), create_planner("random-waypoint"), PerfectInstrument(gain_db))
        swarm = Swarm.deployed(scenario, [(0, 0), (11, 17)], 30)
        result = survey.fly(swarm, np.random.default_rng(1), recorder)
        return Outcome(result, recorder.frames, known, **{"title": "A survey", "config": {"seed": 1}, **told})

    return make
