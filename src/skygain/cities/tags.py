"""What a building's attributes say about its height.

The vocabulary is OpenStreetMap's, with the spellings that other producers and file formats make of
it: names are compared without case and punctuation, so ``building:levels``, ``building_levels`` and
``BuildingLevels`` are one, and a Shapefile's ten letters ``building:l`` are understood too.
"""

from __future__ import annotations

__all__ = [
    "KNOWN_NAMES",
    "LEVEL_M",
    "BuildingTags",
    "parse_length_m",
    "parse_tags",
    "plain_name",
    "read_tags",
]

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

LEVEL_M = 3.0
"""height of a storey"""

_MAX_LENGTH_M = 1000.0
_MAX_LEVELS = 250.0

_HEIGHT = ("height", "buildingheight", "buildingh", "heightm")
_LEVELS = ("buildinglevels", "buildingl", "buildingle", "levels", "numfloors", "floors", "storeys")
_BASE = ("minheight", "buildingminheight")
_BASE_LEVEL = ("buildingminlevel", "minlevel", "minfloor")
_PART = ("buildingpart", "buildingp", "buildingpa")
_KIND = ("building",)
_PLACE = ("location",)

KNOWN_NAMES = frozenset(
    _HEIGHT + _LEVELS + _BASE + _BASE_LEVEL + _PART + _KIND + _PLACE + ("othertags", "alltags")
)
"""plain names of all attributes that are looked at"""

_NO = {"", "no", "false", "0", "none", "nan"}

_LENGTH = re.compile(r"~?\s*(\d+(?:\.\d*)?|\.\d+)\s*(m|metres?|meters?|ft|feet|foot|')?")
_FEET_INCHES = re.compile(r"(\d+(?:\.\d+)?)\s*(?:'|ft)\s*(\d+(?:\.\d+)?)\s*(?:\"|in|'')")
_HSTORE = re.compile(r'"((?:[^"\\]|\\.)*)"\s*=>\s*"((?:[^"\\]|\\.)*)"')


@dataclass(frozen=True)
class BuildingTags:
    """The attributes of one polygon, understood."""

    is_building: bool
    """whether it is tagged as a building or as part of one"""
    is_part: bool
    """whether it is tagged ``building:part``"""
    is_underground: bool
    """whether it is tagged ``location=underground``"""
    height_m: float | None
    """top above ground: ``height``, else levels times `LEVEL_M`, else ``None``"""
    base_m: float
    """underside above ground: ``min_height``, else ``building:min_level`` times `LEVEL_M`, else
    0"""
    from_levels: bool
    """whether the height comes from the number of levels"""
    misread: bool
    """whether a height or level is given that cannot be understood"""


def plain_name(name: str) -> str:
    """An attribute's name without case and punctuation.

    >>> plain_name("building:min_level")
    'buildingminlevel'
    """
    return re.sub(r"[^a-z0-9]", "", name.lower())


def parse_length_m(value: Any) -> float | None:
    """A length in metres, or ``None`` if it is none between 0 and 1000 m.

    Numbers are metres; a text may carry a unit and a decimal comma.

    >>> [parse_length_m(text) for text in (12, "12 m", "7,5", "40 ft", "10'", "6'6\\"", "tall", -1)]
    [12.0, 12.0, 7.5, 12.192, 3.048, 1.9812, None, None]
    """
    if isinstance(value, str):
        text = value.strip().lower().replace(",", ".")
        if match := _FEET_INCHES.fullmatch(text):
            length = 0.3048 * float(match[1]) + 0.0254 * float(match[2])
        elif match := _LENGTH.fullmatch(text):
            length = float(match[1]) * (0.3048 if match[2] in ("ft", "feet", "foot", "'") else 1.0)
        else:
            return None
    else:
        length = _number(value)
    return round(length, 6) if 0 <= length <= _MAX_LENGTH_M else None


def parse_tags(text: Any) -> dict[str, str]:
    """The ``other_tags`` column that GDAL makes of OpenStreetMap, as hstore or as JSON; what is
    neither gives nothing.

    >>> parse_tags('"height"=>"12","name"=>"The \\\\"Tower\\\\""')
    {'height': '12', 'name': 'The "Tower"'}
    """
    if isinstance(text, Mapping):
        return {str(k): str(v) for k, v in text.items()}
    if not isinstance(text, str):
        return {}
    if text.lstrip().startswith("{"):
        try:
            return parse_tags(json.loads(text))
        except (ValueError, RecursionError):
            return {}
    return {
        re.sub(r"\\(.)", r"\1", key): re.sub(r"\\(.)", r"\1", value)
        for key, value in _HSTORE.findall(text)
    }


def read_tags(attributes: Mapping[str, Any]) -> BuildingTags:
    """Understand a polygon's attributes, named by `plain_name`.

    A height of 0 is how many producers write "unknown", so it counts as missing.
    """
    kind, part = _text(attributes, _KIND), _text(attributes, _PART)
    is_part = part not in _NO
    height, misread = _first(attributes, _HEIGHT, parse_length_m)
    levels, misread_levels = _first(attributes, _LEVELS, _levels)
    base, misread_base = _first(attributes, _BASE, parse_length_m)
    base_level, misread_base_level = _first(attributes, _BASE_LEVEL, _levels)
    from_levels = height is None and levels is not None
    return BuildingTags(
        is_building=kind not in _NO or is_part,
        is_part=is_part,
        is_underground=_text(attributes, _PLACE) == "underground",
        height_m=LEVEL_M * levels if height is None and levels is not None else height,
        base_m=base if base is not None else LEVEL_M * (base_level or 0.0),
        from_levels=from_levels,
        misread=misread or misread_levels or misread_base or misread_base_level,
    )


def _first(
    attributes: Mapping[str, Any], names: tuple[str, ...], parse: Any
) -> tuple[float | None, bool]:
    """The first value above 0 under one of the names, and whether one was given that cannot be
    parsed."""
    misread = False
    for name in names:
        raw = attributes.get(name)
        if (
            raw is None
            or (isinstance(raw, float) and math.isnan(raw))
            or (isinstance(raw, str) and not raw.strip())
        ):
            continue
        value = parse(raw)
        misread |= value is None
        if value:
            return value, misread
    return None, misread


def _levels(value: Any) -> float | None:
    count = _number(value.strip().replace(",", ".") if isinstance(value, str) else value)
    return count if 0 <= count <= _MAX_LEVELS else None


def _number(value: Any) -> float:
    """NaN for anything but a number or its text."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _text(attributes: Mapping[str, Any], names: tuple[str, ...]) -> str:
    for name in names:
        value = attributes.get(name)
        if value is not None:
            return str(value).strip().lower()
    return ""
