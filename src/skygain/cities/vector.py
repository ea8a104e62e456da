"""Polygons and their attributes out of a vector file.

The one place that knows formats: GDAL reads most of them, and the others become a `MemoryLayer`.
OpenStreetMap is read with a configuration of our own (``osmconf.ini``), because GDAL's leaves out
closed ways that are tagged ``building:part`` and nothing else.
"""

from __future__ import annotations

__all__ = ["SUFFIXES", "Layer", "VectorLayer", "is_vector", "open_layer"]

import json
import re
import warnings
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from skygain.cities.layers import MemoryLayer, attributes_of, flattened
from skygain.cities.tags import KNOWN_NAMES, plain_name
from skygain.frames import LOCAL, Bounds, parse_crs
from skygain.ground.errors import InputError, require

SUFFIXES = (
    ".geojson",
    ".json",
    ".geojsonl",
    ".geojsons",
    ".ndjson",
    ".jsonl",
    ".gpkg",
    ".shp",
    ".zip",
    ".fgb",
    ".kml",
    ".kmz",
    ".gml",
    ".parquet",
    ".geoparquet",
    ".cityjson",
    ".osm",
    ".pbf",
)
"""endings of files that are read; a ``.zip`` holds a Shapefile"""

_SEQUENCES = (".geojsonl", ".geojsons", ".ndjson", ".jsonl")

_FOLDER = re.compile(rb"</?(?:\w+:)?Folder\b[^>]*>")
"""a folder of KML is a layer to GDAL; to a person it is a heap of one thing"""

_MOST_KML = 500_000_000
"""bytes of a document inside a KMZ"""

_DRIVERS = (
    "GeoJSON",
    "GeoJSONSeq",
    "TopoJSON",
    "ESRIJSON",
    "GPKG",
    "ESRI Shapefile",
    "FlatGeobuf",
    "KML",
    "LIBKML",
    "GML",
    "OSM",
)


@dataclass(frozen=True)
class VectorLayer:
    """One layer of a file that GDAL reads."""

    source: Path | bytes
    """the file, or its content"""
    name: str | int
    """the layer's name or number"""
    crs: Any | None
    """``pyproj.CRS`` of its coordinates, ``None`` for plain metres"""
    fields: tuple[str, ...]
    """the attributes it has"""
    is_osm: bool
    """whether it is read as OpenStreetMap"""
    left_out: int = 0
    """lines that could not be read"""
    options: dict[str, str] = field(default_factory=dict)
    """how GDAL is to open it"""

    def features(
        self,
        window: Bounds | None = None,
        field: str | None = None,
        names: Collection[str] = KNOWN_NAMES,
    ) -> tuple[NDArray[np.object_], list[dict[str, Any]]]:
        """See `MemoryLayer.features`; attributes whose plain name is not in ``names`` are not read.

        Raises:
            InputError: the file is damaged.
        """
        raw = require("pyogrio.raw", "geo")
        shapely = require("shapely", "geo")
        columns = [n for n in self.fields if plain_name(n) in names or n == field]
        with _gdal(self.is_osm) as options:
            meta, _, wkb, values = raw.read(
                self.source,
                layer=self.name,
                columns=columns,
                bbox=window,
                **options,
                **self.options,
            )
            geometries = (
                shapely.from_wkb(wkb, on_invalid="ignore")
                if wkb is not None
                else np.empty(0, dtype=object)
            )
        read = [str(name) for name in meta["fields"]]
        rows = zip(*values, strict=True) if len(values) else (() for _ in geometries)
        return flattened(
            geometries,
            [attributes_of(dict(zip(read, row, strict=True)), field) for row in rows],
        )

    def extent(self) -> Bounds | None:
        """Bounds of everything in the layer, ``None`` if it is empty."""
        pyogrio = require("pyogrio", "geo")
        with _gdal(self.is_osm):
            _, bounds = pyogrio.read_bounds(self.source, layer=self.name)  # [edge, feature]
        bounds = bounds[:, np.isfinite(bounds).all(axis=0)]
        if not bounds.size:
            return None
        west, south = bounds[:2].min(axis=1)
        east, north = bounds[2:].max(axis=1)
        return float(west), float(south), float(east), float(north)


Layer: TypeAlias = VectorLayer | MemoryLayer
"""features of one layer, from whatever file"""


def is_vector(path: Path) -> bool:
    """Whether the file's name ends like one that is read here."""
    return path.suffix.lower() in SUFFIXES


def open_layer(
    path: Path,
    layer: str | None = None,
    crs: str | None = None,
    *,
    window: Bounds | None = None,
    field: str | None = None,
    skip_bad: bool = False,
) -> Layer:
    """Find the layer to read.

    Args:
        path: an existing file.
        layer: its name; left out, the only one with polygons, or the one called ``building`` or
            ``buildings``.
        crs: coordinate reference system, against what the file says.
        window: what will be asked for, in coordinates of the file; a format that is read as a whole
            keeps no more.
        field: the further attribute that will be asked for.
        skip_bad: whether lines of a sequence that cannot be read are left out and counted.

    Raises:
        InputError: the file is no vector file that can be read, the layer is not there or not
            determined, or there is no CRS.
    """
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(65_536)
    if suffix in (".parquet", ".geoparquet"):
        from skygain.cities.parquet import read_parquet

        return read_parquet(path, crs, window=window, field=field)
    if suffix in (".json", ".jsonl", ".cityjson", ".geojson"):
        from skygain.cities.cityjson import is_cityjson, read_cityjson
        from skygain.cities.overpass import is_overpass, osm_xml

        if is_cityjson(head) or suffix == ".cityjson":
            return read_cityjson(path, crs)
        if is_overpass(head):
            return _gdal_layer(osm_xml(path), True, layer, crs)
    if layer is not None and suffix in _SEQUENCES:
        raise InputError("a sequence has no layers; leave `layer` out")
    if b"citygml" in head[:4096].lower():
        raise InputError(
            "CityGML is not read; convert it to CityJSON (citygml-tools to-cityjson) and give that"
        )
    if suffix in (".kml", ".kmz"):
        document = _zipped_kml(path) if suffix == ".kmz" else path.read_bytes()
        if layer is None:
            document = _FOLDER.sub(b"", document)
        return _gdal_layer(document, False, layer, crs)
    if suffix in _SEQUENCES:
        content, left_out = _sound_lines(path, skip_bad)
        return _gdal_layer(content, False, layer, crs, left_out=left_out)
    return _gdal_layer(path, suffix in (".osm", ".pbf"), layer, crs, gml=suffix == ".gml")


def _gdal_layer(
    source: Path | bytes,
    is_osm: bool,
    layer: str | None,
    crs: str | None,
    *,
    left_out: int = 0,
    gml: bool = False,
) -> VectorLayer:
    pyogrio = require("pyogrio", "geo")
    further = {"WRITE_GFS": "NO"} if gml else {}  # no file is left beside the user's
    with _gdal(is_osm) as options:
        layers = [(str(name), str(kind)) for name, kind in pyogrio.list_layers(source)]
        if is_osm and layer is None:
            layer = "multipolygons"
        name: str | int = _chosen(layers, layer)
        if str(name).startswith("pyogrio_"):
            name = 0  # named after a file in memory, whose name does not last
        info = pyogrio.read_info(source, layer=name, **options, **further)
    if info["driver"] not in _DRIVERS:
        raise InputError(
            f"files of format {info['driver']} are not read as footprints; expected one of "
            f"{', '.join(_DRIVERS)}; convert it with ogr2ogr"
        )
    if crs is None and not info["crs"]:
        raise InputError(
            "the file names no coordinate reference system; give `crs`, e.g. 'EPSG:32617', or "
            f"{LOCAL!r} for metres"
        )
    fields = tuple(str(field) for field in info["fields"])
    own = parse_crs(crs if crs is not None else info["crs"])
    return VectorLayer(source, name, own, fields, is_osm, left_out, further)


def _zipped_kml(path: Path) -> bytes:
    """The document inside a KMZ; GDAL loses its attributes when it looks into the archive itself.

    Raises:
        InputError: there is none.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            documents = [i for i in archive.infolist() if i.filename.lower().endswith(".kml")]
            if not documents:
                raise InputError("the archive holds no .kml; save it again as KML")
            if documents[0].file_size > _MOST_KML:
                raise InputError(
                    f"the document inside has {documents[0].file_size:,} bytes, more than "
                    f"{_MOST_KML:,}; save a part of it"
                )
            return archive.read(documents[0])
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, OSError) as error:
        raise InputError(
            f"not readable as KMZ ({' '.join(str(error).split())[:100]}); save it again as KML"
        ) from error


def _sound_lines(path: Path, skip_bad: bool) -> tuple[bytes, int]:
    """The lines of a sequence of JSON objects, and how many were left out because they are none.

    Raises:
        InputError: one is none, and leaving out was not asked for.
    """
    kept, bad, first = [], 0, 0
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        text = line.strip().lstrip(b"\x1e").strip()
        if not text:
            continue
        try:
            sound = isinstance(json.loads(text), dict)
        except (ValueError, RecursionError):
            sound = False
        if sound:
            kept.append(text)
        else:
            bad, first = bad + 1, first or number
    if bad and (not skip_bad or not kept):
        raise InputError(
            f"line {first} is no JSON object ({bad} such lines); mend the file, or give `skip_bad` "
            "to leave such lines out"
        )
    if not kept:
        raise InputError("the file holds no feature at all; expected one on each line")
    return b"\n".join(kept) + b"\n", bad


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
                f"there is no layer {wanted!r}; give as `layer` one of {', '.join(names) or 'none'}"
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
            f"expected one layer with polygons, found {', '.join(fitting)}; give `layer`"
        )
    return fitting[0]
