"""Public conformance checks for anyone's predictor, planner or instrument.

Each raises `AssertionError` with a sentence that says which promise of the seam was broken.

>>> from skygain.predictors import create_predictor
>>> from skygain.testing import check_predictor
>>> check_predictor(create_predictor("idw"))
"""

from __future__ import annotations

__all__ = ["check_instrument", "check_planner", "check_predictor"]

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skygain.testing.instruments import check_instrument
    from skygain.testing.planners import check_planner
    from skygain.testing.predictors import check_predictor

_HOME = {
    "check_instrument": "instruments",
    "check_planner": "planners",
    "check_predictor": "predictors",
}


def __getattr__(name: str) -> Any:
    # A check loads only the part of Skygain it checks.
    if name in _HOME:
        return getattr(importlib.import_module(f"skygain.testing.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
