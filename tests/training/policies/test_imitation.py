"""Imitation in rounds: it resumes, and learns what is easily learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.testing.planners import check_planner, planner_scenarios
from skygain.training.checkpoints import load_checkpoint
from skygain.training.policies.imitation import ImitationConfig, train_imitation


def test_imitation_resumes_and_learns_from_its_own_flights(tmp_path):
    config = ImitationConfig(
        predictors=("idw",),
        expert="random-waypoint:repeat_probability=1.0",
        side=32,
        steps=16,
        surveys=(4, 3),
        updates=(24, 12),
        learning_rate=3e-3,
        held_out=1,
        batch_size=16,
        workers=1,
        checkpoint_steps=24,
    )
    whole = train_imitation(replace(config, out=str(tmp_path / "whole")))
    train_imitation(replace(config, out=str(tmp_path / "parts"), surveys=(4,), updates=(24,)))
    parts = train_imitation(replace(config, out=str(tmp_path / "parts")))
    one, two = (load_checkpoint(run.checkpoint)[0] for run in (whole, parts))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert whole.scores["held_out_loss"] < 0.95 * np.log(
        4
    )  # straight on is easily learned: the last move is part of the view
    imitator = create_planner(
        "imitation", weights=str(tmp_path / "whole" / "policy-1.safetensors"), symmetries=2
    )
    check_planner(
        imitator, create_predictor("idw"), settings=[planner_scenarios()[k] for k in (0, 3, 9)]
    )
