"""A mission's folder: what was asked, the journal, the files for the vehicles, and the map.

    mission.toml      the request
    journal.sqlite    everything that happened
    sorties/001/      files for the vehicles and the crew
    map/              the map so far

The journal is the truth. Everything else is written from it, in one step each, so that any command
can be killed and given again.
"""

from __future__ import annotations

__all__ = ["Mission", "made", "swapped_in"]

import contextlib
import json
import os
import shutil
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write, file_digest, unwritable, writable_folder
from skygain.ground.journal import locked
from skygain.missions.journal import Journal
from skygain.missions.requests import MissionNewRequest
from skygain.missions.site import Site, open_site
from skygain.missions.sortie import Sortie
from skygain.survey.methods import MethodSpec

_FILES = ("area", "no_fly")
_TEXTS = ("city", "terrain")
_AUTO = "kriging-blind"


@dataclass(frozen=True, eq=False)
class Mission:
    """One mission, open for reading."""

    folder: Path
    """where it lies"""
    request: MissionNewRequest
    """what was asked for"""
    journal: Journal
    """what happened"""

    @classmethod
    @contextlib.contextmanager
    def opened(cls, folder: Path) -> Iterator[Mission]:
        """The mission in ``folder``.

        Raises:
            InputError: there is none, or its files cannot be read.
        """
        path = folder / "mission.toml"
        if not path.is_file():
            raise InputError(f"{folder} holds no mission; begin one with: skygain mission new")
        try:
            values = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"cannot read {path}: {error}") from None
        request = MissionNewRequest.of({**values, "folder": folder})
        with Journal(folder / "journal.sqlite") as journal:
            yield cls(folder, request, journal)

    @cached_property
    def site(self) -> Site:
        """Where it takes place.

        Raises:
            InputError: a file of the mission changed or is gone.
        """
        begun = self.journal.events("begun")
        for path, digest in begun[0]["files"].items() if begun else ():
            if not Path(path).is_file():
                raise InputError(f"{path}, which this mission was made from, is gone; put it back")
            if file_digest(path) != digest:
                raise InputError(
                    f"{path} changed since this mission was made; put it back, or begin a new "
                    "mission"
                )
        return open_site(self.request)

    @property
    def method(self) -> MethodSpec:
        """Predictor and planner."""
        predictor = self.request.predictor
        return MethodSpec(_AUTO if predictor == "auto" else predictor, self.request.planner)

    def sorties(self) -> list[Sortie]:
        """Every sortie as it was last planned, by number."""
        last: dict[int, Sortie] = {}
        for event in self.journal.events("planned"):
            sortie = Sortie.of(event["sortie"])
            last[sortie.number] = sortie
        return [last[number] for number in sorted(last)]

    def flown(self) -> set[int]:
        """Numbers of the sorties that readings came from."""
        return {one.sortie for one in self.journal.readings() if one.sortie > 0}

    def random(self, number: int) -> np.random.Generator:
        """The planner's randomness in one sortie."""
        return np.random.default_rng([self.request.seed, number])

    @contextlib.contextmanager
    def writing(self, doing: str) -> Iterator[None]:
        """Keep other processes from writing for the length of the block.

        Raises:
            InputError: another one writes; it says which.
        """
        with held(self.folder, doing):
            yield


@contextlib.contextmanager
def held(folder: Path, doing: str) -> Iterator[None]:
    """Hold a mission's folder for ``doing``; see `Mission.writing`."""
    note = folder / ".holder"
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(folder))
        except InputError:
            who = "another process"
            with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
                told = json.loads(note.read_text(encoding="utf-8"))
                who = f"`{told['doing']}` (process {told['process']}, since {told['since']})"
            raise InputError(
                f"{folder} is held by {who.replace('`', '')}; wait for it to end"
            ) from None
        told = {"doing": doing, "process": os.getpid(), "since": time.strftime("%H:%M:%S")}
        with atomic_write(note) as tmp:
            tmp.write_text(json.dumps(told), encoding="utf-8")
        stack.callback(note.unlink, missing_ok=True)
        yield


def made(request: MissionNewRequest) -> Path:
    """Make the folder of a new mission and write what was asked for; its journal is last, so that a
    folder with one is whole.

    Raises:
        InputError: the folder holds a mission or anything else, or cannot be written.
    """
    folder = request.folder
    if (folder / "journal.sqlite").exists():
        raise InputError(f"{folder} holds a mission already; give another `folder`")
    if folder.exists() and any(p.name not in _OURS for p in folder.iterdir()):
        raise InputError(f"{folder} is not empty; give another `folder`")
    writable_folder(folder)
    values = {k: v for k, v in request.stored().items() if v is not None}
    for name in (*_FILES, *_TEXTS):
        if name in values and Path(values[name]).is_file():
            values[name] = str(Path(values[name]).resolve())
    files = {
        str(values[name]): file_digest(values[name])
        for name in (*_FILES, *_TEXTS)
        if name in values and Path(values[name]).is_file()
    }
    with atomic_write(folder / "mission.toml") as tmp:
        tmp.write_text(_toml(values), encoding="utf-8")
    draft = folder / ".journal.tmp"
    for old in folder.glob(".journal.tmp*"):
        old.unlink()
    with Journal(draft, create=True) as journal:
        journal.add("begun", {"files": files, "command": sys.argv[1:3]})
        journal.settled()
    try:
        os.replace(draft, folder / "journal.sqlite")
    except OSError as error:
        raise unwritable(folder / "journal.sqlite", error) from error
    return folder


_OURS = frozenset(
    ("mission.toml", ".journal.tmp", ".journal.tmp-wal", ".journal.tmp-shm", ".holder")
)


@contextlib.contextmanager
def swapped_in(folder: Path) -> Iterator[Path]:
    """An empty folder beside ``folder`` that takes its place when the block ends well."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    for old in folder.parent.glob(f".{folder.name}-*"):
        shutil.rmtree(old, ignore_errors=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    draft.chmod(0o755)
    try:
        yield draft
        gone = folder.parent / f".{folder.name}-old"
        if folder.exists():
            os.replace(folder, gone)
        os.replace(draft, folder)
        shutil.rmtree(gone, ignore_errors=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _toml(values: Mapping[str, Any]) -> str:
    """The request as TOML: one line for each value, tables for dictionaries."""
    lines = ["# what was asked for; made by: skygain mission new"]
    tables = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            tables += ["", f"[{name}]"]
            tables += [
                f"{_toml_value(str(key))} = {_toml_value(str(one))}" for key, one in value.items()
            ]
        else:
            lines.append(f"{name} = {_toml_value(value)}")
    return "\n".join([*lines, *tables]) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml_value(one) for one in value) + "]"
    return json.dumps(str(value), ensure_ascii=False)
