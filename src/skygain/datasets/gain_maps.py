"""Maps of channel gain from files of other programs: GeoTIFF, NetCDF and NumPy archives.

A file holds maps of one place at one altitude, one for each transmitter, and perhaps the heights of
the buildings. What it does not say is assumed and told. A cell without a gain counts as built up,
so that nobody flies or is scored there.
"""

from __future__ import annotations

__all__ = ["SUFFIXES", "GainMaps", "built_over", "read_gain_maps", "seen_on"]

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.reading import city_name, existing_file
from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError, require

SUFFIXES = (".tif", ".tiff", ".nc", ".npz")
"""endings of files that are read"""
_NAMES = ("gain_db", "truth_db", "mean_db")
"""variables and bands of a gain, the first one that a file has"""
_POSITION = ("transmitter_x_m", "transmitter_y_m", "transmitter_z_m")
_HEIGHT_M = 1.5
_LOWEST_DB, _HIGHEST_DB = -400.0, 0.0
_MOST_CELLS = 100_000_000


@dataclass(frozen=True, eq=False)
class GainMaps:
    """What a file of gain maps says."""

    name: str
    """the file's name without its endings"""
    grid: Grid
    """of every map"""
    gain_db: NDArray[np.float32]
    """``[link, row, col]`` channel gain, NaN where there is none"""
    transmitters_m: NDArray[np.float64]
    """``[link, (x, y, z)]``, z above the ground"""
    height_m: NDArray[np.float32] | None = None
    """``[row, col]`` heights of the buildings; ``None`` where the file has none"""
    altitude_m: float | None = None
    """above the ground, if the file says it"""
    frequency_hz: float | None = None
    """carrier, if the file says it"""
    notes: tuple[str, ...] = ()
    """what was assumed, a line each"""


def read_gain_maps(
    path: str | Path, *, gain: str | None = None, spacing_m: float | None = None
) -> GainMaps:
    """Read a file of gain maps.

    Args:
        path: a GeoTIFF whose bands are maps; a NetCDF file with a variable ``[…, y, x]`` and the
            coordinates ``y`` and ``x`` in metres; or an archive of `numpy.savez` with ``gain_db``
            ``[row, col]`` or ``[link, row, col]`` (row 0 is the south), ``spacing_m``, and if
            known ``height_m``, ``transmitter_m``, ``altitude_m``, ``frequency_hz``.
        gain: the variable or the band of the gain; ``gain_db``, ``truth_db`` or ``mean_db`` when
            left out, or all bands.
        spacing_m: side of a cell, for a file that does not say it.

    Raises:
        InputError: the file cannot be read, is not in metres, or holds no gain in dB.
    """
    path = existing_file(path)
    suffix = path.suffix.lower()
    readers = {".tif": _of_tif, ".tiff": _of_tif, ".nc": _of_nc, ".npz": _of_npz}
    if suffix not in readers:
        raise InputError(f"{path.name} is no file of gain maps; give one of {', '.join(SUFFIXES)}")
    grid, values, told = readers[suffix](path, gain, spacing_m)
    if values.ndim == 2:
        values = values[None]
    if values.ndim != 3 or values.shape[1:] != grid.shape or not len(values):
        raise InputError(
            f"{path.name}: expected maps of {grid.shape[0]} x {grid.shape[1]} cells, one for each "
            f"transmitter, got an array of shape {values.shape}"
        )
    values = np.where(np.isfinite(values), values, np.nan).astype(np.float32)
    for number, one in enumerate(values):
        known = one[np.isfinite(one)]
        if known.size < 2:
            raise InputError(f"{path.name}: map {number} holds no gain; choose another `gain`")
        if not (known.min() >= _LOWEST_DB and known.max() <= _HIGHEST_DB):
            raise InputError(
                f"{path.name} holds values from {known.min():.4g} to {known.max():.4g}; expected "
                f"channel gain in dB, between {_LOWEST_DB:g} and {_HIGHEST_DB:g}: take the "
                "radiated power from dBm, turn the sign of a path loss, or choose another `gain`"
            )
    maps = GainMaps(city_name(path), grid, values, np.empty((0, 3)))
    return _completed(maps, path.name, told)


def _completed(maps: GainMaps, name: str, told: Mapping[str, Any]) -> GainMaps:
    """The maps with what the file tells beside them."""
    notes = []
    height = told.get("height_m")
    if height is not None:
        height = np.asarray(height, dtype=np.float32)
        if height.shape != maps.grid.shape:
            raise InputError(
                f"{name}: height_m has shape {height.shape}, expected {maps.grid.shape}"
            )
        height = np.maximum(np.nan_to_num(height), 0.0)
    place = told.get("transmitter_m")
    if place is None:
        strongest = np.array(
            [np.unravel_index(np.nanargmax(one), maps.grid.shape) for one in maps.gain_db]
        )
        place = np.column_stack([maps.grid.xy_m(strongest), np.full(len(maps.gain_db), _HEIGHT_M)])
        notes.append(
            f"{name} does not say where the transmitter is; it is taken to be at the strongest cell"
        )
    place = np.atleast_2d(np.asarray(place, dtype=float))
    if place.shape != (len(maps.gain_db), 3) or not np.isfinite(place).all():
        raise InputError(
            f"{name}: transmitter_m has shape {place.shape}, expected x, y and z for each of "
            f"{len(maps.gain_db)} maps"
        )
    return replace(
        maps,
        transmitters_m=place,
        height_m=height,
        altitude_m=_number(name, told, "altitude_m"),
        frequency_hz=_number(name, told, "frequency_hz"),
        notes=tuple(notes),
    )


def _number(name: str, told: Mapping[str, Any], key: str) -> float | None:
    """One positive number that a file tells, if it does."""
    if told.get(key) is None:
        return None
    value = float(np.asarray(told[key]).flat[0])
    if not 0 < value < np.inf:
        raise InputError(f"{name}: {key} must be above 0, got {value:g}")
    return value


_Read = tuple[Grid, NDArray[Any], Mapping[str, Any]]


def _of_tif(path: Path, wanted: str | None, spacing_m: float | None) -> _Read:
    rasterio = require("rasterio", "geo")
    try:
        with rasterio.open(path) as file:
            if file.width * file.height * file.count > _MOST_CELLS:
                raise InputError(f"{path.name} is too large; cut it")
            bands = _bands(path.name, list(file.descriptions), wanted)
            values = file.read(bands, masked=True).astype(np.float32).filled(np.nan)
            transform, crs, tags = file.transform, file.crs, file.tags()
    except rasterio.errors.RasterioError as error:
        raise InputError(f"cannot read {path.name}: {' '.join(str(error).split())}") from None
    if crs is not None and not crs.is_projected:
        raise InputError(
            f"{path.name} is in degrees; bring it to metres first, for example with gdalwarp "
            "-t_srs EPSG:32632 -tr 4 4"
        )
    side = transform.a
    if transform.b or transform.d or side <= 0 or not np.isclose(side, abs(transform.e)):
        raise InputError(f"{path.name} has cells that are not upright squares; resample it first")
    if transform.e < 0:  # a raster begins in the north, a map in the south
        values = values[:, ::-1]
        south = transform.f + transform.e * values.shape[1]
    else:
        south = transform.f
    if crs is None and transform.is_identity:
        side, south, west = float(spacing_m or 0), 0.0, 0.0
        if side <= 0:
            raise InputError(f"{path.name} does not say how large its cells are; give `spacing_m`")
        values = values[:, ::-1]
    else:
        west = transform.c
    name = None if crs is None else (crs.to_string() if crs.to_epsg() else crs.to_wkt())
    grid = Grid(values.shape[1:], side, (west + side / 2, south + side / 2), name)
    return grid, values, _of_attributes(tags, len(values))


def _bands(name: str, descriptions: list[str | None], wanted: str | None) -> list[int]:
    """Numbers of the bands of gain, from 1."""
    if wanted is not None:
        if wanted in descriptions:
            return [descriptions.index(wanted) + 1]
        if wanted.isdigit() and 1 <= int(wanted) <= len(descriptions):
            return [int(wanted)]
        found = ", ".join(d or str(i) for i, d in enumerate(descriptions, start=1))
        raise InputError(f"{name} has no band {wanted!r}; it has {found}")
    for name in _NAMES:
        if bands := [i for i, d in enumerate(descriptions, 1) if d and d.startswith(name)]:
            return bands
    return list(range(1, len(descriptions) + 1))


def _of_nc(path: Path, wanted: str | None, spacing_m: float | None) -> _Read:
    import xarray

    try:
        file = xarray.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"cannot read {path.name} as NetCDF 4: {error}") from None
    names = [wanted] if wanted else [name for name in _NAMES if name in file]
    if not names or names[0] not in file:
        raise InputError(
            f"{path.name} has no variable {names[0] if names else ' or '.join(_NAMES)!r}; it has "
            f"{', '.join(map(str, file.data_vars))}: choose one as `gain`"
        )
    found = file[names[0]]
    if found.ndim < 2 or not {"y", "x"} <= set(found.dims) or not {"y", "x"} <= set(file.coords):
        raise InputError(
            f"{path.name}: {names[0]} needs the dimensions and coordinates y and x in metres, got "
            f"{found.dims}"
        )
    file = file.sortby(["y", "x"])
    found = file[names[0]].squeeze().transpose(..., "y", "x")
    steps = np.concatenate([np.diff(file["x"].values), np.diff(file["y"].values)])
    if not len(steps) or not np.allclose(steps, steps[0], rtol=1e-3):
        raise InputError(f"{path.name}: y and x must be cell centres at one equal step in metres")
    crs = file["spatial_ref"].attrs.get("crs") if "spatial_ref" in file.coords else None
    origin = float(file["x"].values[0]), float(file["y"].values[0])
    grid = Grid((found.sizes["y"], found.sizes["x"]), round(float(steps.mean()), 6), origin, crs)
    told = dict(_of_attributes(file.attrs, 1 if found.ndim == 2 else len(found)))
    for name in ("height_m", "transmitter_m", "altitude_m", "frequency_hz"):
        if name in file:
            one = file[name]
            told[name] = one.transpose("y", "x").values if name == "height_m" else one.values
    return grid, np.asarray(found.values), told


def _of_npz(path: Path, wanted: str | None, spacing_m: float | None) -> _Read:
    try:
        with np.load(path, allow_pickle=False) as file:
            told = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"cannot read {path.name} as a NumPy archive: {error}") from None
    names = [wanted] if wanted else [name for name in _NAMES if name in told]
    if not names or names[0] not in told:
        raise InputError(
            f"{path.name} has no array {names[0] if names else ' or '.join(_NAMES)!r}; it has "
            f"{', '.join(told)}: choose one as `gain`"
        )
    gain = told.pop(names[0])
    if not np.issubdtype(gain.dtype, np.number) or gain.ndim not in (2, 3):
        raise InputError(f"{path.name}: {names[0]} must be numbers [row, col] or [link, row, col]")
    side = spacing_m or float(np.asarray(told.get("spacing_m", 0)).flat[0])
    if not 0 < side < np.inf:
        raise InputError(f"{path.name} does not say how large its cells are; give `spacing_m`")
    x, y = np.asarray(told.get("origin_m", (0.0, 0.0)), dtype=float).ravel()[:2]
    rows, cols = gain.shape[-2:]
    return Grid((rows, cols), side, (float(x), float(y))), gain, told


def _of_attributes(tags: Mapping[str, Any], maps: int) -> dict[str, Any]:
    """What Skygain's own files say of themselves."""
    told: dict[str, Any] = {}
    try:
        if maps == 1 and all(key in tags for key in _POSITION):
            told["transmitter_m"] = [[float(tags[key]) for key in _POSITION]]
        for name, key in (("altitude_m", "prediction_altitude_m"), ("frequency_hz",) * 2):
            if key in tags:
                told[name] = float(tags[key])
    except (TypeError, ValueError):
        pass  # somebody else's tag of that name
    return told


def seen_on(grid: Grid, maps_grid: Grid, values: NDArray[Any]) -> NDArray[Any]:
    """``values[..., row, col]`` of ``maps_grid`` at the cell centres of ``grid``, NaN beyond them.

    Raises:
        InputError: one grid has a place on Earth and the other none, or they do not touch.
    """
    if (grid.crs is None) != (maps_grid.crs is None):
        raise InputError(
            "the map and the city must both have a coordinate reference system, or both none; "
            "give `crs`"
        )
    points = grid.xy_m(grid.cells)
    if grid.crs is not None and grid.crs != maps_grid.crs:
        pyproj = require("pyproj", "geo")
        between = pyproj.Transformer.from_crs(grid.crs, maps_grid.crs, always_xy=True)
        points = np.column_stack(between.transform(*points.T))
    cells = maps_grid.cells_at(points)
    inside = maps_grid.contains(cells)
    if not inside.any():
        raise InputError("the map and the city do not touch; see that their coordinates agree")
    rows, cols = np.clip(cells, 0, np.array(maps_grid.shape) - 1).T
    seen = np.where(inside, values[..., rows, cols], np.nan)
    return seen.reshape(*values.shape[:-2], *grid.shape)


def built_over(city: City, gain_db: NDArray[np.floating], altitude_m: float) -> tuple[City, int]:
    """The city with every cell built up that has no gain in some map, and how many cells of open
    air that took."""
    missing = ~np.isfinite(gain_db).reshape(-1, *city.grid.shape).all(axis=0)
    missing &= ~city.obstructed(altitude_m)
    if not missing.any():
        return city, 0
    height = np.where(missing, np.float32(altitude_m), city.height_m)
    return replace(city, height_m=height, buildings=()), int(missing.sum())
