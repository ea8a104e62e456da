"""How predictors and policies are trained."""

from __future__ import annotations

__all__ = ["train_policy", "train_predictor"]

from typing import Any


def train_predictor(*arguments: Any, **options: Any) -> Any:
    """See `skygain.training.recipes.train_predictor`; PyTorch is loaded when this is called."""
    from skygain.training import recipes

    return recipes.train_predictor(*arguments, **options)


def train_policy(*arguments: Any, **options: Any) -> Any:
    """See `skygain.training.policies.recipes.train_policy`; PyTorch is loaded when this is
    called."""
    from skygain.training.policies import recipes as policy_recipes

    return policy_recipes.train_policy(*arguments, **options)
