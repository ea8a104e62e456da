"""The DQN resumes to the same weights and learns from demonstrations."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from skygain.ground.errors import InputError
from skygain.networks.unets.paper import PaperUNets
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.testing.planners import check_planner, planner_scenarios
from skygain.training.checkpoints import load_checkpoint, save_checkpoint
from skygain.training.policies.dqn import train_dqn
from skygain.training.policies.imitation import ImitationConfig, train_imitation
from skygain.training.policies.learner import DqnConfig
from skygain.training.policies.recipes import train_policy

SMALL = DqnConfig(
    predictor="idw",
    network="centred",
    double=True,
    dueling=True,
    side=32,
    steps=8,
    lanes=2,
    n_uavs=2,
    split="T1",
    n_steps=3,
    warmup=24,
    capacity=80,
    batch_size=8,
    learn_every=2,
    target_every=5,
    exploration=0.2,
    checkpoint_steps=12,
    log_steps=6,
    augment=True,
    bf16=False,
)


def tensors(result):
    return load_checkpoint(result.checkpoint)[0]


@pytest.mark.parametrize("predictor", ["idw", "network"])
def test_a_resumed_dqn_run_ends_with_the_same_weights(tmp_path, predictor):
    config = SMALL
    if (
        predictor == "network"
    ):  # its last bits depend on how many surveys it is asked about together
        torch.manual_seed(0)
        save_checkpoint(
            tmp_path / "unets.safetensors", PaperUNets().state_dict(), {"name": "untrained"}
        )
        config = replace(SMALL, predictor=f"paper-unet:weights={tmp_path / 'unets.safetensors'}")
    whole = train_dqn(replace(config, out=str(tmp_path / "whole"), total_steps=36))
    train_dqn(
        replace(config, out=str(tmp_path / "parts"), total_steps=23)
    )  # in the middle of an episode, the ring full
    parts = train_dqn(replace(config, out=str(tmp_path / "parts"), total_steps=36))
    assert parts.samples == whole.samples > 8 * SMALL.batch_size
    one, two = tensors(whole), tensors(parts)
    assert all(torch.equal(one[key], two[key]) for key in one)


def straight_flights(folder):
    """Demonstrations of an expert that flies straight on as long as it can."""
    config = ImitationConfig(
        predictors=("idw",),
        expert="random-waypoint:repeat_probability=1.0",
        out=str(folder),
        side=32,
        steps=16,
        surveys=(4,),
        updates=(1,),
        held_out=1,
        batch_size=4,
        workers=1,
    )
    train_imitation(config)
    return str(folder / "demonstrations")


def test_demonstrations_are_learned_before_the_first_step_and_kept(tmp_path):
    flights = straight_flights(tmp_path / "expert")
    taught = replace(
        SMALL,
        demonstrations=flights,
        demonstration_weight=1.0,
        pretraining=60,
        learning_rate=3e-4,
        batch_size=32,
    )
    said = []
    whole = train_dqn(replace(taught, out=str(tmp_path / "whole"), total_steps=24), said.append)
    assert [r["agreement"] for r in said if "pretraining" in r][
        -1
    ] > 0.5  # of 2 to 4 legal moves; the last one is part of the view
    assert whole.scores["agreement"] > 0.5
    train_dqn(replace(taught, out=str(tmp_path / "parts"), total_steps=15))
    parts = train_dqn(replace(taught, out=str(tmp_path / "parts"), total_steps=24))
    one, two = tensors(whole), tensors(parts)
    assert all(torch.equal(one[key], two[key]) for key in one)


def test_demonstrations_that_are_not_there_are_asked_for(tmp_path):
    with pytest.raises(InputError, match="needs a folder"):
        replace(SMALL, pretraining=3)
    with pytest.raises(InputError, match="no demonstrations in"):
        train_dqn(replace(SMALL, out=str(tmp_path), demonstrations=str(tmp_path)))


def test_weights_that_fit_nothing_are_refused(tmp_path):
    save_checkpoint(tmp_path / "other.safetensors", {"something": torch.zeros(3)}, {"policy": {}})
    with pytest.raises(InputError, match="nothing in"):
        train_dqn(
            replace(
                SMALL, out=str(tmp_path / "run"), start_from=str(tmp_path / "other.safetensors")
            )
        )


def test_dqn_recipe_makes_a_planner(tmp_path):
    settings = {
        k: getattr(SMALL, k)
        for k in (
            "predictor",
            "side",
            "steps",
            "lanes",
            "n_uavs",
            "warmup",
            "capacity",
            "batch_size",
        )
    }
    train_policy("dqn-rewards-only", "sample", tmp_path, total_steps=30, **settings)
    planner = create_planner(
        "dqn", weights=str(tmp_path / "dqn-rewards-only.safetensors"), symmetries=2
    )
    settings = [
        planner_scenarios()[k] for k in (3, 6, 9)
    ]  # empty batteries, everyone returns, no move at all
    check_planner(planner, create_predictor("idw"), settings=settings)
