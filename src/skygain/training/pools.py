"""Surveys flown once, city by city, into a folder that training draws from again and again.

A pool belongs to what it was made by: other weights or settings have a pool of their own. A city
whose file exists is whole, so a pool that was stopped goes on with the cities that are missing.
"""

from __future__ import annotations

__all__ = ["Flight", "flown_cities"]

import hashlib
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from functools import lru_cache
from pathlib import Path

import numpy as np

from skygain.datasets.links import Links, Paths, origin_of, read_links, several_paths
from skygain.ground.errors import InputError
from skygain.ground.executor import units
from skygain.networks.weights import runs_folder, weight_file
from skygain.training.run import Report

Flight = Callable[[Links, int, np.random.Generator, Path], None]
"""flies one city of the links and writes its file; other processes must be able to import it"""

_held = lru_cache(maxsize=1)(read_links)  # a worker is given many cities of one data set


def flown_cities(
    kind: str,
    data: Paths,
    split: str,
    fly: Flight,
    *,
    weights: Iterable[str | Path],
    settings: object,
    stream: Callable[[Path, int], list[int]],
    pool: str | Path = "",
    workers: int = 1,
    cluster: str = "",
    report: Report = lambda record: None,
) -> list[Path]:
    """The files of all cities of ``split``, flown as far as that has not been done yet.

    Args:
        kind: name of the folder beside the runs.
        data: data sets.
        split: split of the cities.
        fly: flies a city.
        weights: names or files of the weights that the flights rest on.
        settings: whatever else they depend on; its ``repr`` counts.
        stream: seed of a city, from the data set's path and the city's number.
        pool: folder of the pools instead of the one beside the runs.
        workers: processes that fly.
        cluster: a Dask cluster that flies instead, if any.
        report: hears of every city.

    Raises:
        InputError: no data set has a link of the split, or they come from different models.
    """
    origin = origin_of(data)
    parts = [*(weight_file(name).read_bytes() for name in weights), repr(settings).encode()]
    parts.append(origin.encode())
    state = hashlib.sha256(b"".join(parts)).hexdigest()[:12]
    files: list[Path] = []
    for path in several_paths(data):
        links = _held(path, split)
        if links is None:
            continue  # another data set may have some
        folder = (
            (Path(pool) if str(pool) else runs_folder() / kind) / f"{path.name}-{state}" / split
        )
        folder.mkdir(parents=True, exist_ok=True)
        here = [folder / f"{city:04d}.npz" for city in range(len(links.height_m))]
        jobs = [
            (path, split, city, fly, stream(path, city), file)
            for city, file in enumerate(here)
            if not file.exists()
        ]
        with closing(_all(jobs, workers, cluster)) as flown:
            for done, _ in enumerate(flown, 1):
                report({"pool": path.name, "split": split, "city": done, "of": len(jobs)})
        files += here
    _held.cache_clear()
    if not files:
        names = ", ".join(map(str, several_paths(data)))
        raise InputError(
            f"{names} holds no link of split {split!r}, in which the {kind} flies; add a data set "
            "that has some"
        )
    return files


def _all(jobs: list[tuple], workers: int, cluster: str) -> Generator[None, None, None]:
    if jobs and (cluster or (workers > 1 and len(jobs) > 1)):
        yield from units(_fly, jobs, workers=workers, cluster=cluster)
        return
    for job in jobs:
        _fly(*job)
        yield


def _fly(path: Path, split: str, city: int, fly: Flight, seed: list[int], file: Path) -> None:
    links = _held(path, split)
    assert links is not None
    fly(links, city, np.random.default_rng(seed), file)
