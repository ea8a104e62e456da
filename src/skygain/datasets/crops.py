"""Crops, turns and mirror images of a link.

A predictor that is trained and tested on crops must not learn where in the city a crop lay, so a
crop starts a frame of its own: the centre of its south-west cell is (0, 0) metres. Turning and
mirroring move the transmitter and the buildings with the maps, so that every gain keeps its
distance from the transmitter.
"""

from __future__ import annotations

__all__ = ["cropped_link", "random_crop", "turned_link"]

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.datasets.link import Link
from skygain.grid import random_corner, turned, turned_cells

_SYMMETRY = ((0, 2), (5, 4), (3, 1), (6, 7))
"""``[quarters][mirror]``: quarter turns counter-clockwise, then east and west exchanged"""


def cropped_link(link: Link, row: int, col: int, shape: tuple[int, int] = (96, 96)) -> Link:
    """The window of ``shape`` cells whose south-west cell is (row, col), in a frame of its own.

    The transmitter moves along and may lie outside the window.

    Raises:
        InputError: the window does not fit.
    """
    city = link.city.cropped(row, col, shape, rebase=True)
    dx, dy = link.city.grid.xy_m((row, col))
    x, y, z = link.transmitter_m
    window = (slice(row, row + shape[0]), slice(col, col + shape[1]))
    return replace(
        link,
        city=city,
        transmitter_m=(float(x - dx), float(y - dy), z),
        truth_db=link.truth_db[window],
        ray_traced=link.ray_traced[window],
    )


def turned_link(link: Link, symmetry: int) -> Link:
    """The link under one of the `skygain.grid.SYMMETRIES`; the south-west cell's centre stays where
    it was."""
    grid = link.city.grid
    corner = np.array(grid.origin_m[::-1])  # (y, x)
    last = grid.xy_m(np.array(grid.shape) - 1)[::-1] - corner
    # a mirror image turns rings around; they stay counter-clockwise
    order = slice(None, None, -1 if symmetry.bit_count() % 2 else 1)

    def moved(xy: ArrayLike) -> NDArray[np.float64]:
        at = turned_cells(np.asarray(xy, dtype=float)[..., ::-1] - corner, last, symmetry)
        return (at + corner)[..., ::-1]

    city = link.city
    height = turned(city.height_m, symmetry)
    buildings = tuple(
        replace(
            b,
            footprint_m=moved(b.footprint_m)[order],
            holes_m=tuple(moved(hole)[order] for hole in b.holes_m),
        )
        for b in city.buildings
    )
    x, y = moved(link.transmitter_m[:2]).tolist()
    return replace(
        link,
        city=City(replace(grid, shape=height.shape, crs=None), height, buildings, city.name),
        transmitter_m=(x, y, link.transmitter_m[2]),
        truth_db=turned(link.truth_db, symmetry),
        ray_traced=turned(link.ray_traced, symmetry),
    )


def random_crop(
    link: Link,
    rng: np.random.Generator,
    shape: tuple[int, int] = (96, 96),
    *,
    augment: bool = False,
) -> Link:
    """A crop of ``shape`` at a random place; with ``augment`` also turned by random quarters and
    mirrored with probability 1/2.

    Raises:
        InputError: the map is smaller than ``shape``.
    """
    quarters, mirror = (int(rng.integers(4)), int(rng.integers(2))) if augment else (0, 0)
    cut = shape[::-1] if quarters % 2 else shape  # lying down before an odd number of quarter turns
    crop = cropped_link(link, *random_corner(link.city.grid.shape, cut, rng), cut)
    return turned_link(crop, _SYMMETRY[quarters][mirror])
