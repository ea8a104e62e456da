"""Long work in units: shared by processes of this machine, or by the workers of a cluster.

A unit follows from its arguments alone and what it writes appears in one step. So it does not
matter who computes it, nor how often it was begun: a worker that is lost costs one unit.
"""

from __future__ import annotations

__all__ = ["ClusterRequest", "process_pool", "units"]

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import islice
from typing import Any, TypeVar

from skygain.ground.executor.cluster import cluster_pool
from skygain.ground.executor.processes import process_pool
from skygain.ground.executor.request import ClusterRequest

T = TypeVar("T")


def units(
    function: Callable[..., T], jobs: Iterable[tuple], *, workers: int, cluster: str | None = None
) -> Generator[T, None, None]:
    """The results of ``function`` for the arguments in ``jobs``, as they end.

    Closing it before its end leaves what is under way unfinished.

    Args:
        function: other processes must be able to import it.
        jobs: are drawn as they are needed.
        workers: processes of this machine.
        cluster: a Dask scheduler or the settings of Slurm jobs whose workers compute instead; see
            `ClusterRequest`.

    Raises:
        InputError: see `process_pool` and `cluster_pool`.
    """
    queue, running = iter(jobs), set[Future[T]]()
    pool: Any = cluster_pool(cluster) if cluster else process_pool(workers)
    with pool as executor:
        while True:
            room = 2 * (executor.size() if cluster else workers) - len(running)
            running |= {executor.submit(function, *job) for job in islice(queue, max(0, room))}
            if not running:
                return
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()
