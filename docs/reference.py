"""Write the API reference out of the docstrings, without a network.

    python docs/reference.py [FOLDER]

Every module of Skygain that can be imported here has a page; those that need PyTorch or another
extra that is not installed are named.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
import warnings
from pathlib import Path

import pdoc

import skygain


def modules() -> tuple[list[str], list[str]]:
    """Names of the modules that can be imported here, and of those that cannot."""
    found, left = ["skygain"], []
    for info in pkgutil.walk_packages(skygain.__path__, "skygain.", onerror=lambda name: None):
        if info.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(info.name)
        except ImportError:
            left.append(info.name)
        else:
            found.append(info.name)
    return found, left


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "reference")
    found, left = modules()
    warnings.filterwarnings("ignore", module="pdoc")  # it tells what was left out once more
    pdoc.render.configure(docformat="google", show_source=False)
    pdoc.pdoc(*found, *(f"!{name}" for name in left), output_directory=folder)
    print(f"{len(found)} modules: {folder / 'index.html'}")
    if left:
        print(f"left out, as what they need is not installed: {', '.join(left)}")
