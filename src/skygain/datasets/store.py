"""Reading a data set: lazily, link by link, from any number of processes.

A file from outside may be cut short, damaged, something else altogether, or made to do harm.
`ChannelDataset.open` therefore looks at sizes, dimensions and types before it reads any numbers,
and whatever is wrong comes out as a one-line `InputError`.
"""

from __future__ import annotations

__all__ = ["ChannelDataset"]

import os
import zipfile
from collections.abc import Callable
from functools import cached_property, lru_cache
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.city import Building, City
from skygain.datasets.chunks import check_chunks
from skygain.datasets.layout import SPLITS, VARIABLES, CityRecord
from skygain.datasets.link import Link
from skygain.grid import Grid
from skygain.ground.errors import InputError

_MAX_CHUNK_BYTES = 2**28
"""a chunk larger than this is taken for an attack on the memory"""
_MAX_SMALL_BYTES = 2**31
"""the same for the variables that are held in memory as a whole"""
_MAX_MAPS_BYTES = 2**35
"""the same for maps that are asked for together"""


class ChannelDataset:
    """Cities and links of one data-set file. Open one with `ChannelDataset.open`.

    It can be pickled and survives a fork: each process reads through a file handle of its own.
    """

    def __init__(self, path: Path, arrays: dict[str, Any], attributes: dict[str, Any]) -> None:
        self.path = path
        """the file"""
        self._arrays_of, self._process = arrays, os.getpid()
        self.attributes = attributes
        """where the numbers come from: carrier, ray tracer, rays per transmitter, …"""
        self.altitudes_m = tuple(float(a) for a in arrays["altitude"][:])
        """altitudes along the dimension ``altitude``"""
        self.splits: tuple[str, ...] = tuple(str(s) for s in arrays["split"][:])
        """split of each city"""
        self.city_numbers: tuple[int, ...] = tuple(int(n) for n in arrays["city"][:])
        """each city's own number, for generated cities the seed"""
        self.city_index: NDArray[np.int64] = arrays["city_index"][:].astype(np.int64)
        """``[link]`` position of the city of each link"""
        self.transmitters_m: NDArray[np.float64] = arrays["tx_m"][:].astype(np.float64)
        """``[link, (x, y, z)]``"""
        self.grid = _grid(arrays["x"][:], arrays["y"][:], path)
        """the grid that all cities share"""
        self.city = lru_cache(maxsize=32)(self._city)
        self._block = lru_cache(maxsize=8)(self._read_block)
        self._computed: dict[tuple[int, int], NDArray[np.bool_]] = {}

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> ChannelDataset:
        """Open the data set in the zip file ``path``; its layout is that of
        `skygain.datasets.layout`.

        Raises:
            InputError: there is no such file, or it is not a complete data set of this layout.
        """
        path = Path(path)
        if not path.exists():
            raise InputError(
                f"there is no file {path}; build a data set with: skygain dataset build --preset "
                f"small --out {path}"
            )
        return _guarded(path, lambda: cls(path, *_open_arrays(path)))._checked()

    def __reduce__(self) -> tuple[Callable[..., ChannelDataset], tuple[Path]]:
        return ChannelDataset.open, (self.path,)

    def __repr__(self) -> str:
        return (
            f"ChannelDataset({str(self.path)!r}, cities={self.n_cities}, links={self.n_links}, "
            f"altitudes_m={self.altitudes_m})"
        )

    @property
    def n_cities(self) -> int:
        """Number of cities."""
        return len(self.splits)

    @property
    def n_links(self) -> int:
        """Number of links."""
        return len(self.city_index)

    @property
    def frequency_hz(self) -> float:
        """Carrier frequency."""
        return float(self.attributes["frequency_hz"])

    def cities(self, split: str | None = None) -> list[int]:
        """Positions of the cities of ``split``, or of all.

        Raises:
            InputError: the data set has no such split.
        """
        if split is None:
            return list(range(self.n_cities))
        found = [i for i, name in enumerate(self.splits) if name == split]
        if not found:
            raise InputError(
                f"{self.path} has no split {split!r}; it has {', '.join(sorted(set(self.splits)))}"
            )
        return found

    def links(self, split: str | None = None, altitude_m: float = 10.0) -> list[int]:
        """Positions of the links of ``split`` (or of all) whose gain was computed at
        ``altitude_m``, ordered by city.

        Raises:
            InputError: the data set has no such split or altitude.
        """
        level = self._level(altitude_m)
        chosen = np.flatnonzero(np.isin(self.city_index, self.cities(split)))
        block = self._links_per_chunk
        computed = {b: self._computed_in(b, level) for b in np.unique(chosen // block).tolist()}
        found = [int(i) for i in chosen if computed[int(i) // block][int(i) % block]]
        return sorted(found, key=lambda i: (self.city_index[i], i))

    def link(self, index: int, altitude_m: float = 10.0) -> Link:
        """The link at position ``index`` of the data set.

        Raises:
            InputError: no such link or altitude, the altitude was not computed for it, or the file
                is damaged.
        """
        if not 0 <= index < self.n_links:
            raise InputError(f"{self.path} has links 0 to {self.n_links - 1}, got {index}")
        level = self._level(altitude_m)
        block = self._links_per_chunk
        gain, ray_traced = self._block(index // block, level)
        truth = gain[index % block].astype(np.float32)
        if np.isnan(truth).all():
            raise InputError(
                f"link {index} of {self.path} was not computed at {altitude_m:g} m; take one of "
                "links(split, altitude_m)"
            )
        traced = ray_traced[index % block].copy()
        truth.flags.writeable = traced.flags.writeable = False
        i = int(self.city_index[index])
        x, y, z = self.transmitters_m[index].tolist()
        return Link(
            city=self.city(i),
            transmitter_m=(x, y, z),
            altitude_m=float(altitude_m),
            truth_db=truth,
            ray_traced=traced,
            split=self.splits[i],
            city_index=i,
            index=int(index),
        )

    def record(self, i: int) -> CityRecord:
        """City ``i`` with all its links at all altitudes, as stored: what `write_dataset` takes."""
        links = np.flatnonzero(self.city_index == i)
        gain, traced = self.maps(links)
        return CityRecord(
            number=self.city_numbers[i],
            split=self.splits[i],
            height_m=self._heights[i],
            building=self._rectangles(i),
            tx_m=self.transmitters_m[links].astype(np.float32),
            gain_db=gain,
            ray_traced=traced,
        )

    def maps(self, links: NDArray[np.int64]) -> tuple[NDArray[np.float16], NDArray[np.bool_]]:
        """Gain and whether a ray arrived, each ``[link, altitude, row, col]`` as stored, NaN where
        an altitude was not computed.

        Raises:
            InputError: they would take more than 32 GiB, or the file is damaged.
        """
        shape = (len(links), len(self.altitudes_m), *self.grid.shape)
        if 3 * prod(shape) > _MAX_MAPS_BYTES:
            raise InputError(
                f"{self.path}: {shape[0]} links of {shape[1:]} values would take "
                f"{3 * prod(shape) / 2**30:.0f} GiB of memory; build data sets of fewer cities"
            )
        gain, traced = np.empty(shape, dtype=np.float16), np.empty(shape, dtype=bool)
        block = self._links_per_chunk
        for level in range(len(self.altitudes_m)):
            for k, link in enumerate(links.tolist()):
                maps = self._block(link // block, level)
                gain[k, level], traced[k, level] = (m[link % block] for m in maps)
        return gain, traced

    def to_xarray(self) -> Any:
        """The whole file as a lazy `xarray.Dataset`."""
        import xarray
        import zarr

        return xarray.open_zarr(zarr.storage.ZipStore(self.path, mode="r"), consolidated=False)

    def _city(self, i: int) -> City:
        """City ``i``, with its buildings as rectangles."""
        if not 0 <= i < self.n_cities:
            raise InputError(f"{self.path} has cities 0 to {self.n_cities - 1}, got {i}")
        buildings = tuple(
            Building(
                footprint_m=np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float),
                height_m=float(height),
            )
            for x0, y0, x1, y1, height in self._rectangles(i).tolist()
        )
        return City(
            grid=self.grid,
            height_m=self._heights[i],
            buildings=buildings,
            name=f"city-{self.city_numbers[i]}",
        )

    def _rectangles(self, i: int) -> NDArray[np.float32]:
        """``[building, edge]`` of city ``i`` without the padding."""
        padded = self._buildings[i]
        return padded[np.isfinite(padded).all(axis=-1)]

    def _level(self, altitude_m: float) -> int:
        """Position of an altitude."""
        close = np.flatnonzero(np.isclose(self.altitudes_m, altitude_m))
        if not len(close):
            known = ", ".join(f"{a:g}" for a in self.altitudes_m)
            raise InputError(f"{self.path} has no altitude {altitude_m:g} m; it has {known} m")
        return int(close[0])

    @property
    def _arrays(self) -> dict[str, Any]:
        if (
            self._process != os.getpid()
        ):  # after a fork, two processes must not move one file position
            self._arrays_of, self._process = _open_arrays(self.path)[0], os.getpid()
        return self._arrays_of

    @property
    def _links_per_chunk(self) -> int:
        return int(self._arrays["gain_db"].chunks[0])

    @cached_property
    def _heights(self) -> NDArray[np.floating]:
        heights = self._read("height_m", slice(None))
        if not (np.isfinite(heights).all() and (heights >= 0).all()):
            raise InputError(
                f"{self.path} has building heights that are negative or not numbers; build the "
                "data set anew"
            )
        return heights

    @cached_property
    def _buildings(self) -> NDArray[np.floating]:
        return self._read("building", slice(None))

    def _read(self, name: str, key: Any) -> NDArray[Any]:
        return np.asarray(_guarded(self.path, lambda: self._arrays[name][key]))

    def _read_block(self, b: int, level: int) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
        """The maps of one chunk of links at one altitude, each ``[link, row, col]``."""
        n = self._links_per_chunk
        key = (slice(b * n, (b + 1) * n), level)
        return self._read("gain_db", key), self._read("ray_traced", key)

    def _computed_in(self, b: int, level: int) -> NDArray[np.bool_]:
        """``[link]`` which links of a chunk have any number at an altitude."""
        if (b, level) not in self._computed:
            n = self._links_per_chunk
            gain = self._read("gain_db", (slice(b * n, (b + 1) * n), level))
            self._computed[b, level] = ~np.isnan(gain).all(axis=(1, 2))
        return self._computed[b, level]

    def _checked(self) -> ChannelDataset:
        """This data set, if what was read on opening makes sense."""
        index = self.city_index
        frequency = self.attributes.get("frequency_hz")
        demands = {
            "there must be at least one city, link and altitude": min(
                self.n_cities, self.n_links, len(self.altitudes_m)
            )
            >= 1,
            "altitudes must be positive": all(0 < a < np.inf for a in self.altitudes_m),
            f"splits must be among {', '.join(SPLITS)}": set(self.splits) <= set(SPLITS),
            "city_index must point to cities": bool(np.all((index >= 0) & (index < self.n_cities))),
            "transmitters must be finite": bool(np.isfinite(self.transmitters_m).all()),
            "the attribute frequency_hz must be a positive number": isinstance(
                frequency, int | float
            )
            and 0 < frequency < np.inf,
        }
        for demand, met in demands.items():
            if not met:
                raise InputError(
                    f"{self.path} is not a usable data set: {demand}; build it anew with: skygain "
                    "dataset build"
                )
        return self


def _guarded(path: Path, read: Callable[[], Any]) -> Any:
    """What ``read`` returns. Zip, codec and Zarr each have errors of their own for a damaged file;
    all become an `InputError`."""
    try:
        return read()
    except InputError:
        raise
    except PermissionError as error:
        raise InputError(
            f"cannot read {path}: permission denied; change its permissions or copy it"
        ) from error
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path} is damaged or not a Skygain data set ({type(error).__name__}: {reason}); "
            "copy it again or build it anew with: skygain dataset build"
        ) from error


def _open_arrays(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The Zarr arrays in the zip file by name, and the attributes, once their sizes, dimensions and
    types are found right."""
    if not path.is_file() or not zipfile.is_zipfile(path):
        raise InputError(
            f"{path} is not a zip file, so not a Skygain data set, or it was cut short; "
            "copy it again or build it anew with: skygain dataset build"
        )
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda entry: entry.file_size, default=None)
        if largest is not None and largest.file_size > _MAX_CHUNK_BYTES:
            raise InputError(
                f"{path} holds an entry {largest.filename!r} of {largest.file_size} bytes; no data "
                "set does, so it is not opened"
            )
    import zarr

    group = zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r", zarr_format=3)
    arrays: dict[str, Any] = {}
    sizes: dict[str, int] = {"axis": 3, "edge": 5}
    for name, (dimensions, kind) in VARIABLES.items():
        if not isinstance(array := group.get(name), zarr.Array):
            raise InputError(
                f"{path} is a zip file without the variable {name!r}, so not a Skygain data set; "
                "give the file of one"
            )
        found = getattr(array.metadata, "dimension_names", None)
        if found != dimensions or array.dtype.kind != np.dtype(kind).kind:
            raise InputError(
                f"{path}: expected {name} as {np.dtype(kind)}{list(dimensions)}, got "
                f"{array.dtype}{found}"
                "; convert it or build the data set anew"
            )
        arrays[name] = array
        for dimension, size in zip(dimensions, array.shape, strict=True):
            if sizes.setdefault(dimension, size) != size:
                raise InputError(
                    f"{path}: {name} has {size} along {dimension!r}, expected {sizes[dimension]}; "
                    "build the data set anew"
                )
        whole = name not in ("gain_db", "ray_traced")
        if prod(array.chunks) * array.dtype.itemsize > _MAX_CHUNK_BYTES or (
            whole and array.nbytes > _MAX_SMALL_BYTES
        ):
            raise InputError(
                f"{path}: {name} has shape {array.shape} in chunks of {array.chunks}, too large to "
                "be read; it is not opened"
            )
    check_chunks(path, arrays)
    if arrays["gain_db"].chunks != arrays["ray_traced"].chunks:
        raise InputError(
            f"{path}: gain_db and ray_traced must have the same chunks; build the data set anew"
        )
    return arrays, dict(group.attrs)


def _grid(x: NDArray[np.floating], y: NDArray[np.floating], path: Path) -> Grid:
    """The grid whose cell centres are ``x[col]`` and ``y[row]``."""
    steps = np.concatenate([np.diff(x.astype(float)), np.diff(y.astype(float))])
    if len(x) < 2 or len(y) < 2 or not np.allclose(steps, steps[0], rtol=1e-4) or not steps[0] > 0:
        raise InputError(
            f"{path}: x and y must be at least two cell centres at equal, growing steps; build the "
            "data set anew"
        )
    return Grid(
        shape=(len(y), len(x)),
        spacing_m=float(round(steps.mean(), 6)),
        origin_m=(float(x[0]), float(y[0])),
    )
