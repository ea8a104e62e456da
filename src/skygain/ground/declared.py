"""Requests: what a caller may ask for, declared once as a frozen dataclass.

A field is one line of code and one docstring. From them come the constructor in Python, the keys of
a TOML or JSON file, the options of a command and their help. A request is put together from groups
by inheritance: every base class is a group, the first line of its docstring is the group's heading.
"""

from __future__ import annotations

__all__ = ["Asked", "Request", "field_texts", "named", "part"]

import ast
import dataclasses
import inspect
import re
import textwrap
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self

from skygain.ground.errors import InputError, did_you_mean


def named(
    default: Any = MISSING,
    *,
    flag: str | None = None,
    scale: float = 1.0,
    argument: bool = False,
    names: str | None = None,
    stored: bool = True,
) -> Any:
    """A field of a request that says more than its default.

    Args:
        default: value when left out; without one the field has to be given.
        flag: name of the option without dashes; otherwise the field's name without ``_m``.
        scale: what one unit of the option is in units of the field (1e9 for GHz and Hz).
        argument: given by its place on the command line, not by an option.
        names: ``"module:registry"`` whose names a shell may complete.
        stored: whether results keep it, so that the same request can be made again.
    """
    told = {"flag": flag, "scale": scale, "argument": argument, "names": names, "stored": stored}
    return dataclasses.field(default=default, metadata=told)


@dataclass(frozen=True)
class Asked:
    """One field of a request, as an interface shows it."""

    name: str
    """its name in Python and in files"""
    kind: Any
    """its type, without ``None``"""
    default: Any
    """its default, ``MISSING`` when it has to be given"""
    text: str
    """its docstring"""
    group: str
    """heading of the class that declares it"""
    flag: str
    """name of its option, without dashes"""
    scale: float
    """see `named`"""
    argument: bool
    """see `named`"""
    names: str | None
    """see `named`"""

    @property
    def several(self) -> bool:
        """Whether it holds any number of files, so that its option may be repeated."""
        return self.kind == tuple[Path, ...]


@dataclass(frozen=True, kw_only=True)
class Request:
    """Base of all requests: values from Python, files and command lines become what the fields'
    types say, then every group checks its own.

    A group that has something to check defines ``check(self)``.
    """

    runs: ClassVar[str] = ""
    """``"module:function"`` that serves it; called with the request and a progress display"""

    def __post_init__(self) -> None:
        for asked in self.asked():
            object.__setattr__(self, asked.name, _converted(getattr(self, asked.name), asked))
        for group in type(self).__mro__:
            if check := vars(group).get("check"):
                check(self)

    @classmethod
    @cache
    def asked(cls) -> tuple[Asked, ...]:
        """Every field with its help, group by group in the order in which the groups are named."""
        return tuple(_asked(cls))

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """The request with these values, keyed by the fields' names.

        Raises:
            InputError: a key is no field, a value cannot be used, or a required one is absent.
        """
        fields = {asked.name: asked for asked in cls.asked()}
        for key in values:
            if key not in fields:
                raise InputError(f"there is no setting {key!r}; {did_you_mean(key, fields)}")
        for asked in fields.values():
            if asked.default is MISSING and values.get(asked.name) is None:
                raise InputError(f"`{asked.name}` is missing; it is {asked.text}")
        return cls(**values)

    def stored(self) -> dict[str, Any]:
        """The values that results keep: what was asked for, not where it was written."""
        return {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.metadata.get("stored", True)
        }


def part(request: Request, group: type[Request]) -> dict[str, Any]:
    """The values of those fields that ``group`` itself declares, by name."""
    return {name: getattr(request, name) for name in vars(group).get("__annotations__", {})}


def _asked(cls: type[Request]) -> list[Asked]:
    hints = typing.get_type_hints(cls)
    found = []
    for owner in _in_order(cls):
        texts, heading = field_texts(owner), inspect.cleandoc(owner.__doc__ or "").split("\n")[0]
        for field in dataclasses.fields(owner):
            if field.name not in vars(owner).get("__annotations__", {}):
                continue
            told = field.metadata
            default = field.default
            if field.default_factory is not MISSING:
                default = field.default_factory()
            kind = hints[field.name]
            if isinstance(kind, types.UnionType):
                kind = next(one for one in typing.get_args(kind) if one is not types.NoneType)
            found.append(
                Asked(
                    field.name,
                    kind,
                    default,
                    texts.get(field.name, ""),
                    "" if owner is cls else heading.rstrip("."),
                    told.get("flag") or field.name.removesuffix("_m").replace("_", "-"),
                    told.get("scale", 1.0),
                    told.get("argument", False),
                    told.get("names"),
                )
            )
    return found


def _in_order(cls: type) -> list[type]:
    """The classes that declare fields: the bases from left to right, what they build on first."""
    order: list[type] = []
    for base in cls.__bases__:
        if base is not Request and issubclass(base, Request):
            order += [one for one in _in_order(base) if one not in order]
    return [*order, cls]


def field_texts(cls: type) -> dict[str, str]:
    """The docstring under each field of ``cls``, on one line; none where its source is not kept, as
    that of a class typed into a notebook."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]
    except (OSError, TypeError):
        return {}
    assert isinstance(tree, ast.ClassDef)
    texts = {}
    for line, below in zip(tree.body, tree.body[1:], strict=False):
        if (
            isinstance(line, ast.AnnAssign)
            and isinstance(line.target, ast.Name)
            and isinstance(below, ast.Expr)
            and isinstance(below.value, ast.Constant)
        ):
            texts[line.target.id] = " ".join(str(below.value.value).split())
    return texts


def _converted(value: Any, asked: Asked) -> Any:
    """``value`` as the field's type; a text is read as the command line writes it."""
    if value is None and asked.default is None:
        return None
    try:
        return _as_kind(value, asked.kind)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"`{asked.name}` must be {_in_words(asked.kind)}, got {value!r}") from None


def _as_kind(value: Any, kind: Any) -> Any:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is bool:
        if isinstance(value, bool):
            return value
        return ("false", "true").index(_text(value).lower()) == 1
    if kind is int:
        if isinstance(value, str):
            return int(value)
        if isinstance(value, bool) or int(value) != value:
            raise ValueError
        return int(value)
    if kind is float:
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    if kind is Path:
        return Path(value)
    if kind is str:
        if isinstance(value, Sequence) and not isinstance(value, str):
            return ",".join(map(str, value))
        return _text(value)
    if origin is tuple:
        one = inner[0]
        parts: list[Any]
        if one is Path:
            parts = [value] if isinstance(value, str | Path) else list(value)
        else:
            parts = _split(value) if isinstance(value, str) else list(value)
        if inner[-1] is not Ellipsis and len(parts) != len(inner):
            raise ValueError
        return tuple(_as_kind(each, one) for each in parts)
    if origin is dict:
        if isinstance(value, str):
            pairs = [each.partition("=") for each in _split(value)]
            if not all(key.strip() and sign for key, sign, _ in pairs):
                raise ValueError
            return {_bare(key): _bare(each) for key, _, each in pairs}
        return {str(key): str(each) for key, each in dict(value).items()}
    raise TypeError(f"a request cannot hold {kind}")


def _bare(text: str) -> str:
    return text.strip().strip('"')


def _text(value: Any) -> str:
    if not isinstance(value, str | int | float | Path):
        raise TypeError
    return str(value)


def _split(text: str) -> list[str]:
    """Parts between commas; what stands in double quotes may hold commas."""
    return [each.strip() for each in re.findall(r'(?:"[^"]*"|[^,"])+', text) if each.strip()]


def _in_words(kind: Any) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is tuple and inner[-1] is not Ellipsis:
        return f"{len(inner)} numbers separated by commas"
    words = {
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        str: "a text",
        Path: "a path",
        tuple[str, ...]: "names separated by commas",
        tuple[Path, ...]: "one path or several",
        dict[str, str]: "name=value,name=value",
    }
    return words.get(kind, str(kind))
