"""Building a data set of generated or given cities, in parallel, whatever kills it on the way.

Each city is traced on its own and written as a small data set of one city into the folder
``PATH.parts``; once all are there they are merged into PATH. A file gets its name only when it is
complete, a worker computes on one thread, and all seeds are keyed by city, so the result is the
same bytes however often the build was killed and however many workers it had.
"""

from __future__ import annotations

__all__ = ["build_dataset"]

import ast
import hashlib
import importlib.metadata
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.city import City
from skygain.datasets.layout import CityRecord
from skygain.datasets.own import OwnCities
from skygain.datasets.presets import DATA_VERSION, BuildConfig, preset_config
from skygain.datasets.store import ChannelDataset
from skygain.datasets.writer import write_dataset
from skygain.ground.errors import InputError
from skygain.ground.executor import units
from skygain.ground.files import atomic_write, writable_folder

Progress = Callable[[int, int, float | None], None]
"""called with the cities done, the cities in all, and the seconds left (``None`` while unknown)"""

_PACKAGES: dict[str, tuple[str, ...]] = {"raytrace": ("sionna-rt", "mitsuba", "drjit")}
"""packages beside NumPy whose release can change the numbers of a model"""
_STEPS_PER_DB = 4
"""gains are rounded to a quarter of a decibel, finer than the truth is known"""


def build_dataset(
    preset: str | BuildConfig | OwnCities,
    path: str | os.PathLike[str],
    *,
    workers: int = 1,
    resume: bool = True,
    propagation: str | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Generate or read cities, compute the truth of their transmitters, and write the data set.

    Args:
        preset: name of a preset, a configuration, or cities of one's own.
        path: the file to write. Unfinished work is kept beside it, in ``PATH.parts``.
        workers: cities computed at the same time, each in a process of its own on one thread.
        resume: go on from the cities that an earlier, interrupted call finished; else throw them
            away, and replace PATH.
        propagation: name of the propagation model; the configuration's when left out.
        cluster: a Dask cluster that computes instead of ``workers``, see `ClusterRequest`; its
            machines must see the folder of PATH.
        progress: told after each city.

    Returns:
        The path. A finished data set with the same settings is left as it is.

    Raises:
        InputError: unknown preset or propagation model, PATH or its parts were made with other
            settings, another process builds the same file, the folder cannot be written, or an
            optional package is missing.
    """
    from skygain.propagation import PROPAGATION

    config = preset_config(preset) if isinstance(preset, str) else preset
    if propagation is not None:
        config = replace(config, propagation=propagation)
    if workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers}")
    PROPAGATION.factory(config.propagation)
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file to write")
    parts = path.with_name(f"{path.name}.parts")
    settings = _settings(config)
    with _locked(parts, path):
        if not resume:
            _clear(parts)
        elif path.exists():
            _demand_same(settings, ChannelDataset.open(path).attributes.get("build"), path)
            shutil.rmtree(parts)
            return path
        _note_settings(parts, {**settings, "source": _source_digest()})
        _trace_all(config, parts, workers, cluster, progress)
        shards = _Shards([_shard(parts, seed) for seed, _ in config.city_seeds])
        first = ChannelDataset.open(shards.paths[0])
        attributes = {**first.attributes, **_attributes(config, settings)}
        merged = write_dataset(
            parts / "merged.zarr.zip",
            shards,
            grid=first.grid,
            altitudes_m=config.altitudes_m,
            attributes=attributes,
        )
        os.replace(merged, path)
        shutil.rmtree(parts)
    return path


def _trace_all(
    config: BuildConfig | OwnCities,
    parts: Path,
    workers: int,
    cluster: str | None,
    progress: Progress | None,
) -> None:
    """Make the shards that are missing."""
    total = len(config.city_seeds)
    missing = [
        (seed, split) for seed, split in config.city_seeds if not _is_usable(_shard(parts, seed))
    ]
    done, began = total - len(missing), time.monotonic()
    if progress:
        progress(done, total, None)
    if not missing:
        return
    jobs = [(config, seed, split, _shard(parts, seed)) for seed, split in missing]
    workers = min(workers, len(missing))
    with closing(units(_trace_city, jobs, workers=workers, cluster=cluster)) as traced:
        for count, shard in enumerate(traced, start=1):
            if not shard.exists():
                raise InputError(
                    f"a worker wrote {shard}, which is not seen here; the machines of a cluster "
                    "need a shared file system"
                )
            if progress:
                left = (time.monotonic() - began) / count * (len(missing) - count)
                progress(done + count, total, left)


def _trace_city(config: BuildConfig | OwnCities, seed: int, split: str, path: Path) -> Path:
    """Make one shard: get the city, choose its transmitters, compute their maps. Runs in a
    worker."""
    city = config.drawn(seed)
    sites = config.sites(seed, city)
    gain_db, ray_traced, facts = _truth(config, city, sites, config.seed + seed)
    record = CityRecord(
        number=seed,
        split=split,
        height_m=city.height_m,
        building=_rectangles(city),
        tx_m=sites,
        gain_db=np.rint(gain_db * _STEPS_PER_DB) / _STEPS_PER_DB,
        ray_traced=ray_traced,
    )
    attributes = {"frequency_hz": config.frequency_hz, **facts}
    return write_dataset(
        path, [record], grid=city.grid, altitudes_m=config.altitudes_m, attributes=attributes
    )


def _truth(
    config: BuildConfig | OwnCities, city: City, sites: NDArray[np.float64], seed: int
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Gain and whether it came by rays, each ``[link, altitude, row, col]``, and how the rays were
    traced."""
    if config.propagation == "union":
        from skygain.propagation.truth import trace_truth

        truth = trace_truth(city, sites, config.altitudes_m, frequency_hz=config.frequency_hz)
        facts = {"rays": truth.settings.facts}
        return truth.gain_db, truth.ray_traced, facts
    from skygain.propagation import PROPAGATION

    gain_db = PROPAGATION.factory(config.propagation)(
        city, sites, config.altitudes_m, frequency_hz=config.frequency_hz, seed=seed
    )
    outdoor = np.stack([~city.obstructed(altitude) for altitude in config.altitudes_m])
    if not np.isfinite(gain_db[:, outdoor]).all():
        raise InputError(
            f"the model {config.propagation!r} leaves outdoor cells without a gain, so no survey "
            "could use it; take 'union'"
        )
    return gain_db, np.zeros(gain_db.shape, dtype=bool), {}


def _rectangles(city: City) -> NDArray[np.float64]:
    """``[building, (x0, y0, x1, y1, height)]`` of a city of upright rectangles; none of a city
    with others, whose raster is all that is kept."""
    corners = []
    for b in city.buildings:
        low, high = b.footprint_m.min(axis=0), b.footprint_m.max(axis=0)
        upright = ((b.footprint_m == low) | (b.footprint_m == high)).all()
        if b.holes_m or b.base_m or len(b.footprint_m) != 4 or not upright:
            return np.empty((0, 5))
        corners.append((*low, *high, b.height_m))
    return np.array(corners, dtype=float).reshape(-1, 5)


class _Shards(Sequence[CityRecord]):
    """The cities in a list of shard files, each loaded when it is asked for."""

    def __init__(self, paths: list[Path]) -> None:
        self.paths = paths

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, i: Any) -> Any:
        return ChannelDataset.open(self.paths[i]).record(0)


def _shard(parts: Path, seed: int) -> Path:
    return parts / f"city-{seed:04d}.zarr.zip"


def _is_usable(shard: Path) -> bool:
    try:
        ChannelDataset.open(shard)
    except InputError:
        return False
    return True


def _settings(config: BuildConfig | OwnCities) -> dict[str, Any]:
    """All that decides the numbers, as JSON would give it back."""
    releases = {"skygain": skygain.__version__}
    for package in ("numpy", *_PACKAGES.get(config.propagation, ())):
        try:
            releases[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    settings = {"data_version": DATA_VERSION, **config.as_data(), "releases": releases}
    if config.propagation == "union":
        from skygain.propagation.launching.launch import Launching

        settings["rays"] = Launching(frequency_hz=config.frequency_hz).facts
    return json.loads(json.dumps(settings))


def _source_digest() -> str:
    """Changes when the code changes that the numbers come from, but not with its comments and
    docstrings.

    It guards unfinished builds only: the parts of one must come from one code. A finished file
    carries the releases.
    """
    root = Path(skygain.__file__).parent
    digest = hashlib.sha256()
    generators = [root / "cities" / f"{kind}.py" for kind in ("european", "manhattan", "scenes")]
    for file in [*generators, *sorted((root / "propagation").rglob("*.py"))]:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(body := getattr(node, "body", None), list):
                kept = [
                    s
                    for s in body
                    if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))
                ]
                setattr(node, "body", kept)  # noqa: B010 - not every node has a body
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:12]


def _attributes(config: BuildConfig | OwnCities, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The data set's own account of where its numbers come from."""
    return {
        "title": config.title,
        "data_version": DATA_VERSION,
        "propagation": config.propagation,
        "extent_m": config.extent_m,
        "gain": (
            "channel gain in dB, isotropic antennas; cells inside buildings hold values that mean "
            "nothing"
        ),
        "tool": (
            f"Skygain {skygain.__version__}, propagation model {config.propagation}; the "
            f"coordinate city is {config.numbered_by}"
        ),
        "build": dict(settings),
    }


def _note_settings(parts: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings into the parts folder, or see that they are those already there."""
    note = parts / "settings.json"
    if note.exists():
        try:
            found = json.loads(note.read_text())
        except ValueError:
            found = None
        _demand_same(settings, found, parts)
        return
    with atomic_write(note) as unfinished:
        unfinished.write_text(json.dumps(settings, indent=1))


def _demand_same(settings: Mapping[str, Any], found: Any, where: Path) -> None:
    """Raise `InputError` if what stands at ``where`` was made with other settings."""
    if found == settings:
        return
    if not isinstance(found, dict):
        raise InputError(
            f"{where} was not built by this command; give another output path, or do not resume to "
            "replace it"
        )
    different = [
        f"{key} {found.get(key)!r} there, {settings[key]!r} now"
        for key in settings
        if found.get(key) != settings[key]
    ]
    raise InputError(
        f"{where} was made with other settings ({'; '.join(different)}); give another output path, "
        "or do not resume to replace it"
    )


def _clear(parts: Path) -> None:
    """Throw away the work of earlier builds, but nothing else that may lie in the folder."""
    for file in [*parts.glob("*.zarr.zip"), *parts.glob(".*.tmp"), parts / "settings.json"]:
        file.unlink(missing_ok=True)


@contextmanager
def _locked(parts: Path, path: Path) -> Iterator[None]:
    """Hold the parts folder for this process. The lock goes with the process, however it ends."""
    import fcntl

    while True:
        writable_folder(parts)
        with open(parts / "lock", "w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise InputError(
                    f"another process is building {path}; wait for it or choose another output path"
                ) from error
            if not _still_there(parts / "lock", file.fileno()):
                # between our opening the lock and getting it, a build ended and took the folder
                # away
                continue
            try:
                yield
            finally:
                if parts.exists() and os.listdir(parts) == ["lock"]:
                    shutil.rmtree(parts)
            return


def _still_there(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False
