"""Polygons out of GeoParquet, as Overture Maps and others publish buildings, through pyarrow."""

from __future__ import annotations

__all__ = ["read_parquet"]

import json
from pathlib import Path
from typing import Any

import numpy as np

from skygain.cities.layers import MemoryLayer, meeting
from skygain.cities.tags import KNOWN_NAMES, plain_name
from skygain.frames import Bounds, parse_crs
from skygain.ground.errors import InputError, require


def read_parquet(
    path: Path, crs: str | None = None, *, window: Bounds | None = None, field: str | None = None
) -> MemoryLayer:
    """The features of a GeoParquet file.

    Args:
        path: the file.
        crs: coordinate reference system, against what the file says.
        window: only features whose bounds meet this rectangle of the file's coordinates.
        field: one more column to read, besides those known to say something of heights.

    Raises:
        InputError: the file is damaged, has no geometry, or names no coordinate reference system.
    """
    parquet = require("pyarrow.parquet", "parquet")
    shapely = require("shapely", "geo")
    try:
        with parquet.ParquetFile(path) as source:
            name, own = _geometry_column(source.schema_arrow)
            named = crs if crs is not None else own
            if named is None:
                raise InputError(
                    "the file names no coordinate reference system; give `crs`, e.g. 'EPSG:32617', "
                    "or 'local' for metres"
                )
            names = source.schema_arrow.names
            wanted = [n for n in names if plain_name(n) in KNOWN_NAMES or n == field]
            geometries: list[Any] = []
            attributes: list[dict[str, Any]] = []
            for batch in source.iter_batches(65_536, columns=[name, *wanted]):
                shapes = shapely.from_wkb(
                    np.array(batch.column(name).to_pylist(), dtype=object), on_invalid="ignore"
                )
                kept = meeting(shapes, window)
                geometries += list(shapes[kept])
                rows = batch.select(wanted).take(_indices(kept)).to_pylist()
                attributes += [{k: v for k, v in row.items() if v is not None} for row in rows]
    except InputError:
        raise
    # pyarrow answers foreign bytes with a dozen kinds of error; each says the file is unusable
    except Exception as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(
            f"not readable as GeoParquet ({reason}); it may be cut off or of another format"
        ) from error
    return MemoryLayer(parse_crs(named), geometries, attributes, tuple(names))


def _geometry_column(schema: Any) -> tuple[str, str | None]:
    """The main geometry column, and the coordinate reference system that the file declares."""
    text = (schema.metadata or {}).get(b"geo")
    if text is None:
        raise InputError(
            f"the file has no GeoParquet metadata (its columns are {', '.join(schema.names)[:120]})"
            "; write it with a tool that does, such as ogr2ogr or geopandas"
        )
    about = json.loads(text)
    name = about["primary_column"]
    column = about["columns"][name]
    if str(column.get("encoding", "WKB")).upper() != "WKB":
        raise InputError(
            f"geometries are encoded as {column['encoding']}; write the file with WKB geometries"
        )
    declared = column.get("crs", "OGC:CRS84")
    return name, json.dumps(declared) if isinstance(declared, dict) else declared


def _indices(kept: Any) -> Any:
    return require("pyarrow", "parquet").array(np.flatnonzero(kept))
