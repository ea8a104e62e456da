"""Workers of a Dask cluster that share long work, each on one thread and with this machine's code.

What is ours is the care around Dask: that every worker computes the same numbers, and that whatever
goes wrong is said in one line.
"""

from __future__ import annotations

__all__ = ["ClusterPool", "cluster_pool"]

import logging
import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from skygain.ground.errors import InputError, require
from skygain.ground.executor.processes import ONE_THREAD
from skygain.ground.executor.slurm import slurm_jobs

ANSWER_S = 10.0
"""a scheduler that does not answer in this time is not there"""
WORKERS_S = 60.0
"""a scheduler that has no worker after this time will have none"""
KEPT = "what is finished is kept, the same command goes on"


class ClusterPool:
    """Submits units to a Dask scheduler."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)
        self._facts = facts()

    def size(self) -> int:
        """Workers that the scheduler has now, 1 or more."""
        return max(1, len(self._client.nthreads()))

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        """Have ``function(*args)`` computed; a unit whose worker is lost is computed by another."""
        return self._executor.submit(_unit, self._facts, os.getcwd(), function, args)

    def give_up(self) -> None:
        """Nobody waits for what is under way."""
        self._executor.shutdown(wait=False)


@contextmanager
def cluster_pool(cluster: str) -> Iterator[ClusterPool]:
    """The workers of ``cluster``, compared with this machine before anything is computed.

    Raises:
        InputError: Dask is not installed, nobody answers, there is no worker, a worker has other
            releases or several threads, the scheduler is lost, or a unit ends its workers.
    """
    distributed = require("distributed", "cluster")
    with ExitStack() as open_:
        open_.enter_context(_quiet(distributed))
        if cluster.startswith("slurm:"):
            jobs = open_.enter_context(slurm_jobs(cluster.removeprefix("slurm:")))
            address, wait_s, remedy = jobs.address, jobs.wait_s, "see what squeue says of the jobs"
        else:
            address, wait_s = cluster, WORKERS_S
            remedy = f"begin some with: dask worker {address} --nthreads 1 --nworkers -1"
        client = open_.enter_context(_client(distributed, address))
        try:
            client.wait_for_workers(1, timeout=wait_s)
        except TimeoutError:
            raise InputError(
                f"the scheduler at {address} has had no worker for {wait_s:.0f} s; {remedy}"
            ) from None
        _compare(client)
        pool = ClusterPool(client)
        try:
            yield pool
        except distributed.scheduler.KilledWorker as error:
            raise InputError(
                f"several workers ended over the same unit, perhaps for want of memory; {KEPT}, "
                "with more memory for each worker"
            ) from error
        except CancelledError as error:
            raise InputError(f"the scheduler at {address} is gone; {KEPT}") from error
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] != "skygain":
                raise
            raise InputError(f"a worker that came later has no Skygain; {KEPT}") from error
        finally:
            pool.give_up()


@contextmanager
def _client(distributed: Any, address: str) -> Iterator[Any]:
    try:
        client = distributed.Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {address} within {ANSWER_S:.0f} s; begin one with `dask "
            "scheduler`, or give its address as `cluster`"
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=2)


def _compare(client: Any) -> None:
    """Raise `InputError` if a worker would compute other numbers, or several at a time."""
    mine = facts()
    theirs = {
        worker: told.get("host", {}) for worker, told in client.get_versions()["workers"].items()
    }
    for worker, host in theirs.items():
        python = ".".join(str(host.get("python", "?")).split(".")[:2])
        if python != mine["Python"]:
            raise InputError(_differs(worker, {**mine, "Python": python}, mine))
    for worker, threads in client.nthreads().items():
        if threads != 1:
            raise InputError(
                f"the worker at {worker} computes {threads} units in one process, which would wait "
                "for each other; begin workers with --nthreads 1"
            )
    for worker, found in client.run(_self_contained()).items():
        if not found:
            raise InputError(
                f"the worker at {worker} has no Skygain; install the same release there"
            )
        if found != mine:
            raise InputError(_differs(worker, found, mine))


def _differs(worker: str, theirs: dict[str, str], mine: dict[str, str]) -> str:
    different = [
        f"{name} {theirs.get(name, 'missing')} there, {mine[name]} here"
        for name in mine
        if theirs.get(name) != mine[name]
    ]
    return (
        f"the worker at {worker} could compute other numbers ({'; '.join(different)}); install the "
        "same releases there"
    )


@cache
def facts() -> dict[str, str]:
    """What numbers depend on here: releases, and the code of Skygain itself."""
    return _self_contained()()


def _self_contained() -> Callable[[], dict[str, str]]:
    """A function that is sent as it stands, because a worker may have no Skygain to import it
    from; there it finds nothing."""

    def found() -> dict[str, str]:
        import hashlib
        import importlib.metadata
        import pathlib
        import sys

        try:
            import skygain
        except ImportError:
            return {}
        told = {"Python": f"{sys.version_info[0]}.{sys.version_info[1]}"}
        for name in ("numpy", "scipy", "numba", "onnxruntime", "distributed"):
            try:
                told[name] = importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                told[name] = "missing"
        digest = hashlib.sha256()
        root = pathlib.Path(skygain.__file__).parent
        for file in sorted(root.rglob("*.py")):
            digest.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
        told["skygain"] = f"{skygain.__version__} (code {digest.hexdigest()[:8]})"
        return told

    return found


def _unit(mine: dict[str, str], folder: str, function: Callable[..., Any], args: tuple) -> Any:
    """One unit, in a worker: on one thread, in the folder that the command was given in."""
    from threadpoolctl import threadpool_limits

    if facts() != mine:  # a worker that came later
        raise InputError(_differs("a machine that came later", facts(), mine))
    os.environ.update(ONE_THREAD)
    before = Path.cwd()
    try:
        os.chdir(folder)
    except OSError:
        raise InputError(
            f"a worker does not see the folder {folder}; the machines of a cluster need a shared "
            "file system"
        ) from None
    try:
        with threadpool_limits(1):
            return function(*args)
    finally:
        os.chdir(before)


@contextmanager
def _quiet(distributed: Any) -> Iterator[None]:
    """Whatever Dask would print of lost connections and other releases is said by our errors."""
    with (
        distributed.utils.silence_logging_cmgr(logging.CRITICAL + 1),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", module="distributed")
        warnings.filterwarnings("ignore", module="dask_jobqueue")
        yield
