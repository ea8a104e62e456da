"""Time without compiling: the first call of a Numba kernel compiles it or loads it from disk, which
is no part of what the call costs."""

from __future__ import annotations

__all__ = ["Stopwatch", "on_compiling"]

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any


class Stopwatch:
    """Wall time since it was made, less what Numba spent on compiling and loading kernels.

    >>> watch = Stopwatch()
    >>> 0 <= watch.seconds < 1
    True
    """

    def __init__(self) -> None:
        self._meter = _meter()
        self._compiled = self._meter.seconds
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """So far."""
        passed = time.perf_counter() - self._began
        return max(0.0, passed - (self._meter.seconds - self._compiled))


@contextmanager
def on_compiling(told: Callable[[bool], None]) -> Iterator[None]:
    """Call ``told(True)`` whenever a kernel that is not on disk begins to compile, ``told(False)``
    when it is done."""
    from numba.core import event

    class Teller(event.Listener):  # type: ignore[misc]
        depth = 0  # a kernel's compilation holds that of the kernels it calls

        def on_start(self, event: Any) -> None:
            self.depth += 1
            if self.depth == 1:
                told(True)

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                told(False)

    teller = Teller()
    event.register("numba:compile", teller)
    try:
        yield
    finally:
        event.unregister("numba:compile", teller)


@cache
def _meter() -> Any:
    """One listener for the whole process; its ``seconds`` only grow."""
    from numba.core import event

    class Meter(event.Listener):  # type: ignore[misc]
        """Time under the compiler's lock, which is held for loading from disk too."""

        seconds = 0.0
        depth = 0
        began = 0.0

        def on_start(self, event: Any) -> None:
            self.depth += 1
            if self.depth == 1:
                self.began = time.perf_counter()

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                self.seconds += time.perf_counter() - self.began

    meter = Meter()
    event.register("numba:compiler_lock", meter)
    return meter
