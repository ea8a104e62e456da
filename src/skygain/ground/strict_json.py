"""JSON that every reader accepts: no NaN, nothing but plain values, in an order that does not
change."""

from __future__ import annotations

__all__ = ["holds", "json_text", "plain"]

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def json_text(content: Any) -> str:
    """Strict JSON that a person can read: keys sorted, two spaces a level, a list of plain values
    on one line, NaN as ``null``.

    Arrays, tuples, dataclasses, paths and NumPy numbers become what they stand for.

    Raises:
        TypeError: ``content`` holds something JSON cannot say.

    >>> print(json_text({"rmse_db": np.float32(0.5), "nll": [1.0, float("nan")]}), end="")
    {
      "nll": [1.0, null],
      "rmse_db": 0.5
    }
    """
    return _pretty(plain(content), "") + "\n"


def holds(path: Path, *keys: str) -> bool:
    """Whether the file ``path`` is a JSON object with all of these keys."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.keys() >= set(keys)


def plain(value: Any) -> Any:
    """``value`` in nothing but dictionaries with string keys, lists, strings, finite numbers,
    booleans and ``None``."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [
            plain(item) for item in (sorted(value) if isinstance(value, set | frozenset) else value)
        ]
    raise TypeError(
        f"JSON has no way to say {value!r} of type {type(value).__name__}; give plain values"
    )


def _pretty(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [
            f"{inner}{json.dumps(key, ensure_ascii=False)}: {_pretty(value[key], inner)}"
            for key in sorted(value)
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(inner + _pretty(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
