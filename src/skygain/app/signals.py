"""What a stop from outside does, told within a second even while compiled code runs."""

from __future__ import annotations

__all__ = ["Terminated", "stopping", "told_of_signals"]

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

ENDING = ("SIGTERM", "SIGHUP")
AGAIN = 128
"""added to a signal's number: it was raised where Python ignores exceptions"""


class Terminated(BaseException):
    """The process was told to end; unlike an interrupt, nothing more is computed."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextlib.contextmanager
def told_of_signals(first: Callable[[], str], kept: str) -> Iterator[None]:
    """Within the block Ctrl-C prints what ``first`` says at once and raises `KeyboardInterrupt` as
    usual; a second one prints ``kept``; SIGTERM and SIGHUP print ``kept`` and raise `Terminated`.

    Python runs signal handlers between two of its own steps only, and compiled code can take
    seconds. So the text is printed by a thread that the system's own handler wakes. What is raised
    where Python ignores exceptions, as in ``__del__``, is raised once more. Outside the main thread
    nothing changes.
    """
    if threading.current_thread() is not threading.main_thread() or sys.platform == "win32":
        yield
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    seen: list[int] = []
    repeated: list[int] = []

    def tell() -> None:
        while data := os.read(reader, 1):
            number = data[0]
            if number == 0:
                return
            if number >= AGAIN:
                time.sleep(0.05)  # until the main thread is out of what ignored it
                repeated.append(number - AGAIN)
                os.kill(os.getpid(), number - AGAIN)
                continue
            if number in repeated:  # it was told when it came
                repeated.remove(number)
                continue
            again = signal.SIGINT in seen
            seen.append(number)
            text = first() if number == signal.SIGINT and not again else kept
            print(f"\n{text}", file=sys.stderr, flush=True)

    def end(number: int, _: object) -> None:
        raise Terminated(number)

    def ignored(found: Any) -> None:
        raised = found.exc_value
        if not isinstance(raised, (Terminated, KeyboardInterrupt)):
            usual(found)
            return
        number = raised.number if isinstance(raised, Terminated) else signal.SIGINT
        os.write(writer, bytes([AGAIN + number]))

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    numbers = [getattr(signal, name) for name in ENDING]
    before = {number: signal.signal(number, end) for number in numbers}
    woken = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    usual, sys.unraisablehook = sys.unraisablehook, ignored
    try:
        yield
    finally:
        sys.unraisablehook = usual
        signal.set_wakeup_fd(woken)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.write(writer, b"\0")
        thread.join(timeout=1.0)
        os.close(writer)
        os.close(reader)


@contextlib.contextmanager
def stopping(stop: Callable[[], None], told: str) -> Iterator[None]:
    """Within the block the first signal prints ``told`` and calls ``stop``, which ends the work at
    its next good moment; a second one ends it at once. After SIGTERM and SIGHUP the block raises
    `Terminated` at its end."""
    if threading.current_thread() is not threading.main_thread() or sys.platform == "win32":
        yield
        return
    seen: list[int] = []

    def heard(number: int, _: object) -> None:
        seen.append(number)
        if len(seen) > 1:
            raise KeyboardInterrupt
        print(f"\n{told}", file=sys.stderr, flush=True)
        stop()

    numbers = [signal.SIGINT, *(getattr(signal, name) for name in ENDING)]
    before = {number: signal.signal(number, heard) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if seen and seen[0] != signal.SIGINT:
        raise Terminated(seen[0])
