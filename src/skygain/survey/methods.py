"""A method is a predictor flown by a planner, written as text so that tables, command lines and
result files agree.

``kriging``, ``operator+tx`` (the transmitter's position is given to a predictor that could do
without) and ``sequential-greedy:objective=variance:horizon=20`` (options of the factory, separated
by colons) are such texts.
"""

from __future__ import annotations

__all__ = ["MethodSpec", "parse_spec"]

import ast
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from skygain.ground.errors import InputError
from skygain.ground.registry import Registry
from skygain.planners import PLANNERS, Planner
from skygain.predictors import PREDICTORS, Predictor
from skygain.scenario import Scenario


def parse_spec(text: str) -> tuple[str, dict[str, Any]]:
    """Split ``name:key=value:…`` into the name and its options; values are Python literals (also
    true and false), anything else stays text.

    >>> parse_spec("knn:k=5:weights=uniform")
    ('knn', {'k': 5, 'weights': 'uniform'})
    >>> parse_spec("sequential-greedy:weighted=false")
    ('sequential-greedy', {'weighted': False})
    """
    name, *pairs = text.strip().split(":")
    options: dict[str, Any] = {}
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign or not key.isidentifier():
            raise InputError(
                f"cannot read the option {pair!r} of {text!r}; write options as "
                "name:key=value:key=value"
            )
        try:
            options[key] = ast.literal_eval(
                value.capitalize() if value.lower() in ("true", "false") else value
            )
        except (ValueError, SyntaxError):
            options[key] = value
    return name, options


@lru_cache(maxsize=64)
def _create(registry: Registry[Any], text: str) -> Any:
    """Built once per process: predictors and planners hold settings and weights, never a survey's
    state."""
    name, options = parse_spec(text)
    factory = registry.factory(name)
    try:
        return factory(**options)
    except TypeError as error:
        raise InputError(
            f"{registry.kind} {name!r} does not take these options ({error}); see docs/"
        ) from error


@dataclass(frozen=True)
class MethodSpec:
    """One row of a comparison."""

    predictor: str
    """text of the predictor"""
    planner: str
    """text of the planner"""

    @classmethod
    def of_label(cls, text: str) -> MethodSpec:
        """The method that ``text``, "predictor / planner", names.

        Raises:
            InputError: the text has not exactly two parts.
        """
        parts = [part.strip() for part in text.split(" / ")]
        if len(parts) != 2 or not all(parts):
            raise InputError(
                f"cannot read the method {text!r}; write it as in the tables: 'predictor / planner'"
            )
        return cls(*parts)

    @property
    def label(self) -> str:
        """For tables and legends."""
        return f"{self.predictor} / {self.planner}"

    def build_predictor(self) -> Predictor:
        """The predictor; a trailing ``+tx`` is dropped here and acted on by `visible`."""
        return _create(PREDICTORS, self.predictor.removesuffix("+tx"))

    def build_planner(self) -> Planner:
        """The planner."""
        return _create(PLANNERS, self.planner)

    def visible(self, scenario: Scenario, predictor: Predictor) -> Scenario:
        """What the method may know: the transmitter only if it needs it, or was written with
        ``+tx``."""
        if predictor.transmitter == "required" or self.predictor.endswith("+tx"):
            return scenario
        return scenario.without_transmitter()
