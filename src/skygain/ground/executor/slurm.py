"""Jobs of Slurm whose processes become workers, through dask-jobqueue."""

from __future__ import annotations

__all__ = ["slurm_jobs"]

import logging
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from skygain.ground.errors import InputError, require


class Jobs(NamedTuple):
    """What was asked of Slurm."""

    address: str
    """of the scheduler"""
    wait_s: float
    """how long the first job may stand in the queue"""


@contextmanager
def slurm_jobs(config: str) -> Iterator[Jobs]:
    """A scheduler in this process and the jobs that the file ``config`` asks for.

    ``jobs`` of the file is their number, ``cores`` the workers in each, ``wait_minutes`` how long
    the first may stand in the queue, 60 when left out; everything else goes to
    `dask_jobqueue.SLURMCluster` as it stands. The jobs are cancelled at the end of the block.

    Raises:
        InputError: dask-jobqueue is not installed, the file cannot be used, or Slurm refuses.
    """
    jobqueue = require("dask_jobqueue", "cluster")
    settings = _read(Path(config))
    if shutil.which("sbatch") is None:
        raise InputError(
            "Slurm is not on this machine: there is no `sbatch`; run this on its login node"
        )
    jobs, wait_s = settings.pop("jobs"), 60.0 * settings.pop("wait_minutes", 60)
    settings.setdefault("processes", settings["cores"])  # one thread each
    try:
        cluster = jobqueue.SLURMCluster(**settings)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{config} asks for what dask-jobqueue does not have: {_line(error)}"
        ) from error
    try:
        with _heard() as errors:
            cluster.scale(jobs=jobs)
            cluster.sync(cluster._correct_state)
        if errors:
            reason = errors[0].rpartition("stderr:")[2]
            raise InputError(f"Slurm refuses the jobs of {config}: {_line(reason)}")
        yield Jobs(cluster.scheduler_address, wait_s)
    finally:
        with suppress(AssertionError):  # of Dask, about jobs that never were
            cluster.close()


@contextmanager
def _heard() -> Iterator[list[str]]:
    """What goes wrong while jobs are handed in, which Dask only writes to a log."""
    errors: list[str] = []

    class Kept(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.exc_info and record.exc_info[1] is not None:
                errors.append(str(record.exc_info[1]))

    logger, kept = logging.getLogger("tornado.application"), Kept()
    handlers, propagate = logger.handlers, logger.propagate
    logger.handlers, logger.propagate = [kept], False
    try:
        yield errors
    finally:
        logger.handlers, logger.propagate = handlers, propagate


def _read(path: Path) -> dict[str, Any]:
    try:
        settings = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"`cluster` names {path}, which cannot be read: {_line(error)}; give slurm:CONFIG.toml"
        ) from error
    for name in ("jobs", "cores"):
        if not isinstance(settings.get(name), int) or settings[name] < 1:
            raise InputError(f"{path} needs `{name}`, a whole number of 1 or more")
    if "memory" not in settings:
        raise InputError(f"{path} needs `memory` of a job, such as '16GB'")
    return settings


def _line(error: object) -> str:
    return " ".join(str(error).split())[:200]
