"""A file that grows line by line and survives any death of its writer.

The first line says what the journal belongs to; each later line is one JSON record, on the disk
before `Journal.append` returns. Each carries a checksum, ``crc``, so that damage is told. One
process writes at a time.
"""

from __future__ import annotations

__all__ = ["Journal", "locked"]

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from zlib import crc32

from skygain.ground.errors import InputError
from skygain.ground.files import full_disk, unwritable
from skygain.ground.strict_json import plain

try:
    import fcntl
except ImportError:  # Windows has other locks; there two writers are not told of each other
    fcntl = None  # type: ignore[assignment]


@contextlib.contextmanager
def locked(path: str | os.PathLike[str]) -> Iterator[None]:
    """Hold an existing file or folder for the length of the block; the hold ends with the process.

    Nothing is written. On Windows nobody is kept out.

    Raises:
        InputError: another run holds it.
    """
    with contextlib.ExitStack() as at_exit:
        if fcntl is not None:
            handle = os.open(path, os.O_RDONLY)
            at_exit.callback(os.close, handle)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"{path} is in use by another run; wait for it to end, or give another `out`"
                ) from None
        yield


class Journal:
    """Records of one piece of work; see the module. Use it as a context manager.

    Args:
        path: the file; it is made when absent.
        belongs_to: what the records depend on. A journal of something else is refused.
        anew: how to begin anew, for the message of that refusal.

    Raises:
        InputError: another process writes it, it belongs to something else, or a line other than
            the last is damaged.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "flight.jsonl"
    ...     with Journal(path, {"seed": 1}) as journal:
    ...         journal.append({"step": 0})
    ...     with Journal(path, {"seed": 1}) as journal:
    ...         journal.records
    [{'step': 0}]
    """

    def __init__(
        self, path: str | os.PathLike[str], belongs_to: Mapping[str, Any], *, anew: str = ""
    ) -> None:
        self.path = Path(path)
        self._anew = anew or f"delete {self.path}"
        self._exit = contextlib.ExitStack()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("a+b", buffering=0)
        except OSError as error:
            raise unwritable(self.path, error) from error
        self._exit.callback(self._file.close)
        try:
            self._exit.enter_context(locked(self.path))
            header = {"belongs_to": plain(dict(belongs_to))}
            lines, whole = self._read()
            if lines:
                self._check(lines[0], header["belongs_to"])
            self._file.truncate(whole)
            self.records: list[dict[str, Any]] = lines[1:]
            """what was written so far"""
            if not lines:
                self._write(header)
        except BaseException:
            self._exit.close()
            raise

    @staticmethod
    def header(path: str | os.PathLike[str]) -> dict[str, Any]:
        """What the journal at ``path`` belongs to.

        Raises:
            InputError: there is no such journal.
        """
        try:
            with Path(path).open("rb") as file:
                return dict(json.loads(file.readline())["belongs_to"])
        except (OSError, ValueError, KeyError, TypeError):
            raise InputError(f"{path} is no journal of a run that can go on") from None

    def append(self, record: Mapping[str, Any]) -> None:
        """Add ``record``; it is on the disk when this returns.

        Raises:
            InputError: the disk is full or cannot be written to; nothing of the record is kept.
        """
        self._write(plain(dict(record)))
        self.records.append(dict(record))

    def close(self) -> None:
        """Let others write."""
        self._exit.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, record: Mapping[str, Any]) -> None:
        line = (_text({**record, "crc": crc32(_text(record).encode())}) + "\n").encode()
        before = self._file.seek(0, os.SEEK_END)
        try:
            rest = memoryview(line)
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(before)
            if full_disk(error):
                raise unwritable(self.path, error) from error
            raise

    def _read(self) -> tuple[list[dict[str, Any]], int]:
        """Every whole line, and where the last of them ends; a kill may have cut the next one."""
        self._file.seek(0)
        text = self._file.readall()
        whole = text.rfind(b"\n") + 1
        lines = []
        for number, line in enumerate(text[:whole].split(b"\n")[:-1], start=1):
            try:
                record = json.loads(line)
                if record.pop("crc") != crc32(_text(record).encode()):
                    raise ValueError
                lines.append(record)
            except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
                raise InputError(
                    f"line {number} of {self.path} is damaged; to begin anew, {self._anew}"
                ) from None
        return lines, whole

    def _check(self, header: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
        held = header.get("belongs_to")
        if held == wanted:
            return
        if not isinstance(held, dict):
            raise InputError(f"{self.path} is no journal; to begin anew, {self._anew}")
        names = sorted(
            key for key in {*held, *wanted} if held.get(key, None) != wanted.get(key, None)
        )
        raise InputError(
            f"{self.path} belongs to other work: {', '.join(names)} changed; to begin anew, "
            f"{self._anew}"
        )


def _text(record: Mapping[str, Any]) -> str:
    return json.dumps(record, ensure_ascii=False, allow_nan=False)
