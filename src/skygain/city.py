"""A city: how high the ground is built at every cell, and the buildings that make it so.

``height_m`` and every altitude are above the ground of their cell; ``ground_m`` says where that is.
"""

from __future__ import annotations

__all__ = ["Building", "City"]

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.ground.errors import InputError


@dataclass(frozen=True)
class Building:
    """A prism: a footprint polygon raised to a height."""

    footprint_m: NDArray[np.float64]
    """``[corner, (x, y)]`` outer ring in metres, counter-clockwise, first corner not repeated"""
    height_m: float
    """height of the roof above the street"""
    base_m: float = 0.0
    """height of the underside, above zero for a bridge or an overhanging part"""
    holes_m: tuple[NDArray[np.float64], ...] = ()
    """inner rings (courtyards), each ``[corner, (x, y)]``"""
    material: str = "concrete"
    """what walls and roof are of, a name of `skygain.propagation.launching.materials`"""

    def covers(self, x_m: float, y_m: float) -> bool:
        """Whether the point lies inside the footprint (even-odd rule over outer and inner
        rings)."""
        inside = False
        for ring in (self.footprint_m, *self.holes_m):
            (x0, y0), (x1, y1) = ring.T, np.roll(ring, -1, axis=0).T
            crosses = (y0 > y_m) != (y1 > y_m)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = x0 + (y_m - y0) * (x1 - x0) / (y1 - y0)
            inside ^= bool(np.count_nonzero(crosses & (x_m < at)) % 2)
        return inside

    def shifted(self, dx_m: float, dy_m: float) -> Building:
        """The same building moved by (dx, dy)."""
        step = np.array([dx_m, dy_m])
        return replace(
            self, footprint_m=self.footprint_m + step, holes_m=tuple(h + step for h in self.holes_m)
        )


@dataclass(frozen=True)
class City:
    """Building heights on a grid, with the polygons behind them when they are known.

    Equality is identity: two cities are compared by what they are made from, not cell by cell.
    """

    grid: Grid
    """where the cells are; `Grid.crs` says whether the city is georeferenced"""
    height_m: NDArray[np.float32]
    """``[row, col]`` height above the street at the cell's centre, 0 on open ground; read-only"""
    buildings: tuple[Building, ...] = ()
    """the footprints, empty when only the raster is known"""
    name: str = "city"
    """for titles and file names"""
    ground_m: NDArray[np.float32] = field(default_factory=lambda: np.zeros((), np.float32))
    """``[row, col]`` height of the ground at the cell's centre, read-only; one number may be given
    where it is level"""
    ground_datum: str | None = None
    """what ``ground_m`` is measured from, for example ``"NAVD88 height"``; ``None`` if unknown"""

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other

    def __post_init__(self) -> None:
        height = np.array(self.height_m, dtype=np.float32)
        if height.shape != self.grid.shape:
            raise ValueError(
                f"height_m has shape {height.shape}, but the grid has {self.grid.shape}; they must "
                "agree"
            )
        if not np.isfinite(height).all():
            raise InputError(
                f"{self.name!r} has {np.count_nonzero(~np.isfinite(height))} heights that are no "
                "finite numbers; give 0 where the ground is open"
            )
        height.flags.writeable = False
        object.__setattr__(self, "height_m", height)
        ground = np.asarray(self.ground_m, dtype=np.float32)
        if ground.ndim == 0 or (ground.size and (ground == ground.flat[0]).all()):
            ground = np.broadcast_to(ground.flat[0], self.grid.shape)  # a level costs nothing
        elif ground.shape != self.grid.shape:
            raise ValueError(
                f"ground_m has shape {ground.shape}, but the grid has {self.grid.shape}; they must "
                "agree"
            )
        else:
            ground = ground.copy()
            ground.flags.writeable = False
        if not np.isfinite(ground).all():
            raise InputError(
                f"the ground of {self.name!r} has heights that are no finite numbers; give one "
                "number where only that is known"
            )
        object.__setattr__(self, "ground_m", ground)

    @cached_property
    def is_level(self) -> bool:
        """Whether the ground has the same height everywhere."""
        return bool((self.ground_m == self.ground_m.flat[0]).all())

    @property
    def surface_m(self) -> NDArray[np.float32]:
        """``[row, col]`` height of the roof or the open ground, from where the ground is measured
        from."""
        return np.asarray(self.ground_m + self.height_m, dtype=np.float32)

    @property
    def crs(self) -> str | None:
        """Coordinate reference system of the grid, or ``None``."""
        return self.grid.crs

    def obstructed(self, altitude_m: float) -> NDArray[np.bool_]:
        """``[row, col]`` cells where a UAV or receiver ``altitude_m`` above the ground would be
        inside a building (height >= altitude)."""
        return self.height_m >= altitude_m

    def roof_m(self, x_m: float, y_m: float) -> float:
        """Height of what is built at a point, 0 on open ground and off the map: from the polygons
        if known, else from its cell."""
        if self.buildings:
            return max((b.height_m for b in self.buildings if b.covers(x_m, y_m)), default=0.0)
        cell = self.grid.cells_at((x_m, y_m))
        return float(self.height_m[tuple(cell)]) if self.grid.contains(cell) else 0.0

    def ground_at(self, x_m: float, y_m: float) -> float:
        """Height of the ground at a point; off the map that of the nearest cell."""
        row, col = self.grid.cells_at((x_m, y_m))
        rows, cols = self.grid.shape
        return float(self.ground_m[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)])

    def levelled(self, datum_m: float) -> City:
        """The same surface over level ground at ``datum_m``: what rises above it, hills too, is an
        obstacle.

        This is how a flight sees the city that keeps one height above sea level: at ``level_m`` it
        flies ``level_m - datum_m`` above the new ground. Buildings lose their polygons.
        """
        above = np.maximum(self.surface_m - np.float32(datum_m), 0.0)
        return replace(self, height_m=above, buildings=(), ground_m=np.array(datum_m, np.float32))

    def __repr__(self) -> str:
        return f"City({self.name!r}, {self.grid}, {len(self.buildings)} buildings)"

    def cropped(self, row: int, col: int, shape: tuple[int, int], *, rebase: bool = False) -> City:
        """The window of ``shape`` cells whose south-west cell is (row, col).

        With ``rebase`` the window starts a local frame of its own: the centre of its cell (0, 0)
        becomes (0, 0) metres and the CRS is dropped, so that nothing in the crop tells where in the
        city it lay. Buildings that do not touch the window go.

        Raises:
            InputError: the window does not fit.
        """
        grid = self.grid.cropped(row, col, shape)
        west, south, east, north = grid.bounds_m
        kept = tuple(
            b
            for b in self.buildings
            if b.footprint_m[:, 0].max() > west
            and b.footprint_m[:, 0].min() < east
            and b.footprint_m[:, 1].max() > south
            and b.footprint_m[:, 1].min() < north
        )
        if rebase:
            dx, dy = -grid.origin_m[0], -grid.origin_m[1]
            kept = tuple(b.shifted(dx, dy) for b in kept)
            grid = replace(grid, origin_m=(0.0, 0.0), crs=None)
        rows, cols = slice(row, row + shape[0]), slice(col, col + shape[1])
        return replace(
            self,
            grid=grid,
            height_m=self.height_m[rows, cols],
            buildings=kept,
            ground_m=self.ground_m[rows, cols],
        )
