"""Recipes by name: what `skygain train predictor --recipe …` runs."""

from __future__ import annotations

__all__ = ["RECIPES", "recipe", "train_predictor"]

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from skygain.datasets.links import several_paths
from skygain.ground.errors import InputError
from skygain.networks.weights import export_weights, runs_folder
from skygain.training.judge import train_judge
from skygain.training.path_model import train_path_model
from skygain.training.tasks.base import OperatorTask
from skygain.training.tasks.locator import LocatorTask
from skygain.training.tasks.unets import DirectTask, PaperTask
from skygain.training.train import Result, TrainConfig, train

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

RECIPES: dict[str, TrainConfig] = {
    "operator": OURS,
    "operator-no-profile": replace(OURS, task=OperatorTask(profile=False)),
    "locator": LOCATOR,
    "unet": replace(OURS, task=DirectTask()),
    "paper-unet": PAPER,
    "paper-unet-mapblind": replace(PAPER, task=PaperTask(blind=True)),
    "paper-unet-5": replace(PAPER, task=PaperTask(uavs=5), start_from="paper-unet"),
    "paper-unet-20m": replace(PAPER, task=PaperTask(altitude_m=20.0), start_from="paper-unet"),
    "paper-unet-30m": replace(PAPER, task=PaperTask(altitude_m=30.0), start_from="paper-unet"),
}
"""Complete settings but for the paths."""


SMALL: dict[str, Callable[..., Result]] = {"path-model": train_path_model, "judge": train_judge}
"""Perceptrons with a trainer of their own."""


def recipe(name: str) -> TrainConfig:
    """The settings called ``name``.

    Raises:
        InputError: no recipe has that name; the message lists those that exist.
    """
    if name not in RECIPES:
        raise InputError(f"unknown recipe {name!r}; known: {', '.join(sorted([*RECIPES, *SMALL]))}")
    return RECIPES[name]


def train_predictor(
    name: str,
    data: str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    report: Callable[[dict[str, Any]], None] = lambda record: None,
    **changes: Any,
) -> Result:
    """Train by recipe ``name`` on the data set ``data`` (or several together) in folder ``out``,
    continuing what is there.

    ``changes`` override the recipe. The averaged weights end up as ``out/<name>.safetensors`` with
    a card in JSON beside them. Without ``out`` the run lives in `runs_folder`, where the predictor
    of that name finds its weights.

    Raises:
        InputError: unknown recipe, no such data set, or a checkpoint in ``out`` that is not one.
    """
    several = several_paths(data)
    folder = Path(out) if out is not None else runs_folder() / name
    weights = folder / f"{name}.safetensors"
    if name in SMALL:
        if unknown := [
            key for key in changes if key in ("max_seconds", "finish_steps", "start_from")
        ]:
            raise InputError(
                f"{name} trains in minutes and has no option {unknown[0]!r}; leave it out"
            )
        return SMALL[name](several, weights, report=report, **changes)
    result = train(
        replace(recipe(name), data=tuple(map(str, several)), out=str(folder), **changes), report
    )
    bits = PAPER_BITS if name.startswith("paper-unet") else 0
    precision = f"float16, the dense layers {bits} bits" if bits else "float16"
    made_of = " + ".join(path.name for path in several)
    export_weights(
        result.checkpoint, weights, {"name": name, "data": made_of, "precision": precision}, bits
    )
    return result
