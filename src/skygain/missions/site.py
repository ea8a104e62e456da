"""The place of a mission: the city, the area, what to keep clear of, and where the UAVs stand."""

from __future__ import annotations

__all__ = ["Pad", "Site", "open_site"]

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError, require
from skygain.missions.clearance import Airspace, Ways, obstacles, reachable
from skygain.missions.requests import MissionNewRequest
from skygain.scenario import Scenario
from skygain.survey.territory import asked_city, asked_position

if TYPE_CHECKING:
    from skygain.cities import Reading
    from skygain.cities.areas import Areas

_WGS84 = "EPSG:4326"
_FEWEST_CELLS = 4


@dataclass(frozen=True, eq=False)
class Pad:
    """Where one UAV takes off and lands."""

    xy_m: NDArray[np.float64]
    """(x, y) in the map's metres"""
    ground_m: float
    """height of the ground there"""
    cell: NDArray[np.int64]
    """(row, col) of the flyable cell above it that its flight begins and ends with"""


@dataclass(frozen=True, eq=False)
class Site:
    """Everything about a mission that does not change while it is flown."""

    request: MissionNewRequest
    """what was asked for"""
    reading: Reading
    """the city file as it was read"""
    city: City
    """the part of it around the area"""
    area: Any
    """Shapely geometry of where the map is wanted and UAVs may be, in the map's metres"""
    zones: tuple[Any, ...]
    """Shapely polygons of the no-fly zones at the altitude of flight"""
    solid: tuple[Any, ...]
    """Shapely polygons of buildings and ground that reach up to the flight, less the clearance"""
    space: Airspace
    """where legs may lie"""
    scenario: Scenario
    """what predictor and planner may know"""
    pads: tuple[Pad, ...]
    """one for each UAV"""
    notes: tuple[str, ...]
    """what was read and assumed, a line each"""

    @property
    def grid(self) -> Grid:
        """The map's raster."""
        return self.city.grid

    @property
    def level_m(self) -> float | None:
        """Height of a flight that keeps a level, in the ground's zero; ``None`` where it follows
        the ground."""
        return self.request.altitude_m if self.request.above_sea else None

    @cached_property
    def area_m2(self) -> float:
        """Size of the area."""
        return float(self.area.area)

    @cached_property
    def flyable_share(self) -> float:
        """Share of the area's cells where a UAV may be."""
        return float(self.scenario.flyable.sum() / max(1, self.area_mask.sum()))

    @cached_property
    def area_mask(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells in the area."""
        assert self.scenario.wanted is not None
        return np.asarray(self.scenario.wanted)

    @cached_property
    def ways_home(self) -> tuple[Ways, ...]:
        """For each UAV the ways to its pad."""
        return tuple(Ways.to(self.space, pad.xy_m, pad.cell) for pad in self.pads)

    @cached_property
    def highest_m(self) -> float:
        """Height of the highest roof or ground of the map, in the ground's zero."""
        roofs = [float(self.city.surface_m.max())]
        for building in self.city.buildings:
            x, y = building.footprint_m.mean(axis=0)
            roofs.append(self.city.ground_at(x, y) + building.height_m)
        return max(roofs)

    def flight_height_m(self, x_m: float, y_m: float) -> float:
        """Height of a UAV above the ground's zero at a point."""
        if self.level_m is not None:
            return self.level_m
        return self.city.ground_at(x_m, y_m) + self.request.altitude_m

    def latlon(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """``[..., (latitude, longitude)]`` of ``xy_m[..., (x, y)]``."""
        xy = np.asarray(xy_m, dtype=float)
        cells = (xy - np.asarray(self.grid.origin_m)) / self.grid.spacing_m
        return self.grid.latlon(cells[..., ::-1])

    @property
    def altitude_text(self) -> str:
        """The altitude, and above what it is."""
        return self.scenario.altitude_text


def open_site(request: MissionNewRequest, reading: Reading | None = None) -> Site:
    """Read everything that a mission names, and check that it can be flown.

    Args:
        request: what is asked for.
        reading: the city, where it was read already.

    Raises:
        InputError: in one line, the first thing that cannot be flown.
    """
    reading = asked_city(request) if reading is None else reading
    city = reading.city
    if city.grid.crs is None:
        raise InputError(
            f"{city.name!r} has no place on Earth, and drones fly by latitude and longitude; give "
            "a georeferenced `city`, or its `crs`"
        )
    notes = list(reading.notes)
    areas = _areas(request.area, city.grid, "area")
    zones = _areas(request.no_fly, city.grid, "no_fly")
    shapely = require("shapely", "geo")
    if areas is not None:
        city = _around(city, shapely.union_all(np.array(areas.polygons)).bounds, request)
        notes += areas.notes
    west, south, east, north = city.grid.bounds_m
    area = shapely.box(west, south, east, north)
    if areas is not None:
        area = shapely.intersection(shapely.union_all(np.array(areas.polygons)), area)
    applied = _applied(zones, request, city) if zones is not None else []
    notes += zones.notes if zones is not None else ()
    solid = obstacles(
        city,
        request.altitude_m,
        request.clearance_m,
        request.altitude_m if request.above_sea else None,
    )
    space = Airspace.clear_of(city.grid, area, [*solid, *applied], request.clearance_m)
    mask = np.asarray(
        shapely.covers(_prepared(area), shapely.points(city.grid.xy_m(city.grid.cells)))
    ).reshape(city.grid.shape)
    if int(space.flyable.sum()) < _FEWEST_CELLS:
        raise InputError(
            f"no cell of the area can be flown at {request.altitude_m:g} m with "
            f"{request.clearance_m:g} m of clearance; give a larger `area`, a higher `altitude_m` "
            "or a smaller `clearance_m`"
        )
    pads, flyable = _pads(request, city, area, applied, solid, space)
    scenario = _scenario(request, city, mask, ~flyable)
    return Site(
        request,
        reading,
        city,
        area,
        tuple(applied),
        tuple(solid),
        replace(space) if flyable is space.flyable else _limited(space, flyable),
        scenario,
        pads,
        tuple(notes),
    )


def _limited(space: Airspace, flyable: NDArray[np.bool_]) -> Airspace:
    """The same space with its cells cut down to those that can be reached."""
    limited = Airspace(space.grid, space.free)
    flyable = flyable.copy()
    flyable.flags.writeable = False
    limited.__dict__["flyable"] = flyable
    return limited


def _prepared(shape: Any) -> Any:
    require("shapely", "geo").prepare(shape)
    return shape


def _areas(path: Path | None, grid: Grid, name: str) -> Areas | None:
    """The polygons of a file; drawn lines that cross themselves are refused, not mended."""
    if path is None:
        return None
    from skygain.cities.areas import read_areas
    from skygain.cities.vector import open_layer

    found = read_areas(path, grid, name=name)
    shapely = require("shapely", "geo")
    shapes, _ = open_layer(path, None, None).features(names=frozenset())
    for shape in shapes:
        if shape is None or shape.geom_type not in ("Polygon", "MultiPolygon"):
            continue
        if not shapely.is_valid(shape):
            reason = shapely.is_valid_reason(shape)
            raise InputError(
                f"{path.name}: the outline crosses itself ({reason}); draw it anew for `{name}`"
            )
    return found


def _around(city: City, bounds: tuple[float, ...], request: MissionNewRequest) -> City:
    """The part of the city that the area needs, with what stands near it."""
    grid, margin = city.grid, request.clearance_m + 2 * city.grid.spacing_m
    low = grid.cells_at((bounds[0] - margin, bounds[1] - margin))
    high = grid.cells_at((bounds[2] + margin, bounds[3] + margin))
    low = np.clip(low, 0, np.array(grid.shape) - 1)
    high = np.clip(high, low, np.array(grid.shape) - 1)
    size = high - low + 1
    return city.cropped(int(low[0]), int(low[1]), (int(size[0]), int(size[1])))


def _applied(zones: Areas, request: MissionNewRequest, city: City) -> list:
    """The zones that hold at the altitude of flight, or near it."""
    kept = []
    for polygon, floor, ceiling in zip(zones.polygons, zones.floor_m, zones.ceiling_m, strict=True):
        over_hills = request.above_sea and not city.is_level
        low, high = floor - request.clearance_m, ceiling + request.clearance_m
        if over_hills or low <= request.altitude_m <= high:
            kept.append(polygon)
    return kept


def _scenario(
    request: MissionNewRequest, city: City, wanted: NDArray[np.bool_], no_fly: NDArray[np.bool_]
) -> Scenario:
    transmitter = None
    if request.transmitter is not None:
        transmitter = asked_position(request.transmitter, city.grid)
    known: dict[str, Any] = {
        "no_fly": no_fly,
        "wanted": wanted,
        "transmitter_m": transmitter,
        "frequency_hz": request.frequency_hz,
    }
    if request.above_sea:
        return Scenario.at_level(city, request.altitude_m, **known)
    altitude = request.altitude_m
    return Scenario(city, uav_altitude_m=altitude, prediction_altitude_m=altitude, **known)


def _pads(
    request: MissionNewRequest,
    city: City,
    area: Any,
    zones: Sequence[Any],
    solid: Sequence[Any],
    space: Airspace,
) -> tuple[tuple[Pad, ...], NDArray[np.bool_]]:
    """The places where the UAVs stand, and the cells that can be reached from them."""
    homes = _homes(request, city.grid)
    for home in homes:
        _check_home(home, request, city, area, zones, solid, space)
    first = _cell_above(homes[0], space)
    flyable = reachable(space.flyable, first) & space.flyable
    limited = _limited(space, flyable)
    places: list[NDArray] = []
    if len(homes) == request.uavs:
        places = homes
    else:
        places = _spread(homes[0], request, limited)
    pads = []
    for place in places:
        cell = _cell_above(place, space)
        if not flyable[tuple(cell)]:
            raise InputError(
                "the homes lie in parts of the area that no clear way joins; give them in one "
                "part, or a smaller `clearance_m`"
            )
        pads.append(Pad(np.asarray(place), city.ground_at(*place), cell))
    for i, one in enumerate(pads):
        for other in pads[:i]:
            gap = math.dist(one.xy_m, other.xy_m)
            if gap < request.separation_m - 1e-6:
                raise InputError(
                    f"two homes are {gap:.1f} m apart, less than the separation of "
                    f"{request.separation_m:g} m; give other places for `home`, or one for all"
                )
    return tuple(pads), flyable


def _homes(request: MissionNewRequest, grid: Grid) -> list[NDArray]:
    homes = []
    if not request.home:
        latitude, longitude = grid.latlon([(n - 1) / 2 for n in grid.shape])
        raise InputError(
            "the take-off place is missing; give `home` as LAT,LON, e.g. "
            f"`home={latitude:.5f},{longitude:.5f}`, the middle of the map"
        )
    for text in request.home.split(";"):
        x, y, _ = asked_position(text, grid, name="home")
        homes.append(np.array([x, y]))
    if len(homes) not in (1, request.uavs):
        raise InputError(
            f"{len(homes)} homes for {request.uavs} UAVs; give one `home` for all, or one for each "
            "with semicolons between"
        )
    return homes


def _check_home(
    home: NDArray,
    request: MissionNewRequest,
    city: City,
    area: Any,
    zones: Sequence[Any],
    solid: Sequence[Any],
    space: Airspace,
) -> None:
    """Raise `InputError` with the reason why nobody can take off there."""
    shapely = require("shapely", "geo")
    point = shapely.Point(home)
    shown = f"the home {request.home.split(';')[0] if request.home else ''}"
    if not area.covers(point):
        away = area.distance(point)
        raise InputError(
            f"{shown} lies {away:.0f} m outside the area; give a `home` inside it, or a larger "
            "`area`"
        )
    if any(zone.covers(point) for zone in zones):
        raise InputError(f"{shown} lies inside a no-fly zone; give a `home` outside it")
    if city.roof_m(*home) > 0:
        raise InputError(
            f"{shown} lies in a building {city.roof_m(*home):.0f} m high; give a `home` on open "
            "ground"
        )
    if not space.free.covers(point):
        near = min(
            (one.distance(point), k) for k, one in enumerate([*solid, *zones, area.boundary])
        )
        what = "a building or the ground"
        if near[1] >= len(solid):
            what = "a no-fly zone" if near[1] < len(solid) + len(zones) else "the area's edge"
        raise InputError(
            f"{shown} is {near[0]:.1f} m from {what}, less than the clearance of "
            f"{request.clearance_m:g} m; give another `home`"
        )


def _cell_above(place: NDArray, space: Airspace) -> NDArray[np.int64]:
    """The flyable cell nearest to a place that is in clear sight of it."""
    grid, flyable = space.grid, space.flyable
    cells = np.argwhere(flyable)
    centre = grid.xy_m(cells)
    order = np.argsort(np.hypot(*(centre - place).T), kind="stable")[:64]
    for k in order:
        if space.clear(np.array([place, centre[k]])):
            return cells[k]
    raise InputError(
        f"no clear cell near the home at x {place[0]:.0f} m, y {place[1]:.0f} m; give another "
        "`home`, or a smaller `clearance_m`"
    )


def _spread(home: NDArray, request: MissionNewRequest, space: Airspace) -> list[NDArray]:
    """Places for all UAVs around one home: itself, and the nearest cells that keep the
    separation."""
    places = [home]
    centre = space.grid.xy_m(np.argwhere(space.flyable))
    order = np.argsort(np.hypot(*(centre - home).T), kind="stable")
    # starts are cells, which may lie half a cell nearer to each other than the pads
    apart = request.separation_m + space.grid.spacing_m
    for k in order:
        if len(places) == request.uavs:
            break
        if all(math.dist(centre[k], other) >= apart for other in places):
            places.append(centre[k])
    if len(places) < request.uavs:
        raise InputError(
            f"there is room for {len(places)} UAVs {request.separation_m:g} m apart, not for "
            f"{request.uavs}; give fewer `uavs`, a smaller `separation_m` or a larger `area`"
        )
    return places
