from __future__ import annotations

from skygain.planners import create_planner
from skygain.testing.planners import check_planner


def test_keeps_the_contract(field_predictor, variance_predictor):
    check_planner(create_planner("greedy-variance", start_steps=4, commit_steps=15), field_predictor)
    check_planner(create_planner("greedy-variance"), variance_predictor)
