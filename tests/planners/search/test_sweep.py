from __future__ import annotations

import pytest

from skygain.planners import create_planner
from skygain.testing.planners import check_planner


@pytest.mark.parametrize("name", ["lawnmower", "spiral"])
def test_keeps_the_contract(name, variance_predictor):
    check_planner(create_planner(name), variance_predictor)
