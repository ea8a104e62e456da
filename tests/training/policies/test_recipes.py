"""Policies by recipe: what does not exist is named."""

from __future__ import annotations

import pytest

from skygain.ground.errors import InputError
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.testing.planners import check_planner, planner_scenarios
from skygain.training.policies.recipes import train_policy


def test_unknown_recipes_settings_and_weights_are_refused(tmp_path):
    with pytest.raises(InputError, match="known: dqn, dqn-rewards-only, dqn-thin-plate, imit"):
        train_policy("a3c", "sample", tmp_path)
    with pytest.raises(InputError, match="no setting `start_from`"):
        train_policy("imitation", "sample", tmp_path, start_from="x")


def test_one_uav_learns_on_thin_plate_splines(tmp_path):
    """A few steps, which end in a planner that flies on them."""
    small = {"side": 16, "steps": 12, "lanes": 1, "warmup": 4, "capacity": 64, "batch_size": 4}
    result = train_policy("dqn-thin-plate", "sample", tmp_path, total_steps=13, **small)
    assert result.step == 13
    weights = tmp_path / "dqn-thin-plate.safetensors"
    planner = create_planner("dqn", weights=str(weights), symmetries=1)
    check_planner(planner, create_predictor("thin-plate"), settings=[planner_scenarios()[9]])
