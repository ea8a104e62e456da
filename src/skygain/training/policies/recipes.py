"""Recipes of policies by name: what `skygain train policy --recipe …` runs."""

from __future__ import annotations

__all__ = ["POLICY_RECIPES", "train_policy"]

from dataclasses import replace
from pathlib import Path
from typing import Any

from skygain.environments.rewards import RewardConfig
from skygain.networks.graphs import write_graph
from skygain.networks.policies.weights import export_policy
from skygain.training.checkpoints import load_checkpoint
from skygain.training.policies.dqn import train_dqn
from skygain.training.policies.imitation import SHAPE, ImitationConfig, train_imitation
from skygain.training.policies.learner import DqnConfig
from skygain.training.recipes import settled
from skygain.training.run import Report, Result, under

REWARDS_ONLY = DqnConfig(
    predictor="paper-unet",
    network="centred",
    double=True,
    dueling=True,
    start="mixed",
    reward=RewardConfig(explore=0.005, error=0.01, shaping=True, discount=0.99),
    v_min=-3.0,
    v_max=16.0,
    exploration=0.05,
    learning_rate=1e-4,
    batch_size=128,
    learn_every=2,
    target_every=500,
    warmup=3000,
    capacity=300_000,
    augment=True,
    bf16=False,
    split="T1",
    checkpoint_steps=500,
)

POLICY_RECIPES: dict[str, DqnConfig | ImitationConfig] = {
    "paper-dqn": DqnConfig(),
    "dqn": replace(
        REWARDS_ONLY,
        start_from="imitation",
        demonstrations="imitation",
        demonstration_weight=0.5,
        pretraining=300,
    ),
    "dqn-rewards-only": REWARDS_ONLY,
    "dqn-thin-plate": replace(REWARDS_ONLY, predictor="thin-plate", n_uavs=1),
    "imitation": ImitationConfig(),
}
"""complete settings but for the paths"""


def train_policy(
    name: str,
    data: str | Path,
    out: str | Path | None = None,
    *,
    report: Report = lambda record: None,
    **changes: Any,
) -> Result:
    """Train by recipe ``name`` on the data set ``data`` in folder ``out``, continuing what is
    there; ``changes`` override the recipe.

    The policy ends up as ``out/<name>.safetensors`` with a card and its graph beside it.
    Without ``out`` the run lives in `skygain.networks.weights.runs_folder`, where the planners find
    it.

    Raises:
        InputError: unknown recipe or setting, no such data set, or a checkpoint in ``out`` that is
            not one.
    """
    config = settled("policy recipe", POLICY_RECIPES, name, out, data=str(data), **changes)
    if isinstance(config, DqnConfig):
        result = train_dqn(config, report)
        keys = ("network", "atoms", "side", "dueling", "v_min", "v_max")
        policy = {key: getattr(config, key) for key in keys}
    else:
        result, policy = train_imitation(config, report), SHAPE
    tensors, meta = load_checkpoint(result.checkpoint)
    ours = ("data", "out", "cluster")  # of this machine
    kept = {key: value for key, value in meta["config"].items() if key not in ours}
    for key in ("start_from", "demonstrations"):
        if key in kept:
            kept[key] = "/".join(Path(kept[key]).parts[-2:])  # no folder of this machine
    card = {
        "name": name,
        "data": Path(data).name,
        "policy": policy,
        "steps": result.step,
        "scores": result.scores,
        "recipe": kept,
    }
    weights = Path(config.out) / f"{name}.safetensors"
    export_policy(under("network.", tensors), weights, card)
    write_graph(name, weights)
    return result
