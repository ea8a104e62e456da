"""A method is a predictor flown by a planner, written as text so that tables, command lines and
result files agree.

``kriging``, ``operator+tx`` (a predictor that could do without is told the transmitter's position),
``lookahead:horizon=20:paths=200`` (options) and ``my.module:MyPredictor:k=3`` (one's own) are such
texts.
"""

from __future__ import annotations

__all__ = [
    "MethodSpec",
    "Option",
    "for_quantity",
    "options_of",
    "parse_spec",
    "planner",
    "predictor",
]

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import MISSING, dataclass
from functools import lru_cache
from typing import Any

from skygain.ground.declared import field_texts
from skygain.ground.errors import InputError, did_you_mean
from skygain.ground.registry import Registry
from skygain.planners import PLANNERS, Planner
from skygain.predictors import PREDICTORS, Predictor
from skygain.scenario import Scenario

_WORDS = {"bool": "true or false", "int": "a whole number", "float": "a number", "str": "a text"}


def predictor(text: str, **options: Any) -> Predictor:
    """The predictor that ``text`` names; ``options`` are values that a text cannot hold.

    Raises:
        InputError: unknown name, or an option or value it does not take.
    """
    return _made(PREDICTORS, Predictor, text.removesuffix("+tx"), options)


def planner(text: str, **options: Any) -> Planner:
    """The planner that ``text`` names, see `predictor`."""
    return _made(PLANNERS, Planner, text, options)


def parse_spec(text: str) -> tuple[str, dict[str, Any]]:
    """Split ``name:key=value:…`` into the name and its options; values are Python literals (also
    true and false), anything else stays text.

    >>> parse_spec("knn:k=5:weights=uniform")
    ('knn', {'k': 5, 'weights': 'uniform'})
    >>> parse_spec("my.module:Mine:deep=false")
    ('my.module:Mine', {'deep': False})
    """
    name, *pairs = text.strip().split(":")
    if pairs and "=" not in pairs[0] and re.fullmatch(r"[\w.]+", name):
        name = f"{name}:{pairs.pop(0)}"
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


def for_quantity(text: str, quantity: str) -> str:
    """The predictor named ``text`` as it suits readings of ``quantity``: of power in dBm, whose
    level says nothing, one that by default takes the trained level is told to take any.

    >>> for_quantity("kriging-inferred+tx", "power"), for_quantity("kriging-inferred", "gain")
    ('kriging-inferred:level=any+tx', 'kriging-inferred')
    """
    plain = text.removesuffix("+tx")
    name, given = parse_spec(plain)
    if quantity != "power" or "level" in given or name not in PREDICTORS:
        return text
    if getattr(predictor(plain), "level", None) != "gain":
        return text
    return f"{plain}:level=any{text[len(plain) :]}"


@dataclass(frozen=True)
class Option:
    """An option that a text can give to a predictor or planner."""

    name: str
    """as it is written"""
    kinds: tuple[str, ...]
    """what a value may be: of ``bool``, ``int``, ``float``, ``str``, ``None``, or the words that
    are allowed"""
    default: Any
    """when left out"""
    text: str
    """its meaning"""

    @property
    def allowed(self) -> str:
        """What a value may be, in words."""
        return " or ".join(_WORDS.get(kind, kind.lower()) for kind in self.kinds)

    def takes(self, value: Any) -> bool:
        """Whether ``value`` is one that the factory declares."""
        kind = type(value).__name__.removesuffix("Type")
        if kind == "int" and "float" in self.kinds:
            return True
        words = [one for one in self.kinds if one not in (*_WORDS, "None")]
        return kind in self.kinds or value in words


def options_of(factory: Callable[..., Any]) -> list[Option]:
    """What ``factory``, a dataclass or a function that passes options on to one, can be told by
    text. Parameters that only Python can give (a fitted model, a callback) are left out."""
    found: dict[str, Option | None] = {}
    made: Any = factory
    if not inspect.isclass(factory):
        for one in inspect.signature(factory).parameters.values():
            if one.kind is not one.VAR_KEYWORD:
                _add(found, one.name, str(one.annotation), one.default, "")
        name = str(inspect.signature(factory).return_annotation)
        made = getattr(factory, "__globals__", {}).get(name)
        found |= dict.fromkeys(_set_by(factory) - set(found))
    if dataclasses.is_dataclass(made) and isinstance(made, type):
        texts: dict[str, str] = {}
        for base in reversed(made.__mro__):
            if "__annotations__" in vars(base) and dataclasses.is_dataclass(base):
                texts |= field_texts(base)
        for field in dataclasses.fields(made):
            if field.init and field.name not in found:
                _add(found, field.name, str(field.type), field.default, texts.get(field.name, ""))
    return [option for option in found.values() if option is not None]


def _set_by(factory: Callable[..., Any]) -> set[str]:
    """Options that a function gives by itself to what it makes, so that nobody else can."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(factory)))
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    return {word.arg for call in calls for word in call.keywords if word.arg}


def _add(found: dict[str, Option | None], name: str, kind: str, default: Any, text: str) -> None:
    words = re.findall(r"[\"'](.*?)[\"']", kind)
    kinds = [one.strip() for one in re.sub(r"Literal\[.*?\]", "", kind).split("|")]
    known = tuple(one for one in kinds if one in (*_WORDS, "None"))
    if words or known not in ((), ("None",)):
        default = None if default in (MISSING, inspect.Parameter.empty) else default
        found[name] = Option(name, (*known, *words), default, text)


@lru_cache(maxsize=64)
def _cached(registry: Registry[Any], base: type, text: str) -> Any:
    """Built once per process: predictors and planners hold settings and weights, never a survey's
    state."""
    return _made(registry, base, text, {})


def _made(registry: Registry[Any], base: type, text: str, more: dict[str, Any]) -> Any:
    name, options = parse_spec(text)
    plain = name.partition(":")[0]
    if plain != name and plain in registry:
        raise InputError(
            f"cannot read the option {name.partition(':')[2]!r} of {text!r}; write options as "
            "name:key=value:key=value"
        )
    factory = registry.factory(name)
    known = {option.name: option for option in options_of(factory)}
    for key, value in options.items():
        if key not in known:
            takes = did_you_mean(key, known) if known else "it takes none"
            raise InputError(f"{registry.kind} {name!r} has no option {key!r}; {takes}")
        if not known[key].takes(value):
            raise InputError(
                f"{key} of {registry.kind} {name!r} must be {known[key].allowed}, got {value!r}"
            )
    try:
        made = factory(**options, **more)
    except TypeError as error:
        raise InputError(
            f"{registry.kind} {name!r} does not take these options ({error}); see: skygain methods "
            f"{name}"
        ) from error
    if not isinstance(made, base):
        raise InputError(
            f"{name!r} makes a {type(made).__name__}, not a {registry.kind}; derive it from "
            f"{base.__module__}:{base.__name__}"
        )
    return made


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
        return _cached(PREDICTORS, Predictor, self.predictor.removesuffix("+tx"))

    def build_planner(self) -> Planner:
        """The planner."""
        return _cached(PLANNERS, Planner, self.planner)

    def visible(self, scenario: Scenario, predictor: Predictor) -> Scenario:
        """What the method may know: the transmitter only if it needs it, or was written with
        ``+tx``."""
        if predictor.transmitter == "required" or self.predictor.endswith("+tx"):
            return scenario
        return scenario.without_transmitter()
