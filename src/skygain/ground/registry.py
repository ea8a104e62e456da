"""Things that can be chosen by name: predictors, planners, propagation models.

A registry stores either an object or the text ``"package.module:attribute"``. The text is resolved
when the name is asked for, so that naming a deep predictor on the command line is the first thing
that loads PyTorch.
"""

from __future__ import annotations

__all__ = ["Registry"]

import difflib
import importlib
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from skygain.ground.errors import InputError

T = TypeVar("T")


class Registry(Generic[T]):
    """Factories of one kind of thing, by name.

    >>> colours = Registry[str]("colour")
    >>> colours.register("red", lambda: "#f00")
    >>> colours.create("red")
    '#f00'
    >>> colours.create("rod")
    Traceback (most recent call last):
        ...
    skygain.ground.errors.InputError: unknown colour 'rod'; did you mean 'red'? known: red
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._factories: dict[str, Callable[..., T] | str] = {}

    def register(self, name: str, factory: Callable[..., T] | str) -> None:
        """Make ``factory`` (a callable, or ``"module:attribute"``) available as ``name``; a taken
        name is an error."""
        if name in self._factories:
            raise ValueError(f"{self.kind} {name!r} is already registered; choose another name")
        self._factories[name] = factory

    def names(self) -> list[str]:
        """All known names, sorted."""
        return sorted(self._factories)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __contains__(self, name: object) -> bool:
        return name in self._factories

    def factory(self, name: str) -> Callable[..., T]:
        """The callable behind ``name``.

        Raises:
            InputError: nothing is registered under that name; the message lists what is.
        """
        if name not in self._factories:
            close = difflib.get_close_matches(name, self.names(), n=1)
            hint = f" did you mean {close[0]!r}?" if close else ""
            raise InputError(
                f"unknown {self.kind} {name!r};{hint} known: {', '.join(self.names())}"
            )
        found = self._factories[name]
        if isinstance(found, str):
            module, _, attribute = found.partition(":")
            found = getattr(importlib.import_module(module), attribute)
            self._factories[name] = found
        return found

    def create(self, name: str, **options: Any) -> T:
        """Build the thing called ``name``; options go to its factory."""
        return self.factory(name)(**options)
