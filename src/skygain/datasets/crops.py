"""Crops, turns and mirror images of a link.

A predictor that is trained and tested on crops must not learn where in the city a crop lay, so a
crop starts a frame of its own: the centre of its south-west cell is (0, 0) metres. Turning and
mirroring move the transmitter and the buildings with the maps, so that every gain keeps its
distance from the transmitter.
"""

from __future__ import annotations

__all__ = ["cropped_link", "mirrored_link", "random_crop", "turned_link"]

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.datasets.link import Link
from skygain.ground.errors import InputError


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


def turned_link(link: Link, quarters: int = 1) -> Link:
    """The link turned counter-clockwise by ``quarters`` quarter turns; the south-west cell's centre
    stays where it was."""
    for _ in range(quarters % 4):
        link = _quarter_turned(link)
    return link


def mirrored_link(link: Link) -> Link:
    """The link with east and west exchanged; the south-west cell's centre stays where it was."""
    grid = link.city.grid
    ends = 2 * grid.origin_m[0] + grid.spacing_m * (grid.shape[1] - 1)
    return _moved(
        link,
        lambda xy: np.stack([ends - xy[..., 0], xy[..., 1]], axis=-1),
        lambda image: np.flip(image, axis=1),
        reverse=True,
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
    quarters, mirror = (int(rng.integers(4)), bool(rng.integers(2))) if augment else (0, False)
    cut = shape[::-1] if quarters % 2 else shape  # lying down before an odd number of quarter turns
    rows, cols = link.city.grid.shape
    if cut[0] > rows or cut[1] > cols:
        raise InputError(
            f"a crop of {cut} cells does not fit into the map of {(rows, cols)} cells; choose a "
            "smaller crop"
        )
    row, col = int(rng.integers(rows - cut[0] + 1)), int(rng.integers(cols - cut[1] + 1))
    crop = turned_link(cropped_link(link, row, col, cut), quarters)
    return mirrored_link(crop) if mirror else crop


def _quarter_turned(link: Link) -> Link:
    grid = link.city.grid
    x0, y0 = grid.origin_m
    # a quarter turn takes (x, y) to (-y, x); the shift brings the turned map back to the old
    # south-west cell
    shift = grid.spacing_m * (grid.shape[0] - 1) + x0 + y0
    return _moved(
        link,
        lambda xy: np.stack([shift - xy[..., 1], xy[..., 0] - x0 + y0], axis=-1),
        lambda image: np.rot90(
            image, -1
        ),  # rows grow to the north, so NumPy's clockwise is our counter-clockwise
        reverse=False,
    )


def _moved(
    link: Link,
    point: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    image: Callable[[NDArray], NDArray],
    *,
    reverse: bool,
) -> Link:
    """The link with every ``[..., (x, y)]`` sent through ``point`` and every ``[row, col]`` through
    ``image``.

    ``reverse`` turns the rings around, which a mirror image needs to stay counter-clockwise.
    """
    order = slice(None, None, -1 if reverse else 1)
    city = link.city
    buildings = tuple(
        replace(
            b,
            footprint_m=point(b.footprint_m)[order],
            holes_m=tuple(point(h)[order] for h in b.holes_m),
        )
        for b in city.buildings
    )
    height = image(city.height_m)
    x, y = point(np.array(link.transmitter_m[:2])).tolist()
    return replace(
        link,
        city=City(
            grid=replace(city.grid, shape=height.shape, crs=None),
            height_m=height,
            buildings=buildings,
            name=city.name,
        ),
        transmitter_m=(x, y, link.transmitter_m[2]),
        truth_db=image(link.truth_db),
        ray_traced=image(link.ray_traced),
    )
