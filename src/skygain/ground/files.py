"""Files that are either there in full or not there at all.

Whatever Skygain writes is first written beside its destination under another name and then renamed
onto it, which the file system does in one step. A crash, a full disk or a ``kill -9`` therefore
never leaves half a file under the name a reader looks for.
"""

from __future__ import annotations

__all__ = ["atomic_write", "file_digest", "full_disk", "unwritable", "writable_folder"]

import errno
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from skygain.ground.errors import InputError

_NO_ROOM = {errno.ENOSPC, errno.EDQUOT}


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give the body a temporary path to write to; rename it to ``path`` when the body succeeds,
    delete it when it fails.

    Missing parent folders are made. The temporary file exists (empty) when the body begins, lies in
    the same folder, starts with a dot and ends in ``.tmp``, so that libraries which choose a format
    by suffix have to be told the format.

    Raises:
        InputError: the folder cannot be made or written to, the disk is full, or ``path`` is a
            folder.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with atomic_write(Path(folder) / "deep" / "note.txt") as tmp:
    ...         _ = tmp.write_text("all or nothing")
    ...     [p.name for p in (Path(folder) / "deep").iterdir()]
    ['note.txt']
    """
    path = Path(path)
    tmp = path.parent / f".{path.name}.{uuid4().hex[:8]}.tmp"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tmp.touch(exist_ok=False)
    except OSError as error:
        raise unwritable(path, error) from error
    try:
        yield tmp
        _flush(tmp)
        try:
            os.replace(tmp, path)
        except OSError as error:
            raise unwritable(path, error) from error
    except OSError as error:
        if full_disk(error):
            raise unwritable(path, error) from error
        raise
    finally:
        tmp.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Wait until the data is on the disk, so that a power cut cannot leave the new name with no
    content."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def full_disk(error: OSError) -> bool:
    """Whether the disk, or the user's share of it, is full."""
    return error.errno in _NO_ROOM


def unwritable(path: Path, error: OSError) -> InputError:
    """The error that tells the user why ``path`` cannot be written."""
    return InputError(
        f"cannot write {path}: {error.strerror or error}; choose a folder that can be written to "
        "and has room"
    )


def file_digest(path: str | os.PathLike[str]) -> str:
    """The first 16 digits of the SHA-256 of a file's content."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def writable_folder(path: str | os.PathLike[str]) -> Path:
    """The folder ``path``, made when absent and tried out, so that long work fails before it begins
    rather than at its end.

    Raises:
        InputError: it cannot be made or written to, or it is a file.
    """
    path = Path(path)
    probe = path / f".skygain-{uuid4().hex[:8]}.tmp"
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise unwritable(path, error) from error
    return path
