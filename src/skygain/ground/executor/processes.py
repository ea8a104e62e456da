"""Processes that share long work: one thread each, and gone when whoever started them is gone."""

from __future__ import annotations

__all__ = ["ONE_THREAD", "process_pool"]

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from skygain.ground.errors import InputError

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""variables of the environment under which libraries compute on one thread"""


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``workers`` processes; leaving the block waits for the tasks that run and cancels
    the others. An interrupt ends them at once.

    The processes are spawned, not forked: a fork would copy the threads of ray tracer and libraries
    in whatever state they are. Each computes on one thread, so that several do not crowd the
    machine and sums keep their order.

    Raises:
        InputError: something else ended a worker.
    """
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=_begin
    )
    try:
        yield pool
    except BrokenProcessPool as error:
        raise InputError(
            "a worker process ended before its work was done, perhaps for want of memory; what is "
            "finished is kept, run the same again, with fewer `workers`"
        ) from error
    except Exception:
        raise
    except BaseException:  # an interrupt or a signal: nobody waits for what is under way
        for child in set(multiprocessing.active_children()) - others:
            child.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin() -> None:
    """Leave Ctrl-C to the parent, which every process of a terminal hears, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()


def _end_with_parent() -> None:
    """End this worker when the process that started it is gone; a killed parent cannot tell it
    to."""

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
