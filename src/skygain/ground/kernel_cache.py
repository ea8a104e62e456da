"""Where Numba keeps compiled kernels when neither the package nor a home can be written to.

Numba writes beside the source, else into the user's cache, and refuses to import a kernel where it
can do neither. Then a folder of the user's own in the system's temporary one is named in
``NUMBA_CACHE_DIR``, which worker processes inherit.
"""

from __future__ import annotations

__all__ = ["find_cache"]

import os
import stat
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def find_cache() -> Path | None:
    """Name a folder if Numba would find none; returns the one that was named."""
    package = Path(__file__).parents[1]
    if VARIABLE in os.environ or os.access(package, os.W_OK) or _creatable(_users_cache()):
        return None
    folder = _own_folder()
    os.environ[VARIABLE] = str(folder)
    return folder


def _users_cache() -> Path:
    """Where Numba would look; without a home this begins with ``~`` or cannot be made."""
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(os.path.expanduser(os.environ.get("LOCALAPPDATA") or base)) / "numba"


def _creatable(path: Path) -> bool:
    """Whether the folder can be made, which Numba would do next, and written to."""
    if not path.is_absolute():  # no home is known
        return False
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(path, os.W_OK)


def _own_folder() -> Path:
    """A temporary folder that nobody else can write to: what is read back from it is trusted."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"skygain-kernels-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if (
            stat.S_ISDIR(found.st_mode)
            and found.st_uid == user
            and not stat.S_IMODE(found.st_mode) & 0o022
        ):
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="skygain-kernels-"))
