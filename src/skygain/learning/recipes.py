"""Recipes by name: what `skygain train predictor --recipe …` runs."""

from __future__ import annotations

__all__ = ["RECIPES", "recipe", "train_predictor"]

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from skygain.errors import InputError
from skygain.learning.tasks import OperatorTask
from skygain.learning.train import Result, TrainConfig, train

RECIPES: dict[str, TrainConfig] = {
    "operator": TrainConfig(task=OperatorTask(), data="", out="", batch_size=16, hold_steps=8000),
    "operator-no-profile": TrainConfig(task=OperatorTask(profile=False), data="", out="", batch_size=16, hold_steps=8000),
}
"""Complete settings but for the paths."""


def recipe(name: str) -> TrainConfig:
    """The settings called ``name``.

    Raises:
        InputError: no recipe has that name; the message lists those that exist.
    """
    if name not in RECIPES:
        raise InputError(f"unknown recipe {name!r}; known: {', '.join(sorted(RECIPES))}")
    return RECIPES[name]


def train_predictor(
    name: str,
    data: str | Path,
    out: str | Path,
    *,
    report: Callable[[dict[str, Any]], None] = lambda record: None,
    **changes: Any,
) -> Result:
    """Train by recipe ``name`` on the data set ``data`` in folder ``out``, continuing what is there; ``changes`` override the recipe."""
    return train(replace(recipe(name), data=str(data), out=str(out), **changes), report)
