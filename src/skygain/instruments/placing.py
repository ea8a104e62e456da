"""Where the readings of a log were taken: degrees or metres, their signs, and what cannot be a
place."""

from __future__ import annotations

__all__ = ["check_degrees", "placed", "rough_metres", "turn_degrees"]

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.frames import parse_crs
from skygain.ground.errors import InputError
from skygain.instruments.lines import Lines, keep_lines
from skygain.instruments.tables import Table
from skygain.instruments.values import texts

MOST_LETTERS = 0.9
"""share of letters of a hemisphere from which a column counts as one of them"""
_LOCAL_SPAN = 1.5
"""a survey whose x and y span less than this, both in the range of degrees, is in degrees"""
_DEGREE_M = 111_000.0


def turn_degrees(lines: Lines, found: dict[str, Any], index: Mapping[str, int]) -> None:
    """Degrees with their sign, where letters in a column of their own say south or west, and as
    degrees where they are whole steps of 1e-7."""
    for role, axis, letters in (
        ("north_south", "latitude", "NS"),
        ("east_west", "longitude", "EWO"),
    ):
        if role not in index:
            continue
        said = np.array([str(t)[:1].upper() for t in texts(lines.columns[index[role]])])
        known = np.isin(said, list(letters))
        if known.mean() > MOST_LETTERS:
            found[axis] = np.where(np.isin(said, ("S", "W")), -1.0, 1.0) * np.abs(found[axis])
    size = [np.abs(found[axis]) for axis in ("latitude", "longitude")]
    if all(len(v) and v.min() > 1e7 and (v == np.rint(v)).all() for v in size) and (
        size[0].max() <= 9e8 and size[1].max() <= 3.6e9
    ):
        lines.notes.append("latitude and longitude are steps of 1e-7 degrees")
        found["latitude"], found["longitude"] = found["latitude"] / 1e7, found["longitude"] / 1e7


def check_degrees(lines: Lines, found: dict[str, Any]) -> None:
    latitude, longitude = found["latitude"], found["longitude"]
    nowhere = (latitude == 0) & (longitude == 0)
    if nowhere.any():
        first = lines.line[nowhere][0]
        lines.notes.append(
            f"{int(nowhere.sum())} lines left out: the position is 0, 0, which a receiver writes "
            f"before it knows where it is, first line {first}"
        )
        keep_lines(lines, found, ~nowhere)
        latitude, longitude = found["latitude"], found["longitude"]
    wrong = (np.abs(latitude) > 90) | (longitude < -180) | (longitude > 360)
    keep = lines.bad(wrong, lambda i: _position_problem(latitude[i], longitude[i]))
    keep_lines(lines, found, keep)


def _position_problem(latitude: float, longitude: float) -> str:
    """What is wrong with a position in degrees."""
    size = abs(latitude), abs(longitude)
    in_minutes = all(v % 100 < 60 for v in size) and 100 < size[0] < 9000 and size[1] < 18_000
    if in_minutes:
        return (
            f"the position is {latitude:.7g}, {longitude:.7g}, no degrees; if these are degrees "
            "and minutes as NMEA 0183 writes them, convert them to degrees, and if they are "
            "metres, name them as y and x with `columns=x=NAME,y=NAME`"
        )
    if max(abs(latitude), abs(longitude)) > 1000:
        return (
            f"the position is {latitude:.7g}, {longitude:.7g}, no degrees; if these are metres, "
            "name them as y and x with `columns=x=NAME,y=NAME`"
        )
    if abs(latitude) > 90:
        if abs(longitude) <= 90 and abs(latitude) <= 180:
            return (
                f"the latitude is {latitude:g}, beyond 90 degrees, so latitude and longitude look "
                "swapped; name them with `columns=latitude=NAME,longitude=NAME`"
            )
        return f"the latitude is {latitude:g}, expected −90 to 90 degrees"
    return f"the longitude is {longitude:g}, expected −180 to 180 degrees"


def rough_metres(values: Mapping[str, NDArray]) -> NDArray[np.float64]:
    """``[n, 2]`` places in metres good enough to tell them apart."""
    if "x" in values:
        return np.column_stack([values["x"], values["y"]])
    latitude = values["latitude"]
    shrink = np.cos(np.deg2rad(latitude.mean()))
    return np.column_stack([values["longitude"] * shrink, latitude]) * _DEGREE_M


def placed(
    values: Mapping[str, NDArray],
    names: Mapping[str, str],
    table: Table,
    asked_crs: str | None,
    notes: list[str],
) -> tuple[NDArray | None, NDArray | None, str | None]:
    """Degrees or metres, and the projection of the metres."""
    crs = asked_crs or table.crs
    parsed = parse_crs(crs)
    if "latitude" in values:
        latlon = np.column_stack([values["latitude"], values["longitude"]])
        if parsed is None or parsed.to_epsg() == 4326:
            return latlon, None, None
        raise InputError(
            f"{table.name} has latitudes and longitudes, which are taken as WGS 84; leave the CRS "
            f"of the recording, {crs!r}, out (`recording_crs`), or name x and y with "
            "`columns=x=NAME,y=NAME`"
        )
    xy = np.column_stack([values["x"], values["y"]])
    if parsed is not None and parsed.is_geographic:
        if not (np.abs(xy) <= (360, 90)).all():
            raise InputError(
                f"{crs!r} is in degrees, but columns {names['x']!r} and {names['y']!r} of "
                f"{table.name} are not ({xy[0, 0]:.7g}, {xy[0, 1]:.7g}); give a projection in "
                "metres, e.g. `recording_crs=EPSG:32617`"
            )
        if parsed.to_epsg() == 4326:
            return xy[:, ::-1].copy(), None, None
        return _to_wgs84(xy, parsed), None, None
    if parsed is None and crs is None and _looks_like_degrees(xy):
        notes.append(
            f"columns {names['x']!r} and {names['y']!r} look like degrees: taken as longitude and "
            "latitude (`recording_crs=local` says they are metres)"
        )
        return xy[:, ::-1].copy(), None, None
    if parsed is None:
        return None, xy, None
    if not parsed.is_projected or any(axis.unit_name != "metre" for axis in parsed.axis_info):
        raise InputError(
            f"{crs!r} is not a projection in metres; give one for x and y, e.g. "
            "`recording_crs=EPSG:32617`"
        )
    return None, xy, crs


def _to_wgs84(xy: NDArray, source: Any) -> NDArray:
    import pyproj

    lon, lat = pyproj.Transformer.from_crs(source, "EPSG:4326", always_xy=True).transform(*xy.T)
    return np.column_stack([lat, lon])


def _looks_like_degrees(xy: NDArray[np.float64]) -> bool:
    """Whether x and y can only be longitude and latitude: in their range, broken numbers, and
    nearer to each other than any survey in metres."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    in_range = bool((np.abs(xy) <= (180, 90)).all())
    several = len(np.unique(xy[:1000], axis=0)) > 2
    return in_range and several and bool(((high - low) < _LOCAL_SPAN).all())
