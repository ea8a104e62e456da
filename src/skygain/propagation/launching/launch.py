"""The ray launcher as a model: gain of whole maps, the same bytes for any number of threads.

Work is cut into a fixed number of shares, each with a sum of its own, and the sums are added in
their order. So threads change when a share is done, never what comes out.
"""

from __future__ import annotations

__all__ = ["MODEL_VERSION", "Launched", "Launching", "launch", "launch_combined", "launch_gain_db"]

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.ground.errors import InputError
from skygain.propagation.base import (
    check_altitudes,
    check_frequency,
    check_transmitters,
    wavelength_m,
)
from skygain.propagation.launching.antenna import Antenna
from skygain.propagation.launching.corners import diffract_edges, edge_windows, walled_cells
from skygain.propagation.launching.fans import (
    Corners,
    empty_book,
    fan_out,
    new_book,
    strengths,
    vertical_corners,
)
from skygain.propagation.launching.following import MOST_REFLECTIONS
from skygain.propagation.launching.geometry import Geometry, city_geometry
from skygain.propagation.launching.materials import (
    GROUND_THICKNESS_M,
    MATERIALS,
    WALL_THICKNESS_M,
    slab_table,
)
from skygain.propagation.launching.rays import launch_sector
from skygain.propagation.launching.sight import edge_rows
from skygain.propagation.launching.wedge import transition_table
from skygain.propagation.mesh import city_buildings, risen

MODEL_VERSION = 2
"""rises whenever the launcher's numbers change"""

_SHARES = 8
"""into how many parts the work is cut, whatever the number of threads"""
_ALTITUDES = 32
"""most altitudes whose diffraction is computed together"""
_ON_WALL_M = 1e-3
"""a transmitter nearer to a wall than this stands on it"""


@dataclass(frozen=True)
class Launching:
    """How a map is launched."""

    frequency_hz: float = 5e9
    """carrier frequency, 0.3 to 100 GHz"""
    max_reflections: int = 3
    """most reflections on one path, at walls, roofs and the ground together"""
    diffraction: bool = True
    """whether paths over one diffracting edge are added"""
    azimuths: int = 8192
    """vertical planes before intervals are halved"""
    halvings: int = 6
    """how often an interval of azimuth is halved while its borders meet different walls"""
    compared_walls: int = 4
    """walls, one reflection after the other, that two borders have to share"""
    points: int = 2
    """places along a side of a cell for the diffracted field, twice as many where it is lit in
    part"""
    ground: str = "concrete"
    """material of the ground"""
    wedge: str = "reciprocal"
    """weights of the reflections at a diffracting edge: ``"reciprocal"``, or ``"sionna"`` to repeat
    those of Sionna RT beside it"""
    combined: bool = False
    """whether paths reflect before and after a diffraction at a vertical corner"""
    fans: int = 512
    """azimuths round a corner, before intervals are halved, where paths are combined"""
    fan_halvings: int = 3
    """how often these intervals are halved"""
    weakest_db: float = 40.0
    """arrivals weaker than this below the strongest of a corner are left out"""
    threads: int = 1
    """processor threads; the numbers do not depend on them"""

    def __post_init__(self) -> None:
        whole = {
            "max_reflections": (0, MOST_REFLECTIONS),
            "azimuths": (16, 2**24),
            "halvings": (0, 12),
            "compared_walls": (0, 8),
            "points": (1, 64),
            "fans": (16, 2**16),
            "fan_halvings": (0, 8),
            "threads": (1, 1024),
        }
        for name, (least, most) in whole.items():
            value = getattr(self, name)
            if (
                isinstance(value, bool)
                or not isinstance(value, int | np.integer)
                or not (least <= value <= most)
            ):
                raise InputError(
                    f"{name} must be a whole number from {least} to {most}, got {value!r}"
                )
        if not 0.3e9 <= self.frequency_hz <= 100e9:
            raise InputError(
                "ray launching covers 0.3 to 100 GHz (the range of the materials), got "
                f"{self.frequency_hz / 1e9:g} GHz; give frequency_hz in hertz, for example 5e9"
            )
        if self.wedge not in ("reciprocal", "sionna"):
            raise InputError(f"wedge must be 'reciprocal' or 'sionna', got {self.wedge!r}")
        if self.ground not in MATERIALS:
            raise InputError(
                f"unknown material of the ground {self.ground!r}; known: {', '.join(MATERIALS)}"
            )

    @property
    def facts(self) -> dict[str, Any]:
        """What decides the numbers, for the attributes of a file."""
        facts = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "threads"}
        if not self.combined:
            for name in ("combined", "fans", "fan_halvings", "weakest_db"):
                del facts[name]
        model = "launch-combined" if self.combined else "launch"
        return {"model": model, "model_version": MODEL_VERSION, **facts}


@dataclass(frozen=True)
class Launched:
    """Launched maps."""

    gain_db: NDArray[np.float32]
    """``[transmitter, altitude, row, col]``; -inf where no ray reached, so that a maximum with
    another model works; means nothing inside buildings"""
    ray_reached: NDArray[np.bool_]
    """``[transmitter, altitude, row, col]`` whether a ray reached the cell"""
    settings: Launching = field(default_factory=Launching)
    """how it was launched"""


def launch(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """The model ``launch``: the gain of `launch_gain_db`, -inf where no ray arrived."""
    settings = Launching(frequency_hz=float(frequency_hz))
    return launch_gain_db(city, transmitters_m, altitudes_m, settings=settings).gain_db


def launch_combined(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
) -> NDArray[np.float32]:
    """The model ``launch-combined``: as `launch`, with reflections before and after a corner."""
    settings = Launching(frequency_hz=float(frequency_hz), combined=True)
    return launch_gain_db(city, transmitters_m, altitudes_m, settings=settings).gain_db


def launch_gain_db(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    settings: Launching | None = None,
    antenna: Antenna | None = None,
) -> Launched:
    """Launch rays from each transmitter to each cell of the city's grid at each altitude.

    Over relief the ground stops rays, but reflects none; walls, roofs and edges do all they do over
    level ground.

    Args:
        city: polygons with their materials, or a height raster that boxes of concrete are made
            from.
        transmitters_m: ``[transmitter, (x, y, z)]`` in the city's metres, z above the street;
            anywhere outside the buildings, roofs included.
        altitudes_m: heights of the receiving cells above the street.
        settings: how to launch.
        antenna: of the transmitter; isotropic and vertically polarised when left out.

    Raises:
        InputError: an argument that cannot be used.
    """
    settings, antenna = settings or Launching(), antenna or Antenna()
    check_frequency(settings.frequency_hz)
    transmitters, altitudes = check_transmitters(city, transmitters_m), check_altitudes(altitudes_m)
    buildings = city_buildings(city) if city.is_level else risen(city)
    kinds = sorted({b.material for b in buildings} | {"concrete"})
    geometry = city_geometry(city, buildings, [kinds.index(b.material) for b in buildings])
    if not city.is_level:
        beneath = [city.ground_at(x, y) - city.ground_m.min() for x, y, _ in transmitters]
        transmitters = transmitters + np.c_[np.zeros((len(beneath), 2)), beneath]
    _check_off_walls(geometry, transmitters)
    thickness = [WALL_THICKNESS_M] * len(kinds) + [GROUND_THICKNESS_M]
    slabs = slab_table([*kinds, settings.ground], thickness, settings.frequency_hz)
    job = _Launch(city, geometry, altitudes, settings, antenna, slabs)
    area = city.grid.spacing_m**2
    scale = (wavelength_m(settings.frequency_hz) / (4 * np.pi)) ** 2
    power = np.stack([scale * job.power(transmitter, area) for transmitter in transmitters])
    with np.errstate(divide="ignore"):
        gain = (10 * np.log10(power)).astype(np.float32)
    return Launched(gain, power > 0, settings)


@dataclass(frozen=True)
class _Launch:
    """What all transmitters of a call share."""

    city: City
    geometry: Geometry
    altitudes: NDArray[np.float64]
    settings: Launching
    antenna: Antenna
    slabs: NDArray[np.complex128]

    def power(self, transmitter: NDArray[np.float64], area_m2: float) -> NDArray[np.float64]:
        """``[altitude, row, col]`` mean of |E|² for a unit field at unit length."""
        corners = vertical_corners(self.geometry) if self.settings.combined else None
        books = [new_book(corners) if corners else empty_book() for _ in range(_SHARES)]
        count = len(self.altitudes)
        power = self._shared(
            lambda share, out: self._rays(share, transmitter, books[share], out), count
        )
        if corners is not None and self.settings.diffraction:
            chosen = self._arrivals(books)
            power += self._shared(
                lambda share, out: self._fans(corners, books[share], chosen[share], out), count
            )
        power /= area_m2
        if self.settings.diffraction and len(self.geometry.edges.length_m):
            edges = self.geometry.edges
            windows, found = edge_windows(
                transmitter,
                edges.origin_m,
                edges.along,
                edges.length_m,
                edges.normals,
                self._world,
            )
            rows = edge_rows(transmitter, edges, windows, found)
            for first in range(0, len(self.altitudes), _ALTITUDES):
                some = slice(first, first + _ALTITUDES)
                power[some] += self._edge_power(rows, self.altitudes[some])
        return power

    @property
    def _world(self) -> tuple[NDArray[Any], ...]:
        g = self.geometry
        return (g.walls, g.owner, g.first, g.listed, g.tallest_m, g.frame, g.ground_m)

    @property
    def _theory(self) -> tuple[float, NDArray[np.complex128], bool]:
        wave_number = 2 * np.pi / wavelength_m(self.settings.frequency_hz)
        return wave_number, _transition(), self.settings.wedge == "sionna"

    def _shared(
        self, work: Callable[[int, NDArray[np.float64]], object], altitudes: int
    ) -> NDArray[np.float64]:
        """Do all shares of a work and add their sums in order."""
        shape = (altitudes, *self.city.grid.shape)
        total = np.zeros(shape)

        def done(share: int) -> NDArray[np.float64]:
            out = np.zeros(shape)
            work(share, out)
            return out

        if self.settings.threads == 1:
            for share in range(_SHARES):
                total += done(share)
            return total
        with ThreadPoolExecutor(self.settings.threads) as pool:
            for out in pool.map(done, range(_SHARES)):
                total += out
        return total

    def _arrivals(self, books: list[tuple[Any, ...]]) -> list[NDArray[np.int64]]:
        """The arrivals of each share that are not much weaker than the best at their corner."""
        antenna = (self.antenna.field, self.antenna.pattern)
        ground = len(self.slabs) - 1
        found = [strengths(b, self.altitudes[0], *antenna, self.slabs, ground) for b in books]
        corner = [book[6][: len(power), 0] for book, power in zip(books, found, strict=True)]
        best = np.zeros(1 + max((int(c.max()) for c in corner if len(c)), default=0))
        for c, power in zip(corner, found, strict=True):
            np.maximum.at(best, c, power)
        share = 10 ** (-self.settings.weakest_db / 10)
        kept = [
            np.flatnonzero(power >= share * best[c]) for c, power in zip(corner, found, strict=True)
        ]
        return [k[np.argsort(c[k], kind="stable")] for c, k in zip(corner, kept, strict=True)]

    def _fans(
        self,
        corners: Corners,
        book: tuple[Any, ...],
        chosen: NDArray[np.int64],
        out: NDArray[np.float64],
    ) -> None:
        fan_out(
            chosen,
            book,
            corners.span_m,
            corners.faces,
            corners.material,
            self.settings.fans,
            self.settings.fan_halvings,
            min(self.settings.compared_walls, 3),
            self.settings.max_reflections,
            self.antenna.field,
            self.antenna.pattern,
            self._theory,
            self.altitudes,
            self.slabs,
            len(self.slabs) - 1,
            self._world,
            self.city.grid.shape,
            empty_book(),
            out,
        )

    def _rays(
        self,
        share: int,
        transmitter: NDArray[np.float64],
        book: tuple[Any, ...],
        out: NDArray[np.float64],
    ) -> None:
        settings = self.settings
        total = settings.azimuths
        launch_sector(
            share * total // _SHARES,
            (share + 1) * total // _SHARES,
            total,
            settings.halvings,
            settings.compared_walls,
            transmitter,
            settings.max_reflections,
            self.antenna.field,
            self.antenna.pattern,
            self.altitudes,
            self.slabs,
            len(self.slabs) - 1,
            self._world,
            self.city.grid.shape,
            book,
            out,
        )

    def _edge_power(
        self, rows: NDArray[np.float64], altitudes: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """What edges (`edge_rows`) diffract to some altitudes."""
        shape = self.city.grid.shape
        outdoors = np.zeros(shape, dtype=np.int64)
        for j, altitude in enumerate(altitudes):
            outdoors |= (~self.city.obstructed(float(altitude))).astype(np.int64) << j
        walled = walled_cells(altitudes, shape, self._world)
        west, south, _, _ = self.city.grid.bounds_m
        physics = (self._theory, self.antenna.field, self.antenna.pattern, self.slabs)

        def diffract(share: int, out: NDArray[np.float64]) -> None:
            diffract_edges(
                share,
                len(rows),
                _SHARES,
                rows,
                physics,
                altitudes,
                outdoors,
                walled,
                (west, south, self.city.grid.spacing_m),
                np.stack(np.polynomial.legendre.leggauss(self.settings.points)),
                self._world,
                out,
            )

        return self._shared(diffract, len(altitudes))


@lru_cache(maxsize=1)
def _transition() -> NDArray[np.complex128]:
    return transition_table()


def _check_off_walls(geometry: Geometry, transmitters: NDArray[np.float64]) -> None:
    """Raise `InputError` if a transmitter stands on a wall, where its side would be open."""
    walls = geometry.walls
    step = walls[:, 2:4] - walls[:, :2]
    for x, y, z in transmitters:
        offset = np.array([x, y]) - walls[:, :2]
        along = np.clip((offset * step).sum(axis=1) / (step**2).sum(axis=1), 0, 1)
        away = np.hypot(*(offset - along[:, None] * step).T)
        if np.any((away < _ON_WALL_M) & (walls[:, 6] <= z) & (z <= walls[:, 7])):
            raise InputError(
                f"the transmitter at x={x:g} m, y={y:g} m, z={z:g} m stands on a wall; move it "
                "away from the building"
            )
