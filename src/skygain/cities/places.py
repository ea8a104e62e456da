"""Positions that a person gives, checked against the map they are meant for.

Two numbers can be metres or degrees, and in either order. A position is accepted where it can mean
one thing only, and refused with the likely reason where it is farther from the map than ten times
the map's size.
"""

from __future__ import annotations

__all__ = ["FAR", "check_near", "position_on"]

from collections.abc import Iterable, Sequence

import numpy as np

from skygain.grid import Grid
from skygain.ground.errors import InputError

FAR = 10.0
"""a point farther from the map than this many times its longer side belongs to another map"""


def position_on(
    grid: Grid, numbers: Sequence[float], *, name: str = "transmitter"
) -> tuple[float, float]:
    """Metres (x, y) that two numbers mean on a map.

    Args:
        grid: the map.
        numbers: x, y in its metres, or latitude, longitude in degrees if it has a place on Earth.
        name: the parameter they were given as, for the message.

    Raises:
        InputError: they lie farther from the map than `FAR` times its longer side.
    """
    first, second = (float(v) for v in numbers[:2])
    can_be_degrees = abs(first) <= 180 and abs(second) <= 180
    if _sides_away(grid, first, second) <= FAR:
        return first, second
    if grid.crs is None or not can_be_degrees:
        check_near(grid, (first, second), name=name)
    if abs(first) <= 90:
        x, y = (float(v) for v in grid.xy_m_at_latlon((first, second)))
        if _sides_away(grid, x, y) <= FAR:
            return x, y
    check_near(grid, (first, second), name=name)
    raise AssertionError("unreachable")  # pragma: no cover


def check_near(grid: Grid, xy_m: Sequence[float], *, name: str = "transmitter") -> None:
    """Raise `InputError` if a point lies farther from the map than `FAR` times its longer side.

    The message says how far, and what was probably meant.
    """
    x, y = (float(v) for v in xy_m[:2])
    if _sides_away(grid, x, y) <= FAR:
        return
    west, south, east, north = grid.bounds_m
    away = _metres_away(grid, x, y)
    shown, given = f"{away / 1000:,.0f} km", f"{x:.10g},{y:.10g}"
    can_be_degrees = abs(x) <= 180 and abs(y) <= 180
    if can_be_degrees and grid.crs is not None:
        meant = f"as metres it is {shown} off the map"
        if abs(x) <= 90:
            there = grid.xy_m_at_latlon((x, y))
            meant = f"as latitude, longitude it is {_off(grid, there)} off the map"
        if abs(y) <= 90 and _sides_away(grid, *grid.xy_m_at_latlon((y, x))) <= FAR:
            raise InputError(
                f"the {name} {given} seems to be longitude, latitude; latitude comes first: give "
                f"`{name}={y:.10g},{x:.10g}`"
            )
        row, col = (n / 2 for n in grid.shape)
        latitude, longitude = grid.latlon((row, col))
        raise InputError(
            f"the {name} {given} is not on this map: {meant}, whose middle is "
            f"{latitude:.5f},{longitude:.5f}; give `{name}` as latitude,longitude or in the map's "
            f"metres (x {west:.0f} to {east:.0f}, y {south:.0f} to {north:.0f})"
        )
    if _sides_away(grid, y, x) <= FAR:
        raise InputError(
            f"the {name} {given} is {shown} off the map, and x and y seem exchanged: give "
            f"`{name}={y:.10g},{x:.10g}`"
        )
    reason = "it may be of another projection"
    if grid.crs is None:
        reason = "the map has no place on Earth, so only its own metres mean something"
    raise InputError(
        f"the {name} {given} is {shown} off the map, which covers x {west:.0f} to {east:.0f} m, y "
        f"{south:.0f} to {north:.0f} m; {reason}: give another `{name}`, or the right `crs`"
    )


def _metres_away(grid: Grid, x_m: float, y_m: float) -> float:
    west, south, east, north = grid.bounds_m
    return float(np.hypot(max(west - x_m, 0, x_m - east), max(south - y_m, 0, y_m - north)))


def _sides_away(grid: Grid, x_m: float, y_m: float) -> float:
    """Distance from the map in units of its longer side; infinite for what is no number."""
    if not np.isfinite([x_m, y_m]).all():
        return np.inf
    return _metres_away(grid, x_m, y_m) / (grid.spacing_m * max(grid.shape))


def _off(grid: Grid, xy_m: Iterable[float]) -> str:
    x, y = (float(v) for v in xy_m)
    if not np.isfinite([x, y]).all():
        return "thousands of km"
    return f"{_metres_away(grid, x, y) / 1000:,.0f} km"
