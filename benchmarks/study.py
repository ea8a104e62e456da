"""One harness for every study: its flags, what it measured before, its record.

    @study("few_samples", data="DATA", surveys=Option(25, "surveys of the split"))
    def few_samples(run: Run) -> list[Table]:
        ...

A study asks `Run.once` for whatever takes long. The answers are kept in surveys/benchmarks, so a
run that was killed goes on, and ``--fresh`` measures anew.
"""

from __future__ import annotations

__all__ = ["STUDIES", "Option", "Run", "Study", "machine", "main", "signed", "study"]

import argparse
import json
import os
import platform
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.record import RESULTS, Record, Table
from skygain.evaluation.statistics import Interval
from skygain.ground.errors import InputError
from skygain.ground.files import file_digest
from skygain.ground.strict_json import plain

JOURNALS = Path("surveys/benchmarks")


def machine() -> str:
    """What the study runs on, in words."""
    python = platform.python_version()
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {python}"


def signed(interval: Interval) -> str:
    """A difference with its interval."""
    return f"{interval.mean:+.2f} [{interval.low:+.2f}, {interval.high:+.2f}]"


@dataclass(frozen=True)
class Option:
    """A flag of a study."""

    default: Any
    """its value when not given; a tuple is written with commas"""
    help: str
    """what it means"""

    def parse(self, text: str) -> Any:
        """The value that ``text`` stands for, of the type of the default."""
        if isinstance(self.default, tuple):
            kind = type(self.default[0]) if self.default else str
            return tuple(kind(item) for item in text.split(","))
        return text if self.default is None else type(self.default)(text)


@dataclass
class Run:
    """One run of a study."""

    options: argparse.Namespace
    """the flags"""
    data: Path
    """the data it was given"""
    journal: Path
    """what was measured so far"""
    _known: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._content = file_digest(self.data) if self.data.is_file() else ""
        if self.journal.exists():
            for line in self.journal.read_text(encoding="utf-8").splitlines():
                try:
                    key, value = json.loads(line)
                except json.JSONDecodeError:  # the line that a kill cut off
                    continue
                self._known[key] = value

    def once(self, key: Sequence[Any], measure: Callable[[], Any]) -> Any:
        """What ``measure`` returns, as plain data; kept under ``key`` and the data's name and
        content."""
        name = json.dumps(plain([self.data.name, self._content, *key]))
        if name not in self._known:
            value = plain(measure())
            self._known[name] = value
            self.journal.parent.mkdir(parents=True, exist_ok=True)
            with self.journal.open("a", encoding="utf-8") as out:
                out.write(json.dumps([name, value]) + "\n")
            print(" ".join(str(item) for item in key), flush=True)
        return self._known[name]


@dataclass(frozen=True)
class Study:
    """A study by name."""

    name: str
    """what it is called, also the stem of its record"""
    measure: Callable[[Run], Iterable[Table]]
    """does it"""
    data: str | None
    """what its argument is called; ``None`` when it needs no data"""
    options: dict[str, Option]
    """its flags"""

    @property
    def summary(self) -> str:
        """The first sentence of its docstring."""
        return " ".join((self.measure.__doc__ or "").split("\n\n")[0].split())

    def parser(self) -> argparse.ArgumentParser:
        """Its command line."""
        parser = argparse.ArgumentParser(
            f"python -m benchmarks {self.name}",
            description=self.measure.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if self.data:
            parser.add_argument("data", metavar=self.data, type=Path)
        for name, option in self.options.items():
            default = option.default
            shown = ",".join(map(str, default)) if isinstance(default, tuple) else default
            parser.add_argument(
                f"--{name.replace('_', '-')}",
                default=default,
                type=option.parse,
                help=f"{option.help} (default: {shown})".replace("%", "%%"),
            )
        parser.add_argument("--fresh", action="store_true", help="forget what was measured before")
        parser.add_argument("--name", default=self.name, help="of the record that is written")
        parser.add_argument("--results", default=RESULTS, type=Path, help="folder of the record")
        return parser

    def command(self, options: argparse.Namespace) -> str:
        """The command that asks for ``options`` again."""
        words = ["python", "-m", "benchmarks", self.name, *([self.data] if self.data else [])]
        if options.name != self.name:
            words += ["--name", options.name]
        for name, option in self.options.items():
            value = getattr(options, name)
            if value != option.default:
                text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
                words += [f"--{name.replace('_', '-')}", shlex.quote(text)]
        return " ".join(words)

    def main(self, arguments: Sequence[str]) -> None:
        """Run it and write its record, unless it wrote records of its own."""
        parser = self.parser()
        options = parser.parse_args(arguments)
        data = getattr(options, "data", Path(""))
        journal = JOURNALS / f"{options.name}.jsonl"
        if options.fresh:
            journal.unlink(missing_ok=True)
        try:
            tables = list(self.measure(Run(options, data, journal)))
        except InputError as error:
            parser.error(str(error))
        if tables:
            found = Record(options.name, self.command(options), tables, data.name, machine())
            found.write(options.results)
            print("\n" + found.markdown())


STUDIES: dict[str, Study] = {}


def study(name: str, data: str | None = None, **options: Option) -> Callable[..., Any]:
    """Register the function below as a study."""

    def register(measure: Callable[[Run], Iterable[Table]]) -> Callable[[Run], Iterable[Table]]:
        STUDIES[name] = Study(name, measure, data, options)
        return measure

    return register


def main(arguments: Sequence[str]) -> None:
    """List the studies, or run one."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print("python -m benchmarks NAME [DATA] [--help]\n")
        width = max(map(len, STUDIES))
        print("\n".join(f"{name:{width}}  {found.summary}" for name, found in STUDIES.items()))
        return
    if arguments[0] not in STUDIES:
        known = ", ".join(STUDIES)
        raise SystemExit(f"no study is called {arguments[0]!r}; known: {known}")
    STUDIES[arguments[0]].main(arguments[1:])
