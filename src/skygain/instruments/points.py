"""Readings that stand as points in a GIS or track file (GeoPackage, GeoJSON, Shapefile, FlatGeobuf,
KML, KMZ and GPX), or as plain JSON objects.

Every point becomes a row: its attributes, and its latitude, longitude and altitude.
"""

from __future__ import annotations

__all__ = ["POINT_SUFFIXES", "open_points"]

import json
import re
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError, require
from skygain.instruments.tables import Columns, Table, quoted_list

_VECTOR = (".gpkg", ".geojson", ".json", ".geojsonl", ".shp", ".fgb", ".jsonl", ".ndjson")
_XML = (".kml", ".kmz", ".gpx")
_PARQUET = (".parquet", ".geoparquet")
POINT_SUFFIXES = (*_VECTOR, *_XML, *_PARQUET)
"""endings of the files that are read as points"""

_PAIR = re.compile(r"([A-Za-z][\w .()-]{0,30}?)\s*[:=]\s*([^;,\n<]+)")
"""``RSRP: -72 dBm`` in a remark"""
_CELLS = re.compile(r"<t[dh][^>]*>\s*([^<]+?)\s*</t[dh]>\s*<td[^>]*>\s*([^<]*?)\s*</td>", re.I)
"""the same as two cells of a table"""

_LARGEST_KMZ = 2_000_000_000


def open_points(path: Path) -> Table:
    """The points of a file as a table.

    Raises:
        InputError: the file cannot be read, or holds no points.
    """
    if path.suffix.lower() in _XML:
        return _xml_table(path)
    if path.suffix.lower() in _PARQUET:
        return _parquet_table(path)
    if path.suffix.lower() in (".json", ".jsonl", ".ndjson"):
        found = _objects(path)
        if found is not None:
            return found
    return _vector_table(path)


def _parquet_table(path: Path) -> Table:
    """The columns of a Parquet file; points in WKB give the place."""
    parquet, shapely = require("pyarrow.parquet", "parquet"), require("shapely", "geo")
    roles: dict[str, str] = {}
    try:
        table = parquet.read_table(path)
        columns: dict[str, NDArray] = {}
        for name in table.column_names:
            values = table.column(name).to_numpy(zero_copy_only=False)
            if isinstance(next((v for v in values if v is not None), None), bytes):
                points = shapely.from_wkb(values, on_invalid="ignore")
                x, y = shapely.get_x(points), shapely.get_y(points)
                degrees = bool((np.abs(x) <= 360).all() and (np.abs(y) <= 90).all())
                place = ("longitude", "latitude") if degrees else ("x", "y")
                columns |= dict(zip(place, (x, y), strict=True))
                roles |= {role: role for role in place}
            elif values.dtype.kind in "iufbMO":
                columns[str(name)] = _tidy(values)
    # pyarrow answers foreign bytes with a dozen kinds of error; each says the file is unusable
    except Exception as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"cannot read {path.name} as Parquet ({reason}); export the readings as CSV"
        ) from error
    return table_of(path.name, columns, roles)


def _objects(path: Path) -> Table | None:
    """Plain JSON objects, in one array or one a line; ``None`` where they are features of a map."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        if text.lstrip().startswith("["):
            rows = json.loads(text)
        else:
            rows = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (OSError, ValueError, RecursionError):
        return None
    if not rows or not all(isinstance(row, dict) for row in rows) or "type" in rows[0]:
        return None
    flat = [dict(_leaves(row)) for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    columns = {n: np.array([str(row.get(n, "")) for row in flat], dtype=object) for n in names}
    return table_of(path.name, columns, {})


def _leaves(row: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """The values of an object by name, those inside another as ``outer.inner``."""
    for name, value in row.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{before}{name}.")
        elif value is not None and not isinstance(value, list):
            yield f"{before}{name}", value


def table_of(
    name: str,
    columns: dict[str, NDArray],
    roles: dict[str, str],
    *,
    crs: str | None = None,
    notes: Sequence[str] = (),
) -> Table:
    """A table of columns that are in memory already, numbered from 1."""
    header = tuple(columns)
    n = len(next(iter(columns.values()))) if columns else 0
    values = list(columns.values())

    def load(wanted: Sequence[int]) -> Columns:
        return [values[i] for i in wanted], np.arange(1, n + 1, dtype=np.int64)

    return Table(name, header, load, roles=roles, crs=crs, notes=tuple(notes))


def _vector_table(path: Path) -> Table:
    pyogrio = require("pyogrio", "geo")
    shapely = require("shapely", "geo")
    try:
        layer, notes = _point_layer(pyogrio, path)
        meta, _, geometry, data = pyogrio.raw.read(str(path), layer=layer)
        points = shapely.from_wkb(geometry)
    except Exception as error:  # of a damaged file the bindings raise whatever it led them to
        raise InputError(
            f"cannot read {path.name} as points ({str(error)[:120]}); export the readings as "
            "GeoPackage, GeoJSON or CSV"
        ) from error
    single = shapely.get_type_id(points) == 4  # a multi-point of one is that point
    if len(points):
        points = np.where(single, shapely.get_geometry(points, 0), points)
    usable = (shapely.get_type_id(points) == 0) & ~shapely.is_empty(points)
    if not usable.any():
        raise InputError(
            f"{path.name} holds no points but {_kinds(meta)}; readings are points with a level "
            "(buildings are given as `city`)"
        )
    x, y, z = shapely.get_x(points), shapely.get_y(points), shapely.get_z(points)
    columns = {str(name): _tidy(values) for name, values in zip(meta["fields"], data, strict=True)}
    if not usable.all():
        notes.append(f"{int((~usable).sum())} of {len(points)} features are no points, left out")
        columns = {name: values[usable] for name, values in columns.items()}
        x, y, z = x[usable], y[usable], z[usable]
    place, crs, told = _placed(x, y, meta["crs"], path)
    columns = {n: v for n, v in columns.items() if n not in place} | place
    if np.isfinite(z).any() and (z != 0).any() and "altitude" not in columns:
        columns["altitude"] = z
    roles = {name: name for name in place}
    return table_of(path.name, columns, roles, crs=crs, notes=[*notes, *told])


def _point_layer(pyogrio: Any, path: Path) -> tuple[str | None, list[str]]:
    """The layer that holds points, and what to tell about the choice."""
    layers = pyogrio.list_layers(str(path))
    found = [name for name, kind in layers if kind and "Point" in kind]
    if len(layers) < 2 or not found:
        return None, []
    if len(found) == 1:
        return found[0], []
    rest = quoted_list(found[1:])
    return found[0], [f"points of layer {found[0]!r} read; {path.name} also has {rest}"]


def _kinds(meta: Any) -> str:
    return f"{meta.get('geometry_type') or 'other shapes'}s"


def _tidy(values: NDArray) -> NDArray:
    """Numbers stay numbers, dates and the rest become text; a missing text is empty."""
    if values.dtype.kind in "iuf":
        return values
    if values.dtype.kind in "bM":
        return values.astype(str).astype(object)
    return np.array(["" if v is None else str(v) for v in values.tolist()], dtype=object)


def _placed(
    x: NDArray, y: NDArray, crs: str | None, path: Path
) -> tuple[dict[str, NDArray], str | None, list[str]]:
    """The position's columns, the CRS of x and y when they stay metres, and what was assumed."""
    if crs is None:
        return {"x": x, "y": y}, None, [f"{path.name} names no coordinate reference system"]
    pyproj = require("pyproj", "geo")
    try:
        source = pyproj.CRS.from_user_input(crs)
        lon, lat = pyproj.Transformer.from_crs(source, "EPSG:4326", always_xy=True).transform(x, y)
    except pyproj.exceptions.ProjError as error:
        raise InputError(
            f"{path.name} is in a coordinate reference system that is not understood ({crs[:60]}); "
            "export it in WGS 84 (EPSG:4326)"
        ) from error
    return {"latitude": np.asarray(lat), "longitude": np.asarray(lon)}, None, []


def _xml_table(path: Path) -> Table:
    """Placemarks of KML and points of GPX, with whatever is written about each."""
    rows = _gpx_rows if path.suffix.lower() == ".gpx" else _kml_rows
    try:
        found = list(rows(_xml_root(path)))
    except ElementTree.ParseError as error:
        raise InputError(
            f"{path.name} is no readable XML ({error}); export it again, or as CSV"
        ) from error
    if not found:
        raise InputError(
            f"{path.name} holds no points; readings are points with a level, such as placemarks "
            "with data, or track points with extensions"
        )
    names = list(dict.fromkeys(name for row in found for name in row))
    columns = {name: np.array([row.get(name, "") for row in found], dtype=object) for name in names}
    roles = {"latitude": "latitude", "longitude": "longitude"}
    return table_of(path.name, columns, roles)


def _xml_root(path: Path) -> ElementTree.Element:
    if path.suffix.lower() != ".kmz":
        return ElementTree.fromstring(path.read_bytes())
    try:
        with zipfile.ZipFile(path) as archive:
            inner = [i for i in archive.infolist() if i.filename.lower().endswith(".kml")]
            if not inner or inner[0].file_size > _LARGEST_KMZ:
                raise InputError(f"{path.name} holds no KML; export the readings as KML or CSV")
            return ElementTree.fromstring(archive.read(inner[0]))
    except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError) as error:
        raise InputError(
            f"{path.name} is no readable KMZ ({error}); export the readings as KML or CSV"
        ) from error


def _local(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _text(element: ElementTree.Element) -> str:
    return (element.text or "").strip()


def _remarks(text: str) -> list[tuple[str, str]]:
    """Names and values that stand in a remark, as a table or as ``name: value``."""
    found = _CELLS.findall(text) or _PAIR.findall(text)
    return [(name.strip(), value.strip()) for name, value in found]


def _kml_rows(root: ElementTree.Element) -> Iterator[dict[str, str]]:
    for mark in root.iter():
        if _local(mark) != "Placemark":
            continue
        row: dict[str, str] = {}
        place = ""
        for element in mark.iter():
            tag = _local(element)
            if tag == "Point":
                place = next((_text(e) for e in element.iter() if _local(e) == "coordinates"), "")
            elif tag in ("name", "when") and _text(element):
                row.setdefault(tag if tag == "name" else "time", _text(element))
            elif tag == "Data":
                value = next((_text(e) for e in element if _local(e) == "value"), "")
                row[element.get("name", "")] = value
            elif tag == "SimpleData":
                row[element.get("name", "")] = _text(element)
            elif tag == "description":
                row |= {k: v for k, v in _remarks(_text(element)) if k not in row}
        parts = place.split(",")
        if len(parts) >= 2:
            row |= {"longitude": parts[0].strip(), "latitude": parts[1].strip()}
            if len(parts) > 2 and parts[2].strip() not in ("", "0"):
                row["altitude"] = parts[2].strip()
            yield row


def _gpx_rows(root: ElementTree.Element) -> Iterator[dict[str, str]]:
    for point in root.iter():
        if _local(point) not in ("wpt", "trkpt", "rtept"):
            continue
        row = {"latitude": point.get("lat", ""), "longitude": point.get("lon", "")}
        for element in point.iter():
            tag = _local(element)
            if element is not point and len(element) == 0 and _text(element):
                row.setdefault({"ele": "altitude"}.get(tag, tag), _text(element))
            if tag in ("cmt", "desc"):
                row |= {k: v for k, v in _remarks(_text(element)) if k not in row}
            if element is not point:
                row |= {k.rpartition("}")[2]: v for k, v in element.items() if k not in row}
        yield row
