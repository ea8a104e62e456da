"""One exception for everything a user can put right.

Anything that enters Skygain from outside (a file, a command line option, an argument of a public
function) and cannot be used raises `InputError`. Its text is a single line that says what was
expected, what came, and what to do. The command line prints that line and exits with code 2; any
other exception is a bug of ours and shows its traceback.

A parameter stands in backticks, with its value where one is advised: "give another `out`, or
`overwrite=True`". Python shows it so; the command line writes its option instead
(`skygain.app.cli`).
"""

from __future__ import annotations

__all__ = ["InputError", "MissingExtraError", "did_you_mean", "install_command", "require"]

import difflib
import importlib
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType


class InputError(ValueError):
    """Input that cannot be used; the message names the remedy."""


class MissingExtraError(InputError, ImportError):
    """An optional dependency is not installed; the message names the extra that brings it."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown ``name``: the nearest known one, and all of them.

    >>> did_you_mean("rod", ["red", "blue"])
    "did you mean 'red'? known: red, blue"
    """
    known = list(known)
    close = difflib.get_close_matches(name, known, n=1)
    return (f"did you mean {close[0]!r}? " if close else "") + f"known: {', '.join(known)}"


def install_command(extra: str = "") -> str:
    """How to install Skygain with an ``extra`` the way it was installed: from the checkout that
    this code runs from, or as a released package."""
    root = Path(__file__).resolve().parents[3]
    if not (root / "pyproject.toml").is_file():
        return f"pip install 'skygain[{extra}]'" if extra else "pip install skygain"
    scripts = Path(sysconfig.get_path("scripts"))
    pip = scripts / "pip" if root in scripts.parents else Path("pip")
    target = root / "packages" / "paper-weights" if extra == "paper" else root
    if Path.cwd() == root:
        pip = pip.relative_to(root) if root in pip.parents else pip
        target = target.relative_to(root)
    brackets = f"[{extra}]" if extra not in ("", "paper") else ""
    return f"{pip} install -e " + (f"'{target}{brackets}'" if brackets else f"{target}")


def require(module: str, extra: str) -> ModuleType:
    """Import an optional ``module``, or say which extra of Skygain installs it.

    Raises:
        MissingExtraError: the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"this needs the package {module.split('.')[0]!r}, which is not installed ({error}); "
            f"install it with: {install_command(extra)}"
        ) from error
