"""Things that can be chosen by name: predictors, planners, propagation models.

A registry stores either an object or the text ``"package.module:attribute"``. The text is resolved
when the name is asked for, so that nothing is loaded before it is needed. Other packages add names
by an entry point of the registry's group; ``package.module:attribute`` needs no registration.
"""

from __future__ import annotations

__all__ = ["Registry"]

import importlib
import importlib.metadata
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

from skygain.ground.errors import InputError, did_you_mean

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

    def __init__(self, kind: str, group: str | None = None) -> None:
        self.kind = kind
        self._group = group
        self._factories: dict[str, Callable[..., T] | str] = {}

    def register(self, name: str, factory: Callable[..., T] | str) -> None:
        """Make ``factory`` (a callable, or ``"module:attribute"``) available as ``name``; a taken
        name is an error."""
        if name in self._factories:
            raise ValueError(f"{self.kind} {name!r} is already registered; choose another name")
        self._factories[name] = factory

    def names(self) -> list[str]:
        """All known names, sorted; those that other packages bring included."""
        return sorted({*self._factories, *self._brought()})

    def _brought(self) -> dict[str, str]:
        """What entry points of other packages bring, by name."""
        if self._group is None:
            return {}
        return {e.name: e.value for e in importlib.metadata.entry_points(group=self._group)}

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def __contains__(self, name: object) -> bool:
        return name in self._factories or name in self._brought()

    def factory(self, name: str) -> Callable[..., T]:
        """The callable behind ``name``, or behind the text ``"package.module:attribute"``.

        Raises:
            InputError: there is no such name, module or attribute; the message lists the names.
        """
        found = self._factories.get(name) or self._brought().get(name)
        if found is None and ":" in name:
            found = name
        if found is None:
            raise InputError(f"unknown {self.kind} {name!r}; {did_you_mean(name, self.names())}")
        if isinstance(found, str):
            found = _loaded(found) if name in self._factories else self._foreign(name, found)
            self._factories[name] = found
        return found

    def _foreign(self, name: str, path: str) -> Callable[..., T]:
        """A factory from outside; modules in the working folder are found too."""
        here = os.getcwd()
        if here not in sys.path:
            sys.path.append(here)
        try:
            found = _loaded(path)
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"cannot load the {self.kind} {name!r} ({error}); write package.module:Class, or a "
                f"known name: {', '.join(self.names())}"
            ) from error
        if not callable(found):
            raise InputError(f"{self.kind} {name!r} cannot be called; name a class or a function")
        return found

    def create(self, name: str, **options: Any) -> T:
        """Build the thing called ``name``; options go to its factory."""
        return self.factory(name)(**options)


def _loaded(path: str) -> Any:
    module, _, attribute = path.partition(":")
    return getattr(importlib.import_module(module), attribute)
