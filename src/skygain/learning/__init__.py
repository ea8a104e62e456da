"""How predictors and policies are trained."""

from __future__ import annotations

__all__ = ["train_policy", "train_predictor"]

from typing import Any


def train_predictor(*arguments: Any, **options: Any) -> Any:
    """See `skygain.learning.recipes.train_predictor`; PyTorch is loaded when this is called."""
    from skygain.learning import recipes

    return recipes.train_predictor(*arguments, **options)


def train_policy(*arguments: Any, **options: Any) -> Any:
    """See `skygain.learning.policy_recipes.train_policy`; PyTorch is loaded when this is called."""
    from skygain.learning import policy_recipes

    return policy_recipes.train_policy(*arguments, **options)
