"""Skygain maps a radio transmitter's channel gain over a city with a swarm of UAVs that fly where
measuring teaches the most.

``import skygain as sg`` is the face of the package: what stands in ``sg.__all__`` is loaded when it
is first asked for.
"""

from __future__ import annotations

__all__ = [
    "City",
    "EvaluateRequest",
    "Grid",
    "InputError",
    "Measurements",
    "Posterior",
    "Scenario",
    "Survey",
    "SurveyRequest",
    "Swarm",
    "__version__",
    "compare",
    "fly",
    "open_city",
    "open_world",
    "planner",
    "predictor",
]

import importlib
from typing import TYPE_CHECKING, Any

from skygain.ground.kernel_cache import find_cache

if TYPE_CHECKING:
    from skygain.app.fly import fly
    from skygain.app.requests import EvaluateRequest, SurveyRequest
    from skygain.cities import open_city
    from skygain.city import City
    from skygain.evaluation.comparison import compare
    from skygain.flight.swarm import Swarm
    from skygain.grid import Grid
    from skygain.ground.errors import InputError
    from skygain.measurements import Measurements
    from skygain.posterior import Posterior
    from skygain.scenario import Scenario
    from skygain.survey.loop import Survey
    from skygain.survey.methods import planner, predictor
    from skygain.survey.worlds import open_world

__version__ = "0.1.0"

find_cache()  # before any kernel is imported; it does nothing where the package can be written to

_HOME = {
    "app.fly": ("fly",),
    "app.requests": ("EvaluateRequest", "SurveyRequest"),
    "cities": ("open_city",),
    "city": ("City",),
    "evaluation.comparison": ("compare",),
    "flight.swarm": ("Swarm",),
    "grid": ("Grid",),
    "ground.errors": ("InputError",),
    "measurements": ("Measurements",),
    "posterior": ("Posterior",),
    "scenario": ("Scenario",),
    "survey.loop": ("Survey",),
    "survey.methods": ("planner", "predictor"),
    "survey.worlds": ("open_world",),
}
"""where each name is defined"""


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            found = getattr(importlib.import_module(f"skygain.{module}"), name)
            globals()[name] = found
            return found
    raise AttributeError(f"module 'skygain' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
