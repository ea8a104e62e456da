"""Which model, in which version, the numbers of a data set come from.

Numbers of different models are different worlds: a network that learns from both learns neither.
"""

from __future__ import annotations

__all__ = ["demand_one_origin", "origin"]

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skygain.ground.errors import InputError


def origin(attributes: Mapping[str, Any]) -> str:
    """The propagation model of a data set with these attributes, as text.

    >>> origin({"data_version": 1, "propagation": "gudmundson"})
    'gudmundson, data version 1'
    >>> origin({})
    'unknown model, data version 0'
    """
    rays = attributes.get("rays")
    by = ""
    if isinstance(rays, Mapping):
        by = f" by {rays.get('model', 'rays')} {rays.get('model_version', '?')}"
    model = attributes.get("propagation", "unknown model")
    return f"{model}{by}, data version {attributes.get('data_version', 0)}"


def demand_one_origin(attributes: Mapping[Path, Mapping[str, Any]]) -> None:
    """Raise `InputError` if the data sets, by path, come from different models."""
    origins = {str(path): origin(found) for path, found in attributes.items()}
    if len(set(origins.values())) > 1:
        told = "; ".join(f"{path}: {text}" for path, text in origins.items())
        raise InputError(
            f"data sets to be used together must come from one propagation model; got {told}; "
            "leave one out or build it anew with: skygain dataset build"
        )
