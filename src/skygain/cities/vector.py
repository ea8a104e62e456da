"""Polygons and their attributes out of a vector file, through GDAL.

The one place that knows GDAL's formats and layers. OpenStreetMap is read with a configuration of
our own (``osmconf.ini``), because GDAL's leaves out closed ways that are tagged ``building:part``
and nothing else.
"""

from __future__ import annotations

__all__ = ["SUFFIXES", "VectorLayer", "open_layer"]

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.tags import KNOWN_NAMES, parse_tags, plain_name
from skygain.frames import LOCAL, Bounds, parse_crs
from skygain.ground.errors import InputError, require

SUFFIXES = (".geojson", ".json", ".gpkg", ".shp", ".osm", ".pbf")
"""endings of files that are read"""

_DRIVERS = ("GeoJSON", "GeoJSONSeq", "TopoJSON", "GPKG", "ESRI Shapefile", "OSM")


@dataclass(frozen=True)
class VectorLayer:
    """One layer of a file."""

    path: Path
    """the file"""
    name: str
    """the layer's name"""
    crs: Any | None
    """``pyproj.CRS`` of its coordinates, ``None`` for plain metres"""
    fields: tuple[str, ...]
    """the attributes it has"""
    is_osm: bool
    """whether it is read as OpenStreetMap"""

    def features(
        self, window: Bounds | None = None
    ) -> tuple[NDArray[np.object_], list[dict[str, Any]]]:
        """Geometries (Shapely; ``None`` for a missing or broken one) and their known attributes,
        named by `plain_name`.

        Args:
            window: only features whose bounds meet this rectangle of the file's coordinates.

        Raises:
            InputError: the file is damaged.
        """
        raw = require("pyogrio.raw", "geo")
        shapely = require("shapely", "geo")
        columns = [name for name in self.fields if plain_name(name) in KNOWN_NAMES]
        with _gdal(self.is_osm) as options:
            meta, _, wkb, values = raw.read(
                self.path, layer=self.name, columns=columns, bbox=window, force_2d=True, **options
            )
            geometries = (
                shapely.from_wkb(wkb, on_invalid="ignore")
                if wkb is not None
                else np.empty(0, dtype=object)
            )
        names = [plain_name(name) for name in meta["fields"]]
        rows = zip(*values, strict=True) if len(values) else (() for _ in geometries)
        return geometries, [_attributes(names, row) for row in rows]

    def extent(self) -> Bounds | None:
        """Bounds of everything in the layer, ``None`` if it is empty."""
        pyogrio = require("pyogrio", "geo")
        with _gdal(self.is_osm):
            _, bounds = pyogrio.read_bounds(self.path, layer=self.name)  # [edge, feature]
        bounds = bounds[:, np.isfinite(bounds).all(axis=0)]
        if not bounds.size:
            return None
        west, south = bounds[:2].min(axis=1)
        east, north = bounds[2:].max(axis=1)
        return float(west), float(south), float(east), float(north)


def open_layer(path: Path, layer: str | None = None, crs: str | None = None) -> VectorLayer:
    """Find the layer to read.

    Args:
        path: an existing file.
        layer: its name; left out, the only one with polygons, or the one called ``building`` or
            ``buildings``.
        crs: coordinate reference system, against what the file says.

    Raises:
        InputError: the file is no vector file GDAL can read, the layer is not there or not
            determined, or there is no CRS.
    """
    pyogrio = require("pyogrio", "geo")
    is_osm = path.suffix.lower() in (".osm", ".pbf")
    with _gdal(is_osm) as options:
        layers = [(str(name), str(kind)) for name, kind in pyogrio.list_layers(path)]
        if is_osm and layer is None:
            layer = "multipolygons"
        name = _chosen(layers, layer)
        info = pyogrio.read_info(path, layer=name, **options)
    if info["driver"] not in _DRIVERS:
        raise InputError(
            f"files of format {info['driver']} are not read as footprints; expected one of "
            f"{', '.join(_DRIVERS)}"
        )
    if crs is None and not info["crs"]:
        raise InputError(
            "the file names no coordinate reference system; give crs, e.g. 'EPSG:32617', or "
            f"{LOCAL!r} for metres"
        )
    fields = tuple(str(field) for field in info["fields"])
    return VectorLayer(
        path, name, parse_crs(crs if crs is not None else info["crs"]), fields, is_osm
    )


@contextmanager
def _gdal(is_osm: bool) -> Iterator[dict[str, str]]:
    """Open options for GDAL, and its errors as `InputError`."""
    with resources.as_file(resources.files("skygain.cities") / "osmconf.ini") as configuration:
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings(
                    "ignore", module="pyogrio"
                )  # what it mends is valid after; what it drops is counted
                yield {"CONFIG_FILE": str(configuration)} if is_osm else {}
        except InputError:
            raise
        # GDAL answers foreign bytes with a dozen kinds of error; each says the file is unusable
        except Exception as error:
            # GDAL's second sentence advises an option we do not have.
            reason = " ".join(str(error).split(";")[0].split())[:200] or type(error).__name__
            raise InputError(
                f"not readable as building footprints ({reason}); it may be cut off or of another "
                "format"
            ) from error


def _chosen(layers: list[tuple[str, str]], wanted: str | None) -> str:
    names = [name for name, _ in layers]
    if wanted is not None:
        if wanted not in names:
            raise InputError(
                f"there is no layer {wanted!r}; the file has {', '.join(names) or 'none'}"
            )
        return wanted
    fitting = [name for name, kind in layers if "Polygon" in kind] or [
        name for name, kind in layers if kind != "None"
    ]
    if len(fitting) > 1:
        fitting = [
            name for name in fitting if plain_name(name) in ("building", "buildings")
        ] or fitting
    if not fitting:
        raise InputError(
            f"expected a layer with polygons, found {', '.join(names) or 'no layer at all'}; "
            "choose another file"
        )
    if len(fitting) > 1:
        raise InputError(
            f"expected one layer with polygons, found {', '.join(fitting)}; give layer"
        )
    return fitting[0]


def _attributes(names: list[str], row: tuple[Any, ...]) -> dict[str, Any]:
    """What is given of a feature's attributes; columns come before what OpenStreetMap's collective
    column says."""
    given = {name: value for name, value in zip(names, row, strict=True) if value is not None}
    for collective in ("othertags", "alltags"):
        for key, value in parse_tags(given.pop(collective, None)).items():
            given.setdefault(plain_name(key), value)
    return given
