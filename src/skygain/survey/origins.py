"""The files that a method's results depend on besides the release: weights, parameters, code."""

from __future__ import annotations

__all__ = ["method_files"]

import dataclasses
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from skygain.ground.errors import InputError
from skygain.ground.files import file_digest
from skygain.networks.weights import graph_file, weight_file
from skygain.survey.methods import MethodSpec, parse_spec


def method_files(method: MethodSpec) -> dict[str, str]:
    """File name to digest of everything that predictor and planner read: weights by name or file
    with their graphs, files given as options, and the source of one's own classes.

    >>> sorted(method_files(MethodSpec("kriging", "dqn")))
    ['dqn.onnx', 'dqn.safetensors']
    >>> "operator.onnx" in method_files(MethodSpec("adaptive", "lawnmower"))
    True
    """
    found: set[Path] = set()
    for text, made in (
        (method.predictor, method.build_predictor()),
        (method.planner, method.build_planner()),
    ):
        found.update(_files([*parse_spec(text.removesuffix("+tx"))[1].values(), made]))
    return {path.name: file_digest(path) for path in sorted(found)}


def _files(values: list[Any]) -> Iterator[Path]:
    for value in values:
        if isinstance(value, str | Path):
            yield from _named(value)
        elif dataclasses.is_dataclass(value) and not isinstance(value, type):
            yield from _files([getattr(value, field.name) for field in dataclasses.fields(value)])
            yield from _files(list(getattr(value, "methods", ())))  # what it is made of
        if type(value).__module__.partition(".")[0] not in {"skygain", *sys.stdlib_module_names}:
            source = inspect.getsourcefile(type(value))
            if source is not None:
                yield Path(source)


def _named(value: str | Path) -> Iterator[Path]:
    """The file ``value``, or the weights of that name, which most texts are not."""
    if value and Path(value).is_file():
        yield Path(value)
    if str(value).replace("-", "").isalnum() or str(value).endswith(".safetensors"):
        try:
            weights = weight_file(value)
        except InputError:
            return
        yield from (path for path in (weights, graph_file(weights)) if path.exists())
