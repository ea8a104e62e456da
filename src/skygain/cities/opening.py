"""One door to all cities: a seed, a file or the name of a scene."""

from __future__ import annotations

__all__ = ["open_city", "read_city"]

import re
from pathlib import Path
from typing import TYPE_CHECKING

from skygain.cities.manhattan import ManhattanConfig, manhattan_city
from skygain.city import City
from skygain.ground.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from skygain.frames import Bounds, Reading

_RASTERS = (".tif", ".tiff")


def open_city(
    spec: str | int,
    *,
    spacing_m: float | None = None,
    crs: str | None = None,
    box: Bounds | None = None,
    layer: str | None = None,
    default_height_m: float | None = None,
) -> City:
    """The city of `read_city`, without the account of what its reader had to assume."""
    return read_city(
        spec, spacing_m=spacing_m, crs=crs, box=box, layer=layer, default_height_m=default_height_m
    ).city


def read_city(
    spec: str | int,
    *,
    spacing_m: float | None = None,
    crs: str | None = None,
    box: Bounds | None = None,
    layer: str | None = None,
    default_height_m: float | None = None,
) -> Reading:
    """Make or read the city named ``spec``.

    Args:
        spec: an integer seed or ``manhattan:7`` (a random city), the path of a height raster
            (``.tif``) or of building footprints (``.geojson``, ``.json``, ``.gpkg``, ``.shp``,
            ``.osm``, ``.pbf``), or the name of a scene of Sionna RT (``munich``; ``scene:munich``
            too).
        spacing_m: side of a cell; left out, 4 m, except for a raster that has square cells in
            metres of its own.
        crs: coordinate reference system of a file's coordinates, against what the file says;
            ``"local"`` for plain metres.
        box: (west, south, east, north) of the part of a file or scene wanted, in degrees or in
            metres of the map.
        layer: layer of a footprints file.
        default_height_m: height of footprints without one; 9 m when left out.

    Raises:
        InputError: the spec is none of these, an option does not apply to it, or its reader cannot
            use it.
    """
    from skygain.cities.scenes import SCENES, scene_city
    from skygain.cities.vector import SUFFIXES
    from skygain.frames import Reading

    text = str(spec).strip()
    path = Path(text)
    suffix = path.suffix.lower()
    if re.fullmatch(r"(manhattan[:-])?\d+", text):
        _refuse(text, crs=crs, box=box, layer=layer, default_height_m=default_height_m)
        config = ManhattanConfig() if spacing_m is None else ManhattanConfig(spacing_m=spacing_m)
        return Reading(manhattan_city(int(re.split("[:-]", text)[-1]), config), {})
    if text.removeprefix("scene:") in SCENES:
        _refuse(text, crs=crs, layer=layer, default_height_m=default_height_m)
        return Reading(
            scene_city(text, spacing_m=4.0 if spacing_m is None else spacing_m, box=box), {}
        )
    if suffix in _RASTERS:
        from skygain.cities.raster import read_raster

        _refuse(text, layer=layer, default_height_m=default_height_m)
        return read_raster(path, spacing_m=spacing_m, crs=crs, box=box)
    if suffix in SUFFIXES:
        from skygain.cities.footprints import DEFAULT_HEIGHT_M, read_footprints

        return read_footprints(
            path,
            spacing_m=4.0 if spacing_m is None else spacing_m,
            crs=crs,
            box=box,
            layer=layer,
            default_height_m=DEFAULT_HEIGHT_M if default_height_m is None else default_height_m,
        )
    files = ", ".join((*_RASTERS, *SUFFIXES))
    raise InputError(
        f"{text[:200]!r} names no city; give a seed (7), the path of a file ({files}) or a scene; "
        f"{did_you_mean(text, SCENES)}"
    )


def _refuse(spec: str, **options: object) -> None:
    """Raise `InputError` for options that mean nothing to this kind of city."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} does not apply to the city {spec!r}; leave it out")
