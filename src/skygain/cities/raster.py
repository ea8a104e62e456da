"""Cities from GeoTIFF rasters of building height, and back.

The raster holds height above the ground in metres (surface model minus terrain model). A cell takes
the value at its centre, which is what `City.height_m` means, so resampling neither widens nor
lowers a building.
"""

from __future__ import annotations

__all__ = ["MAX_HEIGHT_M", "raster_city", "read_raster", "save_heights"]

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.frames import (
    MAX_CELLS,
    Bounds,
    Reading,
    box_in_metres,
    check_overlap,
    city_name,
    existing_file,
    grid_over,
    metric_crs,
    parse_crs,
    transformed_bounds,
)
from skygain.grid import Grid
from skygain.ground.errors import InputError, require

MAX_HEIGHT_M = 1000.0
"""no building is higher"""

_MAX_DEPTH_M = 100.0
"""a surface model minus a terrain model errs below zero, but not by more than this"""

_STREET_M = 2.0
"""a map of heights above ground has a cell lower than this somewhere"""

_DEFAULT_SPACING_M = 4.0

_UNITS_M = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "us survey foot": 1200 / 3937,
    "cm": 0.01,
    "dm": 0.1,
}


def raster_city(
    path: str | Path,
    *,
    spacing_m: float | None = None,
    crs: str | None = None,
    box: Bounds | None = None,
    band: int = 1,
) -> City:
    """The city of `read_raster`, without the account of what was mended."""
    return read_raster(path, spacing_m=spacing_m, crs=crs, box=box, band=band).city


def read_raster(
    path: str | Path,
    *,
    spacing_m: float | None = None,
    crs: str | None = None,
    box: Bounds | None = None,
    band: int = 1,
) -> Reading:
    """Read a GeoTIFF of heights above ground.

    Args:
        path: the file.
        spacing_m: side of a cell; left out, the raster's own if it is upright, square and in true
            metres, else 4 m.
        crs: coordinate reference system of the file's coordinates, against what the file says;
            ``"local"`` for plain metres.
        box: (west, south, east, north) of the part wanted, in degrees or in metres of the map's
            projection.
        band: which band holds the heights, from 1.

    Returns:
        The city, georeferenced if the file is. Cells without data and cells below ground are open
        ground, and counted.

    Raises:
        InputError: the file is no GeoTIFF or is damaged, has no usable georeference, is too large,
            the box misses it, or the values cannot be heights above ground.
    """
    path = existing_file(path)
    rasterio = require("rasterio", "geo")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", rasterio.errors.NotGeoreferencedWarning
            )  # _check_local says it, with the remedy
            with rasterio.open(path, driver="GTiff") as source:
                grid, height, unit_m = _read(source, spacing_m, crs, box, band)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    # GDAL answers foreign bytes with a dozen kinds of error; each says the file is unusable
    except Exception as error:
        raise InputError(
            f"{path.name} is not a readable GeoTIFF ({_one_line(error)}); it may be cut off, "
            "export it again"
        ) from error
    try:
        height_m, counts = _heights_above_ground(height * unit_m)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    return Reading(City(grid=grid, height_m=height_m, name=city_name(path)), counts)


def save_heights(city: City, path: str | Path) -> None:
    """Write the height raster as a GeoTIFF, north up, one float32 band in metres; georeferenced
    when the city is.

    The file appears whole or not at all.

    Raises:
        InputError: the folder cannot be written to.
    """
    rasterio = require("rasterio", "geo")
    path = Path(path)
    west, _, _, north = city.grid.bounds_m
    profile = {
        "driver": "GTiff",
        "width": city.grid.shape[1],
        "height": city.grid.shape[0],
        "count": 1,
        "dtype": "float32",
        "crs": city.crs,
        "transform": rasterio.Affine(
            city.grid.spacing_m, 0.0, west, 0.0, -city.grid.spacing_m, north
        ),
        "compress": "deflate",
    }
    with rasterio.MemoryFile() as memory:
        with memory.open(**profile) as sink:
            sink.write(city.height_m[::-1], 1)
            sink.units = ("metre",)
            sink.set_band_description(1, "building height above ground")
        content = bytes(memory.getbuffer())
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(
            f"cannot write {str(path)!r} ({error.strerror}); choose a folder that exists and is "
            "writable"
        ) from error


def _read(
    source: Any, spacing_m: float | None, crs: str | None, box: Bounds | None, band: int
) -> tuple[Grid, NDArray[np.float64], float]:
    """The grid wanted, the values at its cell centres (NaN where the file has none), and the metres
    in their unit."""
    _check_layout(source, band)
    own = (
        parse_crs(crs)
        if crs is not None
        else parse_crs(source.crs.to_wkt() if source.crs else None)
    )
    extent = _extent(source)
    _check_local(source, own, crs)
    target = metric_crs(own, extent)
    data_m = transformed_bounds(extent, own, target)
    pixel = source.transform
    upright = (
        pixel.b == 0 and pixel.d == 0 and pixel.a > 0 and abs(pixel.a + pixel.e) <= 1e-6 * pixel.a
    )
    native = upright and own == target
    spacing = spacing_m if spacing_m is not None else (pixel.a if native else _DEFAULT_SPACING_M)
    bounds = data_m
    if box is not None:
        bounds = box_in_metres(box, target)
        check_overlap(bounds, data_m, box, target)
        if native and spacing == pixel.a:
            bounds = _on_lattice(bounds, data_m, spacing)
    grid = grid_over(bounds, spacing, target)
    _check_effort(source, transformed_bounds(grid.bounds_m, target, own))
    unit = (source.units[band - 1] or "metre").strip().lower()
    if unit not in _UNITS_M:
        raise InputError(
            f"heights are in {unit!r}, expected one of {', '.join(_UNITS_M)}; convert the raster "
            "to metres"
        )
    return grid, _sampled(source, grid, own, target, band), _UNITS_M[unit]


def _sampled(
    source: Any, grid: Grid, own: Any | None, target: Any | None, band: int
) -> NDArray[np.float64]:
    """``[row, col]`` the pixel under each cell's centre, NaN where there is none."""
    rasterio = require("rasterio", "geo")
    warp = require("rasterio.vrt", "geo")
    west, _, _, north = grid.bounds_m
    # GDAL wants some CRS on both sides; for a local frame the same arbitrary one leaves coordinates
    # as they are.
    names = [c.to_wkt() if c is not None else "EPSG:32631" for c in (own, target)]
    with warp.WarpedVRT(
        source,
        src_crs=names[0],
        crs=names[1],
        transform=rasterio.Affine(grid.spacing_m, 0.0, west, 0.0, -grid.spacing_m, north),
        width=grid.shape[1],
        height=grid.shape[0],
        resampling=rasterio.enums.Resampling.nearest,
        src_nodata=source.nodata,
        nodata=np.nan,
        dtype="float64",
    ) as view:
        values = view.read(band)[::-1].astype(np.float64)
    return values * source.scales[band - 1] + source.offsets[band - 1]


def _heights_above_ground(
    height_m: NDArray[np.float64],
) -> tuple[NDArray[np.float32], dict[str, int]]:
    """Heights with everything below ground or unknown set to 0, and how many cells that were.

    Raises:
        InputError: there is no value, or they cannot be heights above ground in metres.
    """
    known = np.isfinite(height_m)
    if not known.any():
        raise InputError(
            "no cell has a value; choose another band or box, or check the file's nodata value"
        )
    low, high = float(height_m[known].min()), float(height_m[known].max())
    if low < -_MAX_DEPTH_M or high > MAX_HEIGHT_M:
        raise InputError(
            f"values from {low:g} to {high:g} m are not building heights; expected metres above "
            "ground from 0 to "
            f"{MAX_HEIGHT_M:g}, with missing cells marked as nodata"
        )
    if low > _STREET_M:
        raise InputError(
            f"the lowest value is {low:g} m, so no cell is at street level; expected heights above "
            "ground, "
            "so subtract the terrain model from the surface model"
        )
    below = known & (height_m < 0)
    counts = {
        "cells without data, taken as open ground": int((~known).sum()),
        "cells below ground, taken as open ground": int(below.sum()),
    }
    return np.where(known & ~below, height_m, 0.0).astype(np.float32), {
        what: count for what, count in counts.items() if count
    }


def _check_layout(source: Any, band: int) -> None:
    if not 1 <= band <= source.count:
        raise InputError(f"there is no band {band}; the file has {source.count}, counted from 1")
    if np.dtype(source.dtypes[band - 1]).kind not in "iuf":
        raise InputError(f"band {band} holds {source.dtypes[band - 1]}; expected real numbers")
    if source.count >= 3 and source.colorinterp[0].name == "red":
        raise InputError(
            "this is a colour picture; expected a raster whose band holds heights in metres"
        )


def _check_local(source: Any, own: Any | None, crs: str | None) -> None:
    """A raster without CRS is read in metres unless its coordinates show that they are not
    metres."""
    if own is not None or crs is not None:
        return
    if source.transform.is_identity:
        raise InputError(
            "the raster has neither coordinate reference system nor pixel size; georeference it "
            "(gdal_translate -a_srs -a_ullr)"
        )
    if max(abs(source.transform.a), abs(source.transform.e)) < 0.01:
        raise InputError(
            "the raster has no coordinate reference system and its coordinates look like degrees; "
            "give crs, e.g. 'EPSG:4326'"
        )


def _extent(source: Any) -> Bounds:
    """Upright bounds of the raster's four corners in its own coordinates."""
    pixel = source.transform
    col, row = np.array(
        [[0, source.width, 0, source.width], [0, 0, source.height, source.height]], dtype=float
    )
    x, y = pixel.a * col + pixel.b * row + pixel.c, pixel.d * col + pixel.e * row + pixel.f
    if not np.isfinite([x, y]).all() or x.min() == x.max() or y.min() == y.max():
        raise InputError("the raster's pixels have no size; georeference it again")
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _on_lattice(bounds: Bounds, data: Bounds, spacing_m: float) -> Bounds:
    """The bounds moved to the nearest pixel edges, so that cells are the raster's own pixels."""
    start = np.array([data[0], data[1], data[0], data[1]])
    steps = np.rint((np.array(bounds) - start) / spacing_m)
    steps[2:] = np.maximum(steps[2:], steps[:2] + 1)
    west, south, east, north = (float(v) for v in start + steps * spacing_m)
    return west, south, east, north


def _check_effort(source: Any, bounds: Bounds) -> None:
    """Refuse to decode an area far beyond the largest map, however few bytes or cells it takes."""
    west, south, east, north = bounds
    extent = _extent(source)
    share_x = (min(east, extent[2]) - max(west, extent[0])) / (extent[2] - extent[0])
    share_y = (min(north, extent[3]) - max(south, extent[1])) / (extent[3] - extent[1])
    pixels = max(share_x, 0.0) * source.width * max(share_y, 0.0) * source.height
    block = max(rows * cols for rows, cols in source.block_shapes)
    if pixels > 16 * MAX_CELLS or block > 16 * MAX_CELLS:
        raise InputError(
            f"{source.width} x {source.height} pixels in blocks of {block:.3g} are too many to "
            "read at once; choose a smaller "
            "box, or tile or coarsen the raster first"
        )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
