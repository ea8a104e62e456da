"""A city that was read, and the account of it: what was found, mended, assumed and left out.

A reader never repairs in silence. It counts (`Reading.counts`) and remarks (`Reading.remarks`);
both become the lines that a survey prints, stores and reports (`Reading.notes`).
"""

from __future__ import annotations

__all__ = ["CityOptions", "Reading", "check_overlap", "city_name", "existing_file"]

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skygain.city import City
from skygain.frames import Bounds, box_in_metres, parse_crs, transformed_bounds
from skygain.ground.errors import InputError

_OF_BUILDINGS = ("without a height", "heights from levels", "heights or levels not understood")
"""counts that are a share of the buildings begin like this"""


@dataclass(frozen=True)
class CityOptions:
    """How a city is to be read. An option that means nothing to its kind is refused."""

    spacing_m: float | None = None
    """side of a cell; left out, 4 m, except for a raster with square cells in metres of its own"""
    crs: str | None = None
    """coordinate reference system of the file's coordinates, against what the file says;
    ``"local"`` for plain metres"""
    box: Bounds | None = None
    """(west, south, east, north) of the part wanted, in degrees or in metres of the map"""
    layer: str | None = None
    """which layer, where the file has several with polygons"""
    default_height_m: float | None = None
    """height of a footprint without one; 9 m when left out"""
    height_field: str | None = None
    """``NAME[:unit]``: the attribute (or the band, from 1) that holds the heights, and their unit:
    m, ft, cm or dm; ``z`` takes the polygons' own third coordinate"""
    terrain: str | None = None
    """the ground: a raster file of its height, its height in metres where it is level, ``band:2``
    of the surface model itself, or ``none`` if the heights are above ground already"""
    skip_bad: bool = False
    """whether lines that cannot be read are left out, and counted"""

    def refuse(self, spec: str, *names: str) -> None:
        """Raise `InputError` if one of the options is given that means nothing to this city."""
        for name in names:
            if getattr(self, name) not in (None, False):
                raise InputError(f"`{name}` does not apply to the city {spec!r}; leave it out")


@dataclass(frozen=True)
class Reading:
    """A city read from somewhere, and what its reader had to assume."""

    city: City
    """the city"""
    counts: Mapping[str, int] = field(default_factory=dict)
    """what was found, mended or assumed, and how often; only what occurred. For example
    ``{"buildings": 1030, "without a height, taken as 9 m": 412}``"""
    remarks: tuple[str, ...] = ()
    """what is said once, such as ``"heights are taken as metres"``"""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should read before the flight, a line each."""
        total = self.counts.get("buildings")
        lines = []
        for what, count in self.counts.items():
            if what == "buildings":
                continue
            share = total is not None and what.startswith(_OF_BUILDINGS)
            one = what if not share or what.startswith("without") else f"with {what}"
            lines.append(f"{count} of {total} buildings {one}" if share else f"{count} {what}")
        return (*lines, *self.remarks)

    @property
    def place(self) -> str:
        """Where the city is and how large, in one line."""
        grid = self.city.grid
        west, south, east, north = grid.bounds_m
        rows, cols = grid.shape
        size = f"{rows} x {cols} cells of {grid.spacing_m:g} m"
        if grid.crs is None:
            extent = f"x {west:g} to {east:g} m, y {south:g} to {north:g} m"
            return f"{size}, {extent}, no place on Earth"
        latitude, longitude = grid.latlon(((rows - 1) / 2, (cols - 1) / 2))
        label = grid.crs if len(grid.crs) < 40 else "a projection of its own"
        return (
            f"{size} ({east - west:.0f} x {north - south:.0f} m), {label}, "
            f"centre {latitude:.5f}, {longitude:.5f}"
        )

    def as_data(self) -> dict[str, Any]:
        """The account as plain data, for results.json and the report."""
        grid = self.city.grid
        shape = grid.shape
        centre = None
        if grid.crs is not None:
            centre = [float(v) for v in grid.latlon(((shape[0] - 1) / 2, (shape[1] - 1) / 2))]
        return {
            "name": self.city.name,
            "place": self.place,
            "crs": grid.crs,
            "centre_latlon": centre,
            "bounds_m": [float(v) for v in grid.bounds_m],
            "buildings": len(self.city.buildings),
            "height_m": [float(self.city.height_m.min()), float(self.city.height_m.max())],
            "ground_m": [float(self.city.ground_m.min()), float(self.city.ground_m.max())],
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return "\n  ".join([f"{self.city.name}: {self.place}", *self.notes])


def existing_file(path: str | Path) -> Path:
    """The path, if a file is there.

    Raises:
        InputError: it is not.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"no file {str(path)!r}; check the path (a folder is not read)")
    return path


def city_name(path: Path) -> str:
    """The file's name without its endings: ``"durham"`` for ``durham.osm.pbf``."""
    return re.split(r"\.", path.name)[0] or path.name


def check_overlap(box_m: Bounds, data_m: Bounds, box: Bounds, crs: Any | None) -> None:
    """Raise `InputError` if the ``box_m`` asked for misses the data.

    The message says where the data is, and whether the ``box`` as it was given has latitude and
    longitude swapped.
    """
    if _overlap(box_m, data_m):
        return
    west, south, east, north = box
    hint = ""
    if crs is not None and max(abs(v) for v in box) <= 90:
        try:
            if _overlap(box_in_metres((south, west, north, east), crs), data_m):
                hint = "; latitude and longitude look swapped, longitude comes first"
        except InputError:
            hint = ""
    place = _shown(data_m)
    if crs is not None and crs.is_projected:
        place = (
            _shown(transformed_bounds(data_m, crs, parse_crs("EPSG:4326"))) + f" degrees, {place} m"
        )
    raise InputError(
        f"the box {_shown((west, south, east, north))} misses the data, which covers "
        f"{place}{hint}; choose a `box` inside it"
    )


def _overlap(a: Bounds, b: Bounds) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _shown(bounds: Bounds) -> str:
    return "[" + ", ".join(f"{v:.9g}" for v in bounds) + "]"
