"""Features of a file: shapes and what is said of them, wherever they come from."""

from __future__ import annotations

__all__ = ["Z", "MemoryLayer", "attributes_of", "flattened", "meeting"]

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.tags import parse_tags, plain_name
from skygain.frames import Bounds
from skygain.ground.errors import require

Z = "@z"
"""the attribute under which a polygon's own third coordinate (its highest) is given"""


@dataclass(frozen=True)
class MemoryLayer:
    """A layer that was read as a whole."""

    crs: Any | None
    """``pyproj.CRS`` of its coordinates, ``None`` for plain metres"""
    shapes: Sequence[Any]
    """Shapely geometries, ``None`` for a missing or broken one"""
    attributes: Sequence[dict[str, Any]]
    """what is said of each, by the file's names"""
    fields: tuple[str, ...] = ()
    """the attributes it has, where that is known"""
    is_osm: bool = False
    """whether it is read as OpenStreetMap"""
    left_out: int = 0
    """lines that could not be read, where leaving them out was asked for"""

    def features(
        self,
        window: Bounds | None = None,
        field: str | None = None,
        names: Collection[str] = (),
    ) -> tuple[NDArray[np.object_], list[dict[str, Any]]]:
        """Geometries (plane) and their attributes by `plain_name`.

        Args:
            window: only features whose bounds meet this rectangle of the file's coordinates.
            field: one more attribute to give, under the file's own name.
            names: of attributes a reader of files reads; what was read is given anyway.
        """
        shapes = np.empty(len(self.shapes), dtype=object)
        shapes[:] = list(self.shapes)
        kept = np.flatnonzero(meeting(shapes, window))
        return flattened(
            shapes[kept], [attributes_of(self.attributes[int(i)], field) for i in kept]
        )

    def extent(self) -> Bounds | None:
        """Bounds of everything in the layer, ``None`` if it is empty."""
        found = [float(v) for v in require("shapely", "geo").total_bounds(list(self.shapes))]
        return (found[0], found[1], found[2], found[3]) if np.isfinite(found).all() else None


def meeting(shapes: NDArray[np.object_], window: Bounds | None) -> NDArray[np.bool_]:
    """``[feature]`` whether its bounds meet the rectangle; all do where there is none."""
    if window is None:
        return np.ones(len(shapes), dtype=bool)
    west, south, east, north = window
    x0, y0, x1, y1 = require("shapely", "geo").bounds(shapes).T  # NaN for none
    kept: NDArray[np.bool_] = (x1 >= west) & (x0 <= east) & (y1 >= south) & (y0 <= north)
    return kept


def flattened(
    geometries: NDArray[np.object_], attributes: list[dict[str, Any]]
) -> tuple[NDArray[np.object_], list[dict[str, Any]]]:
    """The geometries without their third coordinate, which becomes the attribute `Z`."""
    shapely = require("shapely", "geo")
    tall = np.flatnonzero(shapely.has_z(geometries))
    for i in tall:
        z = shapely.get_coordinates(geometries[i], include_z=True)[:, 2]
        if np.isfinite(z).all() and len(z) and z.any():
            attributes[i][Z] = float(z.max())
    return shapely.force_2d(geometries) if len(tall) else geometries, attributes


def attributes_of(raw: dict[str, Any], field: str | None) -> dict[str, Any]:
    """What is given of a feature's attributes, by plain name, and ``field`` as it is called;
    columns come before what OpenStreetMap's collective column says."""
    given: dict[str, Any] = {}
    for name, value in raw.items():
        if value is not None:
            given.setdefault(plain_name(name), value)
            if name == field:
                given[name] = value
    for collective in ("othertags", "alltags", "tags"):
        for key, value in parse_tags(given.pop(collective, None)).items():
            given.setdefault(plain_name(key), value)
            if key == field:
                given[key] = value
    return given
