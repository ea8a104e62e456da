"""A request from a file: TOML, JSON, or the results of an earlier run."""

from __future__ import annotations

__all__ = ["read_config"]

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skygain.ground.declared import Request
from skygain.ground.errors import InputError

_ADDED = ("skygain", "commit")
"""what results say beside the request"""


def read_config(request: type[Request], path: Path) -> dict[str, Any]:
    """The values in ``path`` by field name, ready for `Request.of`.

    A table whose name is no field only groups what it holds; ``noise-db`` means ``noise_db``. Of
    ``results.json`` the request that was flown is read.

    Raises:
        InputError: the file cannot be read, or holds no settings.
    """
    try:
        text = path.read_text(encoding="utf-8")
        found = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read {path}: {getattr(error, 'strerror', error)}") from None
    except (tomllib.TOMLDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"cannot read {path}: {error}; give TOML (.toml) or JSON") from None
    if not isinstance(found, Mapping):
        raise InputError(f"{path} holds no settings; write name = value, or give a results.json")
    if isinstance(found.get("config"), Mapping):
        found = {key: value for key, value in found["config"].items() if key not in _ADDED}
    return _flat(found, {asked.name for asked in request.asked()})


def _flat(found: Mapping[str, Any], names: set[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key, value in found.items():
        name = str(key).replace("-", "_")
        if isinstance(value, Mapping) and name not in names:
            values |= _flat(value, names)
        elif value is not None:
            values[name] = value
    return values
