"""How predictors and policies are trained."""

from __future__ import annotations

__all__ = ["train_predictor"]

from typing import Any


def train_predictor(*arguments: Any, **options: Any) -> Any:
    """See `skygain.learning.recipes.train_predictor`; PyTorch is loaded when this is called."""
    from skygain.learning import recipes

    return recipes.train_predictor(*arguments, **options)
