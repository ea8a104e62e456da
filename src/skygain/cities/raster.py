"""Cities from GeoTIFF rasters of building height, and back.

The raster holds heights above the ground, or a surface model whose terrain comes from another file
or from its second band (see `skygain.cities.elevations`). A cell takes the value at its centre,
which is what `City.height_m` means, so resampling neither widens nor lowers a building.
"""

from __future__ import annotations

__all__ = ["SUFFIXES", "read_raster", "save_heights", "terrain_on"]

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.elevations import (
    UNITS_M,
    Heights,
    heights_above_ground,
    heights_over_terrain,
)
from skygain.cities.reading import (
    CityOptions,
    Reading,
    check_overlap,
    city_name,
    existing_file,
)
from skygain.city import City
from skygain.frames import (
    MAX_CELLS,
    Bounds,
    box_in_metres,
    grid_over,
    metric_crs,
    parse_crs,
    transformed_bounds,
    vertical_datum,
)
from skygain.grid import Grid
from skygain.ground.errors import InputError, require
from skygain.ground.files import atomic_write

SUFFIXES = (".tif", ".tiff")
"""endings of files that are read"""

_DEFAULT_SPACING_M = 4.0


def read_raster(path: str | Path, options: CityOptions | None = None, **given: Any) -> Reading:
    """Read a GeoTIFF of building heights.

    Args:
        path: the file.
        options: how; ``given`` are single fields of `CityOptions`, which count before it. The
            spacing left out is the raster's own if it is upright, square and in true metres, else
            4 m.

    Returns:
        The city, georeferenced if the file is. Cells without data and cells below ground are open
        ground, and counted.

    Raises:
        InputError: the file is no GeoTIFF or is damaged, has no usable georeference, is too large,
            the box misses it, the values cannot be heights, or the terrain is in them and no
            terrain is given.
    """
    options = replace(options or CityOptions(), **given)
    path = existing_file(path)
    options.refuse(path.name, "layer", "default_height_m", "skip_bad")
    with _opened(path) as source:
        band, unit_m, said = _band(source, options.height_field)
        grid, own, target = _frame(source, options)
        values = _sampled(source, grid, own, target, band) * unit_m
        if options.height_field is None and source.dtypes[band - 1].startswith(("uint", "int")):
            _check_no_mask(values)
        below = _own_terrain(source, band, options.terrain)
        ground = None
        if below is not None:
            ground = _sampled(source, grid, own, target, below) * unit_m
        declared = vertical_datum(source.crs.to_wkt() if source.crs else None)
    datum = declared[0] if declared else None
    try:
        if ground is None and options.terrain not in (None, "none"):
            ground, datum = terrain_on(options.terrain, grid, datum)
        heights = _understood(values, ground, grid, options.terrain)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    if declared and not heights.ground_m.any():
        said += (f"heights are declared above {declared[0]}; the ground lies at 0 there",)
    city = City(
        grid=grid,
        height_m=heights.height_m,
        name=city_name(path),
        ground_m=heights.ground_m,
        ground_datum=datum,
    )
    if not heights.height_m.any():
        said += ("nothing is built: every cell is open ground",)
    return Reading(city, heights.counts, (*said, *heights.remarks))


def terrain_on(
    terrain: str | None, grid: Grid, surface_datum: str | None = None
) -> tuple[NDArray[np.float64], str | None]:
    """Height of the ground on a grid, NaN where the terrain model has none, and what it is
    measured from.

    Args:
        terrain: a raster file, or one height in metres.
        grid: the city's.
        surface_datum: what the surface over it is measured from, if it is declared.

    Raises:
        InputError: the file cannot be read, has another place, or another vertical system.
    """
    try:
        return np.full(grid.shape, float(terrain or 0.0)), surface_datum
    except ValueError:
        path = existing_file(str(terrain))
    with _opened(path) as source:
        own = parse_crs(source.crs.to_wkt() if source.crs else None)
        if (own is None) != (grid.crs is None):
            raise InputError(
                "only one of the terrain model and the city has a coordinate reference system; "
                "give `crs` for the city, or a `terrain` in the same frame"
            )
        target = parse_crs(grid.crs)
        band, unit_m, _ = _band(source, None)
        datum = vertical_datum(source.crs.to_wkt() if source.crs else None)
        if datum and surface_datum and datum[0] != surface_datum:
            raise InputError(
                f"the terrain is above {datum[0]!r} and the surface above {surface_datum!r}; "
                "bring both to one vertical system and give that as `terrain`"
            )
        _check_effort(source, transformed_bounds(grid.bounds_m, target, own))
        smooth = _sampled(source, grid, own, target, band, resampling="bilinear") * unit_m
    return smooth, datum[0] if datum else surface_datum


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
    with atomic_write(path) as partial:
        partial.write_bytes(content)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A GeoTIFF; whatever GDAL says about a bad one becomes an `InputError` that names the file."""
    rasterio = require("rasterio", "geo")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", rasterio.errors.NotGeoreferencedWarning
            )  # _check_local says it, with the remedy
            with rasterio.open(path, driver="GTiff") as source:
                yield source
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    # GDAL answers foreign bytes with a dozen kinds of error; each says the file is unusable
    except Exception as error:
        raise InputError(
            f"{path.name} is not a readable GeoTIFF ({_one_line(error)}); it may be cut off, "
            "export it again"
        ) from error


def _frame(source: Any, options: CityOptions) -> tuple[Grid, Any | None, Any | None]:
    """The grid wanted, the file's coordinate reference system and the grid's."""
    crs, box = options.crs, options.box
    own = parse_crs(
        crs if crs is not None else source.crs.to_wkt() if source.crs is not None else None
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
    spacing = options.spacing_m
    if spacing is None:
        spacing = pixel.a if native else _DEFAULT_SPACING_M
    bounds = data_m
    if box is not None:
        bounds = box_in_metres(box, target)
        check_overlap(bounds, data_m, box, target)
        if native and spacing == pixel.a:
            bounds = _on_lattice(bounds, data_m, spacing)
    grid = grid_over(bounds, spacing, target)
    _check_effort(source, transformed_bounds(grid.bounds_m, target, own))
    return grid, own, target


def _band(source: Any, height_field: str | None) -> tuple[int, float, tuple[str, ...]]:
    """Which band holds the heights, the metres in their unit, and what was assumed of the unit."""
    name, _, unit = (height_field or "1").partition(":")
    described = [(text or "").strip().lower() for text in source.descriptions]
    if name.strip().lower() in described and name.strip():
        band = described.index(name.strip().lower()) + 1
    else:
        try:
            band = int(name or "1")
        except ValueError:
            raise InputError(
                f"there is no band {name!r}; give `height_field` as a number from 1 to "
                f"{source.count}, with a unit if need be, e.g. 1:ft"
            ) from None
    _check_layout(source, band)
    said: tuple[str, ...] = ()
    if not unit:
        unit = source.units[band - 1] or ""
        datum = vertical_datum(source.crs.to_wkt() if source.crs is not None else None)
        if not unit and datum:
            unit = datum[1]
        if not unit and source.crs is not None and source.crs.is_projected:
            plane = str(source.crs.linear_units).strip()
            if "foot" in plane.lower() or "feet" in plane.lower():
                said = (
                    "heights are taken as metres although the plane is in feet; if they are feet, "
                    "give `height_field` 1:ft",
                )
    unit = (unit or "metre").strip().lower()
    if unit not in UNITS_M:  # "meters above ground"
        unit = next((u for u in (unit.partition(" ")[0], unit[:-1]) if u in UNITS_M), unit)
        unit = unit.removesuffix("s") if unit.removesuffix("s") in UNITS_M else unit
    if unit.startswith(("metres ", "meters ")):
        unit = "m"
    if unit not in UNITS_M:
        raise InputError(
            f"heights are in {unit!r}, expected one of {', '.join(UNITS_M)}; convert the raster "
            "to metres, or give `height_field` with the right unit, e.g. 1:ft"
        )
    return band, UNITS_M[unit], said


def _check_no_mask(values: NDArray[np.float64]) -> None:
    """Raise where whole numbers only tell buildings from the rest."""
    found = np.unique(values[np.isfinite(values)])
    if len(found) == 2 and tuple(found) in ((0.0, 1.0), (0.0, 255.0)):
        raise InputError(
            f"the cells hold nothing but 0 and {found[1]:g}, so this is a mask of buildings and "
            "no heights; give a raster of heights, or `height_field=1:m` if these are metres"
        )


def _own_terrain(source: Any, band: int, terrain: str | None) -> int | None:
    """The band of the same file that holds the ground, where one was named or the second is it."""
    if terrain is not None and terrain.startswith("band:"):
        number = terrain.removeprefix("band:").strip()
        if not (number.isdigit() and 1 <= int(number) <= source.count and int(number) != band):
            raise InputError(
                f"{terrain!r} is no band of ground heights; the file has {source.count} and the "
                f"heights are in band {band}; give `terrain` as a file or another band"
            )
        return int(number)
    if terrain is not None or source.count != 2 or band != 1:
        return None
    coarse = (min(source.height, 1000), min(source.width, 1000))
    first, second = (source.read(i, masked=True, out_shape=coarse) for i in (1, 2))
    above = (first.astype(np.float64) - second.astype(np.float64)).compressed()
    touching = np.abs(above) < 1.0
    if above.size and np.mean(above < -1.0) < 0.02 and touching.mean() > 0.02 and second.any():
        return 2
    return None


def _understood(
    values: NDArray[np.float64],
    ground: NDArray[np.float64] | None,
    grid: Grid,
    terrain: str | None,
) -> Heights:
    if ground is None:
        return heights_above_ground(values, grid.spacing_m, trusted=terrain == "none")
    return heights_over_terrain(values, ground, grid.spacing_m)


def _sampled(
    source: Any,
    grid: Grid,
    own: Any | None,
    target: Any | None,
    band: int,
    resampling: str = "nearest",
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
        resampling=rasterio.enums.Resampling[resampling],
        src_nodata=source.nodata,
        nodata=np.nan,
        dtype="float64",
    ) as view:
        values = view.read(band)[::-1].astype(np.float64)
    return values * source.scales[band - 1] + source.offsets[band - 1]


def _check_layout(source: Any, band: int) -> None:
    if not 1 <= band <= source.count:
        raise InputError(
            f"there is no band {band}; the file has {source.count}, counted from 1; give another "
            "`height_field`"
        )
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
            "give `crs`, e.g. 'EPSG:4326'"
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
            "`box`, or tile or coarsen the raster first"
        )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
