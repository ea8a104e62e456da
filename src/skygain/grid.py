"""The map's raster: which cell is where.

Everything in Skygain lives on one regular grid. Arrays are ``[..., row, col]``, cells are integer
``(row, col)``, and metres are ``(x, y)`` with x to the east and y to the north. Row 0 is the
southernmost row, so y grows with the row and pictures are drawn with ``origin="lower"``. A grid
with a CRS also knows latitude and longitude.
"""

from __future__ import annotations

__all__ = ["SYMMETRIES", "Grid", "random_corner", "turned", "turned_cells"]

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError, require

SYMMETRIES = 8
"""of a square map, counted as sets of bits: 1 mirrors the rows, 2 mirrors the columns, 4 swaps rows
and columns afterwards"""


@dataclass(frozen=True)
class Grid:
    """A regular raster of square cells.

    >>> grid = Grid(shape=(3, 4), spacing_m=4.0, origin_m=(2.0, 2.0))
    >>> grid.xy_m([2, 1])
    array([ 6., 10.])
    >>> grid.cells_at([6.0, 10.0])
    array([2, 1])
    """

    shape: tuple[int, int]
    """number of rows and columns"""
    spacing_m: float
    """side of a cell in metres"""
    origin_m: tuple[float, float] = (0.0, 0.0)
    """(x, y) of the centre of cell (0, 0), the south-west cell"""
    crs: str | None = None
    """projected coordinate reference system of x and y, for example ``"EPSG:32617"``; ``None`` for
    a local frame"""

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) edges of the outermost cells."""
        half = self.spacing_m / 2
        west, south = self.origin_m[0] - half, self.origin_m[1] - half
        return (
            west,
            south,
            west + self.shape[1] * self.spacing_m,
            south + self.shape[0] * self.spacing_m,
        )

    @cached_property
    def x_m(self) -> NDArray[np.float64]:
        """x of each column, ``[col]``."""
        return self.origin_m[0] + self.spacing_m * np.arange(self.shape[1], dtype=np.float64)

    @cached_property
    def y_m(self) -> NDArray[np.float64]:
        """y of each row, ``[row]``."""
        return self.origin_m[1] + self.spacing_m * np.arange(self.shape[0], dtype=np.float64)

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """Every cell, ``[row * cols + col, (row, col)]``: the order of a raveled map."""
        return np.argwhere(np.ones(self.shape, dtype=bool))

    def xy_m(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Centres of ``cells[..., (row, col)]`` as ``[..., (x, y)]`` in metres."""
        cells = np.asarray(cells)
        return np.asarray(self.origin_m) + self.spacing_m * cells[..., ::-1]

    def cells_at(self, xy_m: ArrayLike) -> NDArray[np.int64]:
        """Cells that contain the points ``xy_m[..., (x, y)]``; a point off the map gives a cell off
        the map (see `contains`)."""
        offset = (np.asarray(xy_m, dtype=float) - np.asarray(self.origin_m)) / self.spacing_m
        return np.floor(offset + 0.5).astype(np.int64)[..., ::-1]

    def contains(self, cells: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of ``cells[..., (row, col)]`` lies on the map."""
        cells = np.asarray(cells)
        return np.all((cells >= 0) & (cells < np.asarray(self.shape)), axis=-1)

    def flat(self, cells: ArrayLike) -> NDArray[np.int64]:
        """Index of ``cells[..., (row, col)]`` in a raveled map."""
        cells = np.asarray(cells, dtype=np.int64)
        return cells[..., 0] * self.shape[1] + cells[..., 1]

    def cropped(self, row: int, col: int, shape: tuple[int, int]) -> Grid:
        """The window of ``shape`` whose south-west cell is (row, col); coordinates stay those of
        this grid.

        Raises:
            InputError: the window does not fit.
        """
        if (
            row < 0
            or col < 0
            or min(shape) < 1
            or row + shape[0] > self.shape[0]
            or col + shape[1] > self.shape[1]
        ):
            raise InputError(
                f"a crop of {shape} cells at row {row}, col {col} leaves the map of {self.shape} "
                "cells; choose a smaller crop"
            )
        x, y = self.xy_m((row, col))
        return replace(self, shape=(int(shape[0]), int(shape[1])), origin_m=(float(x), float(y)))

    def latlon(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Centres of ``cells`` as ``[..., (latitude, longitude)]`` in degrees (WGS 84); fractional
        cells are allowed.

        Raises:
            InputError: the grid has no CRS.
        """
        xy = self.xy_m(np.asarray(cells, dtype=float))
        lon, lat = self._transformer().transform(xy[..., 0], xy[..., 1], direction="INVERSE")
        return np.stack([lat, lon], axis=-1)

    def cells_at_latlon(self, latlon: ArrayLike) -> NDArray[np.int64]:
        """Cells that contain ``latlon[..., (latitude, longitude)]`` in degrees.

        Raises:
            InputError: the grid has no CRS.
        """
        return self.cells_at(self.xy_m_at_latlon(latlon))

    def xy_m_at_latlon(self, latlon: ArrayLike) -> NDArray[np.float64]:
        """Metres ``[..., (x, y)]`` of ``latlon[..., (latitude, longitude)]`` in degrees.

        Raises:
            InputError: the grid has no CRS.
        """
        latlon = np.asarray(latlon, dtype=float)
        x, y = self._transformer().transform(latlon[..., 1], latlon[..., 0])
        return np.stack([x, y], axis=-1)

    def _transformer(self):  # type: ignore[no-untyped-def]
        if self.crs is None:
            raise InputError(
                "this map has no coordinate reference system, so it has no latitudes; load a "
                "georeferenced city"
            )
        pyproj = require("pyproj", "geo")
        return pyproj.Transformer.from_crs("EPSG:4326", self.crs, always_xy=True)


def random_corner(
    shape: tuple[int, int], window: tuple[int, int], rng: np.random.Generator
) -> tuple[int, int]:
    """First cell (row, col) of a window of ``window`` cells anywhere in maps of ``shape``, every
    place as likely.

    Raises:
        InputError: the window does not fit.
    """
    if not (1 <= window[0] <= shape[0] and 1 <= window[1] <= shape[1]):
        raise InputError(
            f"a crop of {tuple(window)} cells does not fit into maps of {tuple(shape)} cells; "
            "choose a smaller crop"
        )
    row, col = (
        int(rng.integers(have - want + 1)) for have, want in zip(shape, window, strict=True)
    )
    return row, col


def turned(maps: NDArray, symmetry: int) -> NDArray:
    """``maps[..., row, col]`` under one of the `SYMMETRIES`, as a view."""
    maps = maps[..., :: -1 if symmetry & 1 else 1, :: -1 if symmetry & 2 else 1]
    return maps.swapaxes(-1, -2) if symmetry & 4 else maps


def turned_cells(cells: ArrayLike, last: tuple[float, float], symmetry: int) -> NDArray:
    """Where ``cells[..., (row, col)]`` are in `turned` maps whose last cell was ``last``; fractions
    of cells, or metres (y, x), are turned alike."""
    out = np.array(cells)
    for axis in range(2):
        if symmetry & (1 << axis):
            out[..., axis] = last[axis] - out[..., axis]
    return out[..., ::-1] if symmetry & 4 else out
