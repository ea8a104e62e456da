"""How far a long command is: a bar in a terminal, a line now and then in a pipe."""

from __future__ import annotations

__all__ = ["Progress", "progress"]

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Progress = Callable[[int, int, str], None]
"""told (done, in all, text)"""


@contextmanager
def progress(label: str) -> Iterator[Progress]:
    """A display on standard error with the time left."""
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
    console = Console(stderr=True)
    with Bar(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=None, text="")

        def tell(done: int, total: int, text: str = "") -> None:
            bar.update(task, completed=done, total=total, text=text)
            due = done == total or done % max(1, total // 20) == 0
            if not console.is_terminal and total and due:
                print(f"{label}: {done}/{total} {text}", file=sys.stderr, flush=True)

        yield tell
