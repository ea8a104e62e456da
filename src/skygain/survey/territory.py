"""Where a survey takes place: the city as it was read, the altitude, the areas drawn by hand."""

from __future__ import annotations

__all__ = [
    "above_zero",
    "asked_city",
    "asked_position",
    "at_sea_level",
    "bounded",
    "city_around",
    "parse_position",
]

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.declared import part
from skygain.ground.errors import InputError
from skygain.scenario import Scenario
from skygain.survey.requests import CityRequest, TerritoryRequest

if TYPE_CHECKING:
    from skygain.cities import Reading
    from skygain.instruments.recording import Recording


def asked_city(request: CityRequest) -> Reading:
    """The city that a request names, with the account of what its reader assumed.

    Raises:
        InputError: see `skygain.cities.read_city`.
    """
    from skygain.cities import CityOptions, read_city

    options = part(request, CityRequest)
    spec = str(options.pop("city"))
    from_lines = spec.lower().endswith((".geojsonl", ".geojsons", ".ndjson", ".jsonl"))
    skip_bad = from_lines and bool(getattr(request, "skip_bad", False))
    return read_city(spec, CityOptions(**options, skip_bad=skip_bad))


def city_around(request: CityRequest, recording: Recording) -> Reading:
    """The city that a request names, for a map of ``recording``: where every reading lies beside
    the city's own cells, as on the streets around a block, the map is widened to hold both.

    Raises:
        InputError: see `skygain.cities.read_city`; or one of city and recording has no place.
    """
    from skygain.instruments.gridded import bounds_of_both

    reading = asked_city(request)
    bounds = None if request.box else bounds_of_both(recording, reading.city.grid)
    if bounds is None:
        return reading
    try:
        wider = asked_city(replace(request, box=bounds))
    except InputError:  # a city that has no box is as large as it is
        return reading
    shapes = [f"{rows} x {cols}" for rows, cols in (reading.city.grid.shape, wider.city.grid.shape)]
    told = (
        f"no reading lies on the city's {shapes[0]} cells, all lie beside them: the map is widened "
        f"to {shapes[1]} cells"
    )
    return replace(wider, remarks=(*wider.remarks, told))


def asked_position(
    text: str, grid: Grid, *, name: str = "transmitter"
) -> tuple[float, float, float]:
    """A position ``"x,y[,z]"`` or ``"latitude,longitude[,z]"``, given as the parameter ``name``, in
    metres of the map; z is 1.5 m when left out.

    Raises:
        InputError: it cannot be read, or lies off the map (see `skygain.cities.places`).
    """
    from skygain.cities.places import position_on

    first, second, z = parse_position(text, name=name)
    x, y = position_on(grid, (first, second), name=name)
    return x, y, z


def parse_position(text: str, *, name: str = "transmitter") -> tuple[float, float, float]:
    """``"x,y"`` or ``"x,y,z"`` in metres; z is 1.5 m when left out.

    >>> parse_position("120, 80")
    (120.0, 80.0, 1.5)
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not np.isfinite(numbers).all():
        raise InputError(
            f"cannot read the position {text!r}; give `{name}` as latitude,longitude or x,y in "
            "metres, each with the height as a third number if need be, for example 120,80,1.5"
        )
    x, y, *z = numbers
    return x, y, z[0] if z else 1.5


def at_sea_level(
    city: City, altitude_m: float, position_m: tuple[float, float, float] | None
) -> tuple[City, float, tuple[float, float, float] | None, float]:
    """City, altitude and position as a flight sees them that keeps ``altitude_m`` above the sea
    (see `Scenario.at_level`), and the height of their common zero.

    Raises:
        InputError: the level lies below the lowest ground.
    """
    scenario = Scenario.at_level(city, altitude_m, transmitter_m=position_m)
    assert scenario.datum_m is not None
    return scenario.city, scenario.uav_altitude_m, scenario.transmitter_m, scenario.datum_m


def above_zero(level_m: float, datum_m: float) -> float:
    """The altitude above the common zero of a level above the sea.

    Raises:
        InputError: the level lies below the lowest ground.
    """
    if not level_m > datum_m:
        raise InputError(
            f"`map_altitude_m={level_m:g}` lies below the lowest ground, {datum_m:g} m above the "
            "sea; give a higher level, or leave `above_sea` out"
        )
    return level_m - datum_m


def bounded(scenario: Scenario, request: TerritoryRequest) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario within the areas that were drawn, and what is to be told of them.

    Raises:
        InputError: a file cannot be read or does not touch the map, or nothing is left to fly or to
            map.
    """
    from skygain.cities.areas import read_areas

    notes: list[str] = []
    if request.area is not None:
        areas = read_areas(request.area, scenario.grid, name="area")
        mask = areas.mask()
        notes += [f"{request.area.name}: the map is wanted in {mask.mean():.1%} of the cells"]
        notes += areas.notes
        scenario = replace(scenario, wanted=mask)
    if request.no_fly is not None:
        zones = read_areas(request.no_fly, scenario.grid, name="no_fly")
        # over a hill a level flight is lower above the ground than its altitude: no ceiling counts
        level = scenario.datum_m is not None
        mask = zones.mask(None if level else scenario.uav_altitude_m)
        if level and np.isfinite(zones.ceiling_m).any():
            notes.append("ceilings above ground do not count for a flight that keeps a level")
        notes += [
            f"{request.no_fly.name}: no flight over {mask.mean():.1%} of the cells at "
            f"{scenario.altitude_text}"
        ]
        notes += zones.notes
        if scenario.no_fly is not None:
            mask = mask | scenario.no_fly
        scenario = replace(scenario, no_fly=np.asarray(mask))
    return scenario, tuple(notes)
