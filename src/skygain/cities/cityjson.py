"""Buildings out of CityJSON: solids of level of detail 1 and 2 become prisms.

A building's footprint is the union of its surfaces seen from above, its height the difference
between its highest and its lowest point. CityJSON is one JSON document; CityJSONSeq has its
metadata in the first line and one feature in each further line.
"""

from __future__ import annotations

__all__ = ["is_cityjson", "read_cityjson"]

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.layers import MemoryLayer
from skygain.frames import parse_crs
from skygain.ground.errors import InputError, require

_KINDS = ("Building", "BuildingPart")

_FLAT_M = 0.2
"""a model that spans less height is a footprint, and its attributes say how high it is"""


def is_cityjson(head: bytes) -> bool:
    """Whether a file that begins like this is CityJSON."""
    return re.search(rb'"type"\s*:\s*"CityJSON', head) is not None


def read_cityjson(path: Path, crs: str | None = None) -> MemoryLayer:
    """The buildings of a CityJSON or CityJSONSeq file.

    Args:
        path: the file.
        crs: coordinate reference system, against what the file says.

    Raises:
        InputError: the file is damaged, or names no coordinate reference system.
    """
    try:
        documents = _documents(path.read_text(encoding="utf-8"))
        first = documents[0]
        named = crs or _named_crs(first.get("metadata", {}).get("referenceSystem"))
        if named is None:
            raise InputError(
                "the file names no coordinate reference system; give `crs`, e.g. 'EPSG:7415', or "
                "'local' for metres"
            )
        geometries: list[Any] = []
        attributes: list[dict[str, Any]] = []
        transform = first.get("transform", {})
        for document in documents:
            own = document.get("transform", transform)
            vertices = np.asarray(document.get("vertices", []), dtype=float).reshape(-1, 3)
            vertices = vertices * np.asarray(own.get("scale", (1, 1, 1)), dtype=float)
            vertices = vertices + np.asarray(own.get("translate", (0, 0, 0)), dtype=float)
            for thing in document.get("CityObjects", {}).values():
                if thing.get("type") in _KINDS and thing.get("geometry"):
                    shape, height = _prism(thing["geometry"], vertices)
                    known = {**thing.get("attributes", {}), "building": "yes"}
                    if height > _FLAT_M:
                        known = {"building": "yes", "height": round(height, 3)}
                    geometries.append(shape)
                    attributes.append(known)
    except InputError:
        raise
    except (
        AttributeError,
        IndexError,
        KeyError,
        OSError,
        RecursionError,
        OverflowError,
        TypeError,
        ValueError,
    ) as error:
        raise InputError(
            f"not readable as CityJSON ({type(error).__name__}: {' '.join(str(error).split())[:80]}"
            "); check it with a validator, it may be cut off"
        ) from error
    return MemoryLayer(parse_crs(named), geometries, attributes)


def _documents(text: str) -> list[dict[str, Any]]:
    """The one document, or the lines of a sequence."""
    try:
        found = [json.loads(text)]
    except ValueError:
        found = [json.loads(line) for line in text.splitlines() if line.strip()]
    if not all(isinstance(document, dict) for document in found) or not found:
        raise ValueError("expected a JSON object")
    return found


def _named_crs(reference: Any) -> str | None:
    if not isinstance(reference, str) or not reference.strip():
        return None
    codes = re.findall(r"EPSG(?:/[^/]*/|:[^:]*:|::?)(\d+)", reference)
    return f"EPSG:{'+'.join(codes[:2])}" if codes else reference


def _prism(models: list[dict[str, Any]], vertices: NDArray[np.float64]) -> tuple[Any, float]:
    """Footprint and height of the most detailed model of level 1 or 2, else of the first."""
    shapely = require("shapely", "geo")

    def detail(model: dict[str, Any]) -> float:
        level = float(str(model.get("lod", 0)) or 0)
        return level if level < 3 else 0.5

    surfaces = list(_surfaces(max(models, key=detail).get("boundaries", [])))
    plans, z = [], [np.inf, -np.inf]
    for rings in surfaces:
        corners = [vertices[np.asarray(ring, dtype=np.int64)] for ring in rings]
        for ring in corners:
            if len(ring):
                z = [min(z[0], ring[:, 2].min()), max(z[1], ring[:, 2].max())]
        if len(corners[0]) >= 3:
            plan = shapely.Polygon(
                corners[0][:, :2], [r[:, :2] for r in corners[1:] if len(r) >= 3]
            )
            if plan.area > 1e-6:
                plans.append(plan if plan.is_valid else shapely.make_valid(plan))
    if not plans:
        return None, 0.0
    return shapely.union_all(plans), float(z[1] - z[0])


def _surfaces(boundaries: Any) -> Any:
    """Every surface ``[ring, vertex index]`` of nested boundaries, however deep they are nested."""
    if not isinstance(boundaries, list) or not boundaries:
        return
    inner = boundaries[0]
    if isinstance(inner, list) and inner and isinstance(inner[0], int):
        yield boundaries
        return
    for part in boundaries:
        yield from _surfaces(part)
