"""How far a long command is: a bar in a terminal, a line now and then in a pipe."""

from __future__ import annotations

__all__ = ["SILENT", "Progress", "shown_progress"]

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_FIRST_S, _MOST_S = 1.0, 30.0
"""in a pipe a line comes after the first time, then after twice as long each, up to the second"""


class Progress:
    """Takes what a command tells of itself; this one shows nothing."""

    def phase(self, name: str) -> None:
        """What is done from now on, e.g. "reading the city"."""

    def __call__(self, done: int, total: int, text: str = "") -> None:
        """``done`` of ``total`` parts of the phase are finished; ``text`` says how it goes."""

    def note(self, line: str) -> None:
        """What should be known now, before the rest is waited for."""


SILENT = Progress()
"""shows nothing"""


@contextmanager
def shown_progress(label: str, words: Callable[[str], str] = str) -> Iterator[Progress]:
    """A display on standard error, with the time left where it can be told; ``words`` puts notes
    into the language of the command line."""
    if sys.stderr.isatty():
        with _terminal(label, words) as shown:
            yield shown
    else:
        with _Lines(label, words) as lines:
            yield lines


@contextmanager
def _terminal(label: str, words: Callable[[str], str]) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:

        class Shown(Progress):
            task = bar.add_task(label, total=None, text="")

            def phase(self, name: str) -> None:
                bar.remove_task(self.task)
                self.task = bar.add_task(f"{label}: {name}", total=None, text="")

            def __call__(self, done: int, total: int, text: str = "") -> None:
                bar.update(self.task, completed=done, total=total, text=text)

            def note(self, line: str) -> None:
                bar.console.print(words(line), markup=False, highlight=False)

        yield Shown()


class _Lines(Progress):
    """Lines for a pipe or a log, from a thread: there is news also while one step takes minutes."""

    def __init__(self, label: str, words: Callable[[str], str] = str) -> None:
        self._label, self._words = label, words
        self._name, self._state = "", (0, 0, "")
        self._began = time.monotonic()
        self._pause = _FIRST_S
        self._last = ""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def phase(self, name: str) -> None:
        self._name, self._state, self._began = name, (0, 0, ""), time.monotonic()

    def __call__(self, done: int, total: int, text: str = "") -> None:
        self._state = (done, total, text)

    def note(self, line: str) -> None:
        print(self._words(line), file=sys.stderr, flush=True)

    def __enter__(self) -> _Lines:
        self._thread.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(self._pause):
            line = self._line()
            if line and line != self._last:
                print(line, file=sys.stderr, flush=True)
                self._last = line
            self._pause = min(_MOST_S, 2 * self._pause)

    def _line(self) -> str:
        done, total, text = self._state
        if not (self._name or total):
            return ""
        parts = [f"{self._label}: {self._name}" if self._name else f"{self._label}:"]
        if total:
            parts.append(f"{done}/{total}")
            if 0 < done < total:
                left = (time.monotonic() - self._began) * (total - done) / done
                parts.append(f"{_span(left)} left")
        return ", ".join([" ".join(parts), text]) if text else " ".join(parts)


def _span(seconds: float) -> str:
    """A duration as people say it.

    >>> _span(42.4), _span(130), _span(7300)
    ('42 s', '2 min', '2 h 02 min')
    """
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"
