"""What a building's attributes say about its height.

The vocabulary is OpenStreetMap's, with the spellings that other producers and file formats make of
it: names are compared without case and punctuation, so ``building:levels``, ``building_levels`` and
``BuildingLevels`` are one, and a Shapefile's ten letters ``building:l`` are understood too.
"""

from __future__ import annotations

__all__ = [
    "HEIGHT_NAMES",
    "KNOWN_NAMES",
    "LEVEL_M",
    "BuildingTags",
    "HeightField",
    "height_like",
    "parse_height_field",
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

_HEIGHT = (
    "height",
    "buildingheight",
    "buildingh",
    "heightm",
    "measuredheight",
    "hauteur",
    "altura",
    "altezza",
    "hoogte",
    "hoehe",
    "hhe",  # Höhe
    "renderheight",
    "estheight",
    "heightagl",
    "bldgheight",
    "gebhoehe",
    "gebaeudehoehe",
    "relhmax",
)
_HEIGHT_FT = ("heightft", "heightfeet", "buildingheightft", "buildingheightfeet", "roofheightft")
_LEVELS = (
    "buildinglevels",
    "buildingl",
    "buildingle",
    "levels",
    "numfloors",
    "floors",
    "storeys",
    "stories",
    "numstories",
    "storeysaboveground",
    "nbetages",
)
_ROOF_LEVELS = ("rooflevels",)
_ROOF_HEIGHT = ("roofheight",)
_BASE = ("minheight", "buildingminheight", "renderminheight")
_BASE_LEVEL = ("buildingminlevel", "minlevel", "minfloor")
_PART = ("buildingpart", "buildingp", "buildingpa")
_KIND = ("building",)
_PLACE = ("location",)
_UNDERGROUND = ("isunderground", "underground")
_CELLARS = ("buildinglevelsunderground",)
_ORDER = ("layer",)
_MATERIAL = ("buildingmaterial", "material")
_LAND = ("natural", "landuse", "leisure", "highway", "waterway")

HEIGHT_NAMES = frozenset(_HEIGHT + _HEIGHT_FT + _LEVELS)
"""plain names of the attributes that alone say how high a building is"""

KNOWN_NAMES = frozenset(
    _HEIGHT
    + _HEIGHT_FT
    + _LEVELS
    + _ROOF_LEVELS
    + _ROOF_HEIGHT
    + _BASE
    + _BASE_LEVEL
    + _PART
    + _KIND
    + _PLACE
    + _UNDERGROUND
    + _CELLARS
    + _ORDER
    + _LAND
    + _MATERIAL
    + ("othertags", "alltags", "tags", "altitudemode", "extrude")
)
"""plain names of all attributes that are looked at"""

_UNKNOWN = (-1.0, -99.0, -999.0, -9999.0)
"""numbers that producers write where they know none"""

_MATERIALS = {
    **{name: name for name in ("concrete", "brick", "wood", "glass", "marble", "metal")},
    **dict.fromkeys(("bricks", "sandstone", "mud", "adobe", "clay"), "brick"),
    **dict.fromkeys(("timber", "timber_framing"), "wood"),
    **dict.fromkeys(("stone", "limestone", "granite"), "marble"),
    **dict.fromkeys(("steel", "tin", "copper"), "metal"),
    "mirror": "glass",
}
"""class of ITU-R P.2040 of what OpenStreetMap calls a building's material"""

_NO = {"", "no", "false", "0", "none", "nan"}

_UNITS_M = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "feet", "foot", "'", "\u2032", "\u2019"), 0.3048),
    "cm": 0.01,
    "dm": 0.1,
}

_LENGTH = re.compile(
    r"(?:~|ca\.?|approx\.?|about)?\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-z'\u2032\u2019]*)"
)
_FEET_INCHES = re.compile(
    r"(\d+(?:\.\d+)?)\s*(?:['\u2032\u2019]|ft)\s*(\d+(?:\.\d+)?)\s*"
    r"(?:\"|in|''|\u2033|\u201d)"
)
_SEVERAL = re.compile(r"\s*[;|]\s*|\s*[-\u2013]\s*(?=[\d.])|\s+to\s+")
_HSTORE = re.compile(r'"((?:[^"\\]|\\.)*)"\s*=>\s*"((?:[^"\\]|\\.)*)"')
_HEIGHT_LIKE = re.compile(
    r"height|hgt|hght|hoehe|h\u00f6he|haut|altura|altezza|hoogte|roof|etage|floor|storey|stories|"
    r"level|relh|z_?max|dach|toit|tetto|h\u00f8yde|h\u00f8jde|h\u00f6jd|wysok|v\u00fd\u0161ka|korkeus|elev"
)


@dataclass(frozen=True)
class HeightField:
    """The attribute that was named to hold heights."""

    name: str
    """as the file calls it; ``"z"`` for the polygons' third coordinate"""
    unit_m: float = 1.0
    """metres in its unit"""


@dataclass(frozen=True)
class BuildingTags:
    """The attributes of one polygon, understood."""

    is_building: bool
    """whether it is tagged as a building or as part of one"""
    is_part: bool
    """whether it is tagged ``building:part``"""
    is_tall: bool
    """whether it has a height or levels and is no stretch of land or water: a building all the
    same"""
    is_underground: bool
    """whether it lies below the ground: said so, or on a layer below zero with no height or level
    above"""
    height_m: float | None
    """top above ground: the height named, else ``height`` and its kin, else levels (those of the
    roof too) times `LEVEL_M`, else ``None``"""
    base_m: float
    """underside above ground: ``min_height``, else ``building:min_level`` times `LEVEL_M`, else
    0"""
    from_levels: bool
    """whether the height comes from the number of levels"""
    misread: bool
    """whether a height or level is given that cannot be understood"""
    material: str = "concrete"
    """what its walls are of, by the classes of ITU-R P.2040: ``building:material``, concrete where
    it is missing or has no class"""
    is_beyond: bool = False
    """whether a height is given that no building has, as in another unit"""
    z_m: float | None = None
    """third coordinate of its highest corner, which may be above the ground or above the sea"""


def plain_name(name: str) -> str:
    """An attribute's name without case and punctuation.

    >>> plain_name("building:min_level")
    'buildingminlevel'
    """
    return re.sub(r"[^a-z0-9]", "", name.lower())


def parse_height_field(text: str | None) -> HeightField | None:
    """``NAME`` or ``NAME:unit``; the unit is what follows the last colon, if it is one.

    >>> parse_height_field("heightroof:ft"), parse_height_field("building:height")
    (HeightField(name='heightroof', unit_m=0.3048), HeightField(name='building:height', unit_m=1.0))
    """
    if text is None:
        return None
    name, _, unit = text.strip().rpartition(":")
    if name and unit.strip().lower() in _UNITS_M:
        return HeightField(name.strip(), _UNITS_M[unit.strip().lower()])
    return HeightField(text.strip())


def height_like(name: str) -> bool:
    """Whether an attribute's name sounds as if it said something of heights."""
    return _HEIGHT_LIKE.search(name.lower()) is not None


def parse_length_m(value: Any, unit_m: float = 1.0) -> float | None:
    """A length in metres, or ``None`` if it is none between 0 and 1000 m.

    Numbers are in ``unit_m`` metres; a text may carry its own unit and a decimal comma. Of several
    lengths (``12;15``, ``3-4``) the largest counts.

    >>> [parse_length_m(text) for text in (12, "12 m", "7,5", "40 ft", "10'", "6'6\\"", "12;15")]
    [12.0, 12.0, 7.5, 12.192, 3.048, 1.9812, 15.0]
    >>> [parse_length_m(text) for text in ("tall", -1, "12 barns")]
    [None, None, None]
    """
    if not isinstance(value, str):
        return _in_range(_number(value) * unit_m)
    found = [_one_length(part, unit_m) for part in _SEVERAL.split(value.strip().lower())]
    known = [length for length in found if length is not None]
    return max(known) if known and len(known) == len(found) else None


def _one_length(text: str, unit_m: float) -> float | None:
    text = text.replace(",", ".")
    if match := _FEET_INCHES.fullmatch(text):
        return _in_range(0.3048 * float(match[1]) + 0.0254 * float(match[2]))
    if (match := _LENGTH.fullmatch(text)) and (not match[2] or match[2] in _UNITS_M):
        return _in_range(float(match[1]) * (_UNITS_M[match[2]] if match[2] else unit_m))
    return None


def _in_range(length: float) -> float | None:
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


def read_tags(attributes: Mapping[str, Any], field: HeightField | None = None) -> BuildingTags:
    """Understand a polygon's attributes, named by `plain_name`.

    A height of 0 is how many producers write "unknown", so it counts as missing.

    Args:
        attributes: by `plain_name`; the one that ``field`` names under its own name too.
        field: the attribute whose value counts before all others.
    """
    kind, part = _text(attributes, _KIND), _text(attributes, _PART)
    is_part = part not in _NO
    height, misread = _first(attributes, _HEIGHT, parse_length_m)
    if height is None:
        height, feet = _first(attributes, _HEIGHT_FT, lambda value: parse_length_m(value, 0.3048))
        misread |= feet
    if field is not None:
        named, misread_named = _first(
            attributes, (field.name,), lambda value: parse_length_m(value, field.unit_m)
        )
        height, misread = (named, misread_named) if named or misread_named else (height, misread)
    levels, misread_levels = _first(attributes, _LEVELS, _levels)
    base, misread_base = _first(attributes, _BASE, parse_length_m)
    base_level, misread_base_level = _first(attributes, _BASE_LEVEL, _levels)
    from_levels = height is None and levels is not None
    if height is None and levels is not None:
        roof_m, _ = _first(attributes, _ROOF_HEIGHT, parse_length_m)
        roof_levels, _ = _first(attributes, _ROOF_LEVELS, _levels)
        height = LEVEL_M * levels + (roof_m or LEVEL_M * (roof_levels or 0.0))
    if height is None and _text(attributes, ("altitudemode",)) == "relativetoground":
        height = parse_length_m(attributes.get("@z")) or None
    order = _number(_text(attributes, _ORDER) or 0)
    return BuildingTags(
        is_building=kind not in _NO or is_part,
        is_part=is_part,
        is_tall=height is not None
        and kind not in ("no", "false")
        and _text(attributes, _LAND) in _NO,
        is_underground=_text(attributes, _PLACE) == "underground"
        or _text(attributes, _UNDERGROUND) not in _NO
        or (height is None and (order < 0 or _has_cellars_only(attributes))),
        height_m=height,
        base_m=base if base is not None else LEVEL_M * (base_level or 0.0),
        from_levels=from_levels,
        misread=misread or misread_levels or misread_base or misread_base_level,
        material=_MATERIALS.get(_text(attributes, _MATERIAL), "concrete"),
        is_beyond=any(
            _number(attributes.get(name)) > _MAX_LENGTH_M
            for name in (*_HEIGHT, *((field.name,) if field and field.unit_m == 1.0 else ()))
        ),
        z_m=attributes.get("@z"),
    )


def _has_cellars_only(attributes: Mapping[str, Any]) -> bool:
    """Whether it has levels below the ground and says that it has none above."""
    below, _ = _first(attributes, _CELLARS, _levels)
    return bool(below) and any(_number(attributes.get(name)) == 0 for name in _LEVELS)


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
            or _number(raw) in _UNKNOWN
        ):
            continue
        value = parse(raw)
        misread |= value is None
        if value:
            return value, misread
    return None, misread


def _levels(value: Any) -> float | None:
    """A number of storeys; the largest of ``3;4`` and ``3-4``, the sum of ``5+1``."""
    if isinstance(value, str):
        parts = [part.split("+") for part in _SEVERAL.split(value.strip().replace(",", "."))]
        count = max(sum(_number(number) for number in part) for part in parts)
        if not all(math.isfinite(_number(number)) for part in parts for number in part):
            return None
    else:
        count = _number(value)
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
