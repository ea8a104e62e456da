"""Recipes by name: what `skygain train predictor --recipe …` runs."""

from __future__ import annotations

__all__ = ["RECIPES", "settled", "train_predictor"]

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from skygain.datasets.links import Paths, several_paths
from skygain.ground.errors import InputError
from skygain.networks.graphs import write_graph
from skygain.networks.weights import export_weights, runs_folder
from skygain.training.judge import JudgeConfig, train_judge
from skygain.training.path_model import PathModelConfig, train_path_model
from skygain.training.run import Report, Result
from skygain.training.tasks.base import OperatorTask
from skygain.training.tasks.locator import LocatorTask
from skygain.training.tasks.unets import DirectTask, PaperTask
from skygain.training.train import TrainConfig, train

Config = TypeVar("Config")

OURS = TrainConfig(task=OperatorTask(), data="", out="", batch_size=16, hold_steps=8000)
PAPER = TrainConfig(
    task=PaperTask(),
    data="",
    out="",
    batch_size=160,
    learning_rate=1e-3,
    betas=(0.9, 0.999),
    epsilon=1e-6,
    weight_decay=0.0,
    warmup_steps=0,
    hold_steps=10**9,
    average_decay=0.0,
    clip_norm=0.0,
    validate_steps=100,
)

LOCATOR = TrainConfig(
    task=LocatorTask(),
    data="",
    out="",
    batch_size=32,
    learning_rate=2e-3,
    weight_decay=2e-2,
    hold_steps=600,
    validate_steps=200,
)

PAPER_BITS = 4
"""of the dense layers' weights when a paper U-Net is exported"""

RECIPES: dict[str, TrainConfig | PathModelConfig | JudgeConfig] = {
    "operator": OURS,
    "operator-no-profile": replace(OURS, task=OperatorTask(profile=False)),
    "path-model": PathModelConfig(),
    "locator": LOCATOR,
    "judge": JudgeConfig(),
    "unet": replace(OURS, task=DirectTask()),
    "paper-unet": PAPER,
    "paper-unet-mapblind": replace(PAPER, task=PaperTask(blind=True)),
    "paper-unet-5": replace(PAPER, task=PaperTask(uavs=5), start_from="paper-unet"),
    "paper-unet-20m": replace(PAPER, task=PaperTask(altitude_m=20.0), start_from="paper-unet"),
    "paper-unet-30m": replace(PAPER, task=PaperTask(altitude_m=30.0), start_from="paper-unet"),
}
"""Complete settings but for the paths."""


def train_predictor(
    name: str,
    data: Paths,
    out: str | Path | None = None,
    *,
    report: Report = lambda record: None,
    **changes: Any,
) -> Result:
    """Train by recipe ``name`` on the data set ``data`` (or several together) in folder ``out``,
    continuing what is there.

    ``changes`` override the recipe. The weights end up as ``out/<name>.safetensors``, with their
    card in the header and their graph beside them. Without ``out`` the run lives in `runs_folder`,
    where the predictor of that name finds its weights.

    Raises:
        InputError: unknown recipe or setting, no such data set, or a checkpoint in ``out`` that is
            not one.
    """
    several = several_paths(data)
    config = settled("recipe", RECIPES, name, out, data=tuple(map(str, several)), **changes)
    if isinstance(config, PathModelConfig):
        return train_path_model(config, report)
    if isinstance(config, JudgeConfig):
        return train_judge(config, report)
    result = train(config, report)
    bits = PAPER_BITS if name.startswith("paper-unet") else 0
    card = {
        "name": name,
        "data": " + ".join(path.name for path in several),
        "precision": f"float16, the dense layers {bits} bits" if bits else "float16",
    }
    weights = Path(config.out) / f"{name}.safetensors"
    export_weights(result.checkpoint, weights, card, bits)
    write_graph(name, weights)
    return result


def settled(
    kind: str,
    recipes: Mapping[str, Config],
    name: str,
    out: str | Path | None,
    **changes: Any,
) -> Config:
    """The settings called ``name`` with ``changes``, run in ``out`` or, if that is ``None``, under
    its name in `runs_folder`.

    Raises:
        InputError: no recipe has that name, or the recipe no such setting; the message lists those
            that exist.
    """
    if name not in recipes:
        raise InputError(f"unknown {kind} {name!r}; known: {', '.join(sorted(recipes))}")
    known = {f.name for f in fields(recipes[name])}  # type: ignore[arg-type]
    if unknown := sorted(changes.keys() - known):
        raise InputError(f"the recipe {name!r} has no setting `{unknown[0]}`; leave it out")
    folder = runs_folder() / name if out is None else Path(out)
    return replace(recipes[name], out=str(folder), **changes)  # type: ignore[type-var]
