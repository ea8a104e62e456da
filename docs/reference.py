"""Write the API reference out of the docstrings, without a network.

    python docs/reference.py [FOLDER]

Every module of Skygain has a page but those that need PyTorch or a training environment, where
these are not installed.
"""

from __future__ import annotations

import importlib.util
import pkgutil
import sys
from pathlib import Path

import pdoc

import skygain

NEEDS = {"training": "torch", "environments": "pettingzoo"}
"""rooms that need a package to be imported"""


def modules() -> list[str]:
    """Names of all modules that can be imported here."""
    without = {room for room, package in NEEDS.items() if importlib.util.find_spec(package) is None}
    found = (info.name for info in pkgutil.walk_packages(skygain.__path__, "skygain."))
    kept = (name for name in found if name.split(".")[1] not in without)
    return ["skygain", *(name for name in kept if not name.endswith("__main__"))]


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "reference")
    pdoc.render.configure(docformat="google", show_source=False, math=False)
    pdoc.pdoc(*modules(), output_directory=folder)
    print(f"{len(modules())} modules: {folder / 'index.html'}")
