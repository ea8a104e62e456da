"""How predictors and policies are trained; the only room that needs PyTorch."""

from __future__ import annotations

__all__ = ["train_policy", "train_predictor"]

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skygain.datasets.links import Paths
    from skygain.training.run import Report, Result


def train_predictor(
    name: str,
    data: Paths,
    out: str | Path | None = None,
    *,
    report: Report = lambda record: None,
    **changes: Any,
) -> Result:
    """See `skygain.training.recipes.train_predictor`; PyTorch is loaded when this is called."""
    from skygain.training import recipes

    return recipes.train_predictor(name, data, out, report=report, **changes)


def train_policy(
    name: str,
    data: str | Path,
    out: str | Path | None = None,
    *,
    report: Report = lambda record: None,
    **changes: Any,
) -> Result:
    """See `skygain.training.policies.recipes.train_policy`; PyTorch is loaded when this is
    called."""
    from skygain.training.policies import recipes

    return recipes.train_policy(name, data, out, report=report, **changes)
