"""Small cities, and the condition under which rays can be traced."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from skygain.city import Building, City
from skygain.grid import Grid
from skygain.ground.llvm import find_llvm

RAYS = (
    importlib.util.find_spec("sionna") is not None
    and importlib.util.find_spec("shapely") is not None
    and find_llvm() is not None
)

needs_rays = pytest.mark.skipif(
    not RAYS, reason="Sionna RT, shapely or LLVM is missing: pip install 'skygain[raytrace]'"
)


def box(
    west: float, south: float, east: float, north: float, height_m: float, base_m: float = 0.0
) -> Building:
    return Building(
        np.array([[west, south], [east, south], [east, north], [west, north]], dtype=float),
        height_m,
        base_m,
    )


def city_of(
    boxes: list[Building],
    shape: tuple[int, int] = (30, 30),
    origin_m: tuple[float, float] = (2.0, 2.0),
) -> City:
    """A city with the raster that its boxes make."""
    grid = Grid(shape=shape, spacing_m=4.0, origin_m=origin_m)
    y, x = np.meshgrid(grid.y_m, grid.x_m, indexing="ij")
    height = np.zeros(shape, dtype=np.float32)
    for b in boxes:
        (west, south), (east, north) = b.footprint_m.min(axis=0), b.footprint_m.max(axis=0)
        height = np.where(
            (x > west) & (x < east) & (y > south) & (y < north), np.float32(b.height_m), height
        )
    return City(grid=grid, height_m=height, buildings=tuple(boxes), name="boxes")
