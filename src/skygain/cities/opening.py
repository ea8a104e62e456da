"""One door to all cities: a seed, a file or the name of a scene."""

from __future__ import annotations

__all__ = ["open_city", "read_city"]

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from skygain.cities.manhattan import ManhattanConfig, manhattan_city
from skygain.cities.reading import CityOptions, Reading
from skygain.city import City
from skygain.ground.errors import InputError, did_you_mean


def open_city(spec: str | int | Path, options: CityOptions | None = None, **given: Any) -> City:
    """The city of `read_city`, without the account of what its reader had to assume."""
    return read_city(spec, options, **given).city


def read_city(spec: str | int | Path, options: CityOptions | None = None, **given: Any) -> Reading:
    """Make or read the city named ``spec``.

    Args:
        spec: an integer seed or ``manhattan:7`` (a random city), the path of a height raster
            (``.tif``), of building footprints or of a 3D city model (see
            `skygain.cities.vector.SUFFIXES`), the path of a Sionna RT scene (``.xml``), or the
            name of one of its scenes (``munich``; ``scene:munich`` too).
        options: how to read it; ``given`` are single fields of `CityOptions`, which count before
            it.

    Raises:
        InputError: the spec is none of these, an option does not apply to it, or its reader cannot
            use it.
    """
    from skygain.cities.raster import SUFFIXES as RASTERS
    from skygain.cities.scenes import SCENES, read_scene
    from skygain.cities.vector import SUFFIXES, is_vector

    options = replace(options or CityOptions(), **given)
    text = str(spec).strip()
    path = Path(text)
    if re.fullmatch(r"(manhattan[:-])?\d+", text):
        options.refuse(
            text,
            *("crs", "box", "layer", "default_height_m", "height_field", "terrain", "skip_bad"),
        )
        config = ManhattanConfig()
        if options.spacing_m is not None:
            config = ManhattanConfig(spacing_m=options.spacing_m)
        return Reading(manhattan_city(int(re.split("[:-]", text)[-1]), config))
    if text.removeprefix("scene:") in SCENES or path.suffix.lower() == ".xml":
        return read_scene(text, options)
    if path.suffix.lower() in RASTERS:
        from skygain.cities.raster import read_raster

        return read_raster(path, options)
    if is_vector(path):
        from skygain.cities.footprints import read_footprints

        return read_footprints(path, options)
    files = ", ".join((*RASTERS, *SUFFIXES))
    raise InputError(
        f"{text[:200]!r} names no city; give a seed (7), the path of a file ({files}), of a scene "
        f"(.xml) or a scene; {did_you_mean(text, SCENES)}"
    )
