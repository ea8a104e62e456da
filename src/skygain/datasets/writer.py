"""Writing a data set so that the same numbers always give the same bytes.

Zarr's own zip store writes the time of day into every entry, in the order in which chunks happen to
finish. Here the chunks are compressed in memory first; then they go into the zip file sorted by
name and with one fixed date. The file appears under its name only when it is complete.
"""

from __future__ import annotations

__all__ = ["write_dataset"]

import os
import warnings
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skygain.datasets.layout import AXIS, EDGE, SPLITS, VARIABLES, CityRecord
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write

_LINKS_PER_CHUNK = 16
_CITIES_PER_CHUNK = 75
_NAN = "AAAAAAAA+H8="
"""NaN as xarray writes it into the attribute ``_FillValue``"""


def write_dataset(
    path: str | os.PathLike[str],
    records: Sequence[CityRecord],
    *,
    grid: Grid,
    altitudes_m: Sequence[float],
    attributes: Mapping[str, Any],
) -> Path:
    """Write cities and their links as one data-set file that `ChannelDataset.open` reads.

    Args:
        path: the zip file; replaced if it exists.
        records: the cities in order. They are gone through twice and only one of them is held at a
            time, so a sequence that loads its items when they are asked for keeps memory small.
        grid: the grid that all cities share.
        altitudes_m: the altitudes along the dimension ``altitude`` of every record's maps.
        attributes: where the numbers come from; ``frequency_hz`` must be among them.

    Returns:
        The path. Equal arguments give equal bytes, with the same releases of Zarr and its codecs.

    Raises:
        InputError: there is no link to write, the records do not fit together, or the file cannot
            be written.
    """
    path = Path(path)
    tx_m, city_index, buildings, heights, splits, numbers = [], [], [], [], [], []
    for i, record in enumerate(records):
        _check(record, grid, len(altitudes_m))
        tx_m.append(record.tx_m)
        city_index += [i] * len(record.tx_m)
        buildings.append(record.building)
        heights.append(record.height_m)
        splits.append(record.split)
        numbers.append(record.number)
    if not city_index:
        raise InputError(
            "a data set needs at least one link, got none; add cities with outdoor transmitters"
        )
    most = max(1, max(len(b) for b in buildings))
    building = np.full((len(buildings), most, 5), np.nan)
    for i, rectangles in enumerate(buildings):
        building[i, : len(rectangles)] = rectangles
    small = {
        "height_m": np.stack(heights),
        "building": building,
        "split": np.array(splits),
        "city_index": np.array(city_index),
        "tx_m": np.concatenate(tx_m),
        "city": np.array(numbers),
        "altitude": np.array(altitudes_m, dtype=float),
        "y": grid.y_m,
        "x": grid.x_m,
        "axis": np.array(AXIS),
        "edge": np.array(EDGE),
    }
    entries = _compressed(
        small,
        records,
        (len(city_index), len(altitudes_m), *grid.shape),
        {"spacing_m": grid.spacing_m, **attributes},
    )
    _write_zip(path, entries)
    return path


def _check(record: CityRecord, grid: Grid, n_altitudes: int) -> None:
    """Raise `InputError` if a record does not fit the data set."""
    maps = (len(record.tx_m), n_altitudes, *grid.shape)
    if (
        record.height_m.shape != grid.shape
        or record.gain_db.shape != maps
        or record.ray_traced.shape != maps
    ):
        raise InputError(
            f"city {record.number}: expected heights {grid.shape} and maps {maps}, got "
            f"{record.height_m.shape}, "
            f"{record.gain_db.shape} and {record.ray_traced.shape}; all cities of a data set share "
            "grid and altitudes"
        )
    if record.split not in SPLITS:
        raise InputError(
            f"city {record.number}: unknown split {record.split!r}; known: {', '.join(SPLITS)}"
        )


def _compressed(
    small: Mapping[str, np.ndarray],
    records: Iterable[CityRecord],
    shape: tuple[int, ...],
    attributes: Mapping[str, Any],
) -> dict[str, Any]:
    """All entries of the zip file by name, as Zarr's buffers."""
    import zarr
    from zarr.codecs import ZstdCodec

    entries: dict[str, Any] = {}
    with warnings.catch_warnings():
        # the type of fixed-length text awaits its final specification; xarray and this package read
        # it all the same
        warnings.simplefilter("ignore")
        group = zarr.create_group(
            zarr.storage.MemoryStore(entries), zarr_format=3, attributes=dict(attributes)
        )
        arrays = {}
        for name, (dimensions, kind) in VARIABLES.items():
            dtype = np.dtype(kind)
            full = small[name].shape if name in small else shape
            limits = {
                "link": _LINKS_PER_CHUNK if len(full) > 2 else full[0],
                "altitude": 1 if len(full) > 1 else full[0],
            }
            limits["city"] = _CITIES_PER_CHUNK if len(full) > 1 else full[0]
            arrays[name] = group.create_array(
                name,
                shape=full,
                chunks=tuple(
                    min(size, limits.get(d, size)) for d, size in zip(dimensions, full, strict=True)
                ),
                dtype=dtype,
                dimension_names=dimensions,
                fill_value={"f": np.nan, "b": False, "i": 0, "U": ""}[dtype.kind],
                attributes={"_FillValue": _NAN} if dtype.kind == "f" else {},
                compressors=ZstdCodec(level=9),
            )
            if name in small:
                arrays[name][...] = small[name].astype(dtype)
        maps = [_ChunkFiller(arrays[name]) for name in ("gain_db", "ray_traced")]
        for record in records:
            for filler, part in zip(maps, (record.gain_db, record.ray_traced), strict=True):
                filler.add(part)
        for filler in maps:
            filler.finish()
    return entries


class _ChunkFiller:
    """Fills a Zarr array along its first dimension in whole chunks, so that each is compressed
    once."""

    def __init__(self, array: Any) -> None:
        self._array, self._start = array, 0
        self._held = np.empty((0, *array.shape[1:]), dtype=array.dtype)

    def add(self, part: np.ndarray) -> None:
        self._held = np.concatenate([self._held, part.astype(self._array.dtype)])
        n = self._array.chunks[0]
        self._write(len(self._held) // n * n)

    def finish(self) -> None:
        self._write(len(self._held))

    def _write(self, count: int) -> None:
        if count:
            self._array[self._start : self._start + count] = self._held[:count]
            self._start, self._held = self._start + count, self._held[count:]


def _write_zip(path: Path, entries: Mapping[str, Any]) -> None:
    """Write the entries, sorted and with one fixed date."""
    with (
        atomic_write(path) as unfinished,
        zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as archive,
    ):
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr = 3, 0o644 << 16  # the same on every system
            archive.writestr(info, entries[name].to_bytes())
