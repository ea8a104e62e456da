"""Random Manhattan-like cities: the training and test world of the evaluation protocol.

A square is divided into 5 x 5 blocks of random widths and lengths with streets between them. A
block is either an open square or is divided into equal lots; a lot is either open or carries one
rectangular building of random size, position and height. Everything follows from one seed, so a
city never has to be stored to be used again.

All corners and heights are odd multiples of 1/8 m. They are therefore exact in single precision
(heights in half precision too), so a stored city is the generated one bit by bit, and no wall runs
through a cell centre and no roof lies at a flight altitude of whole metres, where "inside" would be
a matter of rounding.
"""

from __future__ import annotations

__all__ = [
    "ManhattanConfig",
    "city_of_rectangles",
    "manhattan_city",
    "snapped",
    "transmitter_sites",
]

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import Building, City
from skygain.frames import MAX_CELLS
from skygain.grid import Grid
from skygain.ground.errors import InputError

_STREAM = 486
"""sets the stream of city seed 7 apart from that of any other thing seeded with 7"""


@dataclass(frozen=True)
class ManhattanConfig:
    """How a Manhattan city is drawn; the defaults are the evaluation protocol's.

    Raises:
        InputError: a value is outside its range, or the streets leave no room for blocks.
    """

    extent_m: float = 486.0
    """side of the square"""
    spacing_m: float = 4.0
    """side of a cell; as many whole cells as fit are centred in the square (121 x 121, the first
    centre at 3 m)"""
    blocks: int = 5
    """blocks per side"""
    block_variation: float = 0.3
    """the widths of a row of blocks, each with half a street on either side, are in proportion to
    numbers drawn uniformly from 1 - variation to 1 + variation; lengths likewise"""
    street_width_m: float = 12.0
    """clear width between two blocks; half of it also runs around the square"""
    max_lots: int = 3
    """a block has 1 to ``max_lots`` lots in each direction, drawn uniformly"""
    open_block_share: float = 0.1
    """probability that a block stays open"""
    open_lot_share: float = 0.1
    """probability that a lot of a built block stays open"""
    building_share: tuple[float, float] = (0.58, 0.95)
    """a building's width is a uniform share of its lot's width, between these two; its length
    likewise, independently"""
    height_range_m: tuple[float, float] = (8.0, 48.0)
    """heights are uniform between these two"""

    def __post_init__(self) -> None:
        low, high = self.building_share
        floor, roof = self.height_range_m
        lot = (
            self.extent_m / self.blocks * (1 - self.block_variation) / (1 + self.block_variation)
            if self.blocks >= 1
            else 0.0
        )
        lot = (lot - self.street_width_m) / max(self.max_lots, 1)
        demands = {
            "spacing_m must be positive and at most extent_m": 0
            < self.spacing_m
            <= self.extent_m
            < np.inf,
            f"the square must have at most {MAX_CELLS:,} cells": self.extent_m**2
            <= MAX_CELLS * self.spacing_m**2,
            "blocks and max_lots must be at least 1": self.blocks >= 1 and self.max_lots >= 1,
            "block_variation must be at least 0 and below 1": 0 <= self.block_variation < 1,
            "street_width_m must not be negative": self.street_width_m >= 0,
            "open_block_share and open_lot_share must lie in [0, 1]": 0
            <= self.open_block_share
            <= 1
            and 0 <= self.open_lot_share <= 1,
            "building_share must be two numbers 0 < low <= high <= 1": 0 < low <= high <= 1,
            "height_range_m must be two numbers 0 < low <= high": 0 < floor <= roof < np.inf,
            "buildings must be 1 m wide or more; take fewer blocks or lots, narrower streets": lot
            * low
            >= 1.0,
        }
        for demand, met in demands.items():
            if not met:
                raise InputError(f"{demand}; got {self}")


def manhattan_city(seed: int | np.random.Generator, config: ManhattanConfig | None = None) -> City:
    """Draw a city.

    Args:
        seed: a non-negative integer, which alone decides the city (named ``"manhattan-<seed>"``),
            or a generator to draw from.
        config: how to draw; the protocol's cities when left out.

    Returns:
        A city in a local frame whose south-west corner is (0, 0) metres, with its buildings as
        rectangles ordered by block and lot. A cell has the height of the building its centre lies
        in.

    Raises:
        InputError: the seed is negative.

    >>> city = manhattan_city(7)
    >>> city.name, city.grid.shape, city.grid.origin_m
    ('manhattan-7', (121, 121), (3.0, 3.0))
    """
    config = config or ManhattanConfig()
    if isinstance(seed, np.random.Generator):
        rng, name = seed, "manhattan"
    else:
        if seed < 0:
            raise InputError(f"a city seed is an integer of 0 or more, got {seed}")
        rng, name = np.random.default_rng([_STREAM, int(seed)]), f"manhattan-{int(seed)}"
    rectangles = _rectangles(rng, config)
    return city_of_rectangles(rectangles, config.extent_m, config.spacing_m, name)


def city_of_rectangles(
    rectangles: Sequence[tuple[float, float, float, float, float]],
    extent_m: float,
    spacing_m: float,
    name: str,
) -> City:
    """A city of (west, south, east, north, height), with as many cells as fit its square.

    A cell has the height of the building its centre lies in.
    """
    count = int(extent_m // spacing_m)
    first = (extent_m - (count - 1) * spacing_m) / 2
    grid = Grid(shape=(count, count), spacing_m=spacing_m, origin_m=(first, first))
    height = np.zeros(grid.shape, dtype=np.float32)
    for west, south, east, north, roof in rectangles:
        rows = slice(*np.searchsorted(grid.y_m, [south, north]))
        cols = slice(*np.searchsorted(grid.x_m, [west, east]))
        height[rows, cols] = roof
    buildings = tuple(
        Building(
            footprint_m=np.array([[west, south], [east, south], [east, north], [west, north]]),
            height_m=roof,
        )
        for west, south, east, north, roof in rectangles
    )
    return City(grid=grid, height_m=height, buildings=buildings, name=name)


def transmitter_sites(
    city: City, *, pitch_m: float = 97.2, height_m: float = 1.5, clearance_m: float = 0.5
) -> NDArray[np.float64]:
    """Transmitter positions on a square lattice in the middle of the map, without those indoors.

    A position is dropped if it lies in a building or closer than ``clearance_m`` to its wall, or in
    a cell whose centre is built up. On a protocol city the lattice has 25 positions at 48.6, 145.8,
    243, 340.2 and 437.4 m in x and in y.

    Returns:
        ``[site, (x, y, z)]`` in metres, ordered by y and then by x.
    """
    west, south, east, north = city.grid.bounds_m
    x, y = (_lattice(*ends, pitch_m) for ends in ((west, east), (south, north)))
    sites = np.array([(x0, y0, height_m) for y0, x0 in product(y, x)])
    cells = city.grid.cells_at(sites[:, :2])
    indoors = city.height_m[cells[:, 0], cells[:, 1]] >= height_m
    for building in city.buildings:
        if building.base_m <= height_m <= building.height_m:
            rings = (building.footprint_m, *building.holes_m)
            inside = sum(_crossings(sites[:, :2], ring) for ring in rings) % 2 == 1
            near = np.min([_distance_m(sites[:, :2], ring) for ring in rings], axis=0) < clearance_m
            indoors |= inside | near
    return sites[~indoors]


def _rectangles(
    rng: np.random.Generator, config: ManhattanConfig
) -> list[tuple[float, float, float, float, float]]:
    """(west, south, east, north, height) of every building."""
    columns, rows = _block_spans(rng, config), _block_spans(rng, config)
    found = []
    for (west, east), (south, north) in product(columns, rows):
        if rng.random() < config.open_block_share:
            continue
        nx, ny = rng.integers(1, config.max_lots, size=2, endpoint=True)
        xs, ys = np.linspace(west, east, nx + 1), np.linspace(south, north, ny + 1)
        for i, j in product(range(nx), range(ny)):
            if rng.random() < config.open_lot_share:
                continue
            x0, x1 = _building_span(rng, xs[i], xs[i + 1], config)
            y0, y1 = _building_span(rng, ys[j], ys[j + 1], config)
            found.append((x0, y0, x1, y1, float(snapped(rng.uniform(*config.height_range_m)))))
    return found


def _block_spans(rng: np.random.Generator, config: ManhattanConfig) -> list[tuple[float, float]]:
    """Both ends of each block along one direction."""
    weights = rng.uniform(1 - config.block_variation, 1 + config.block_variation, config.blocks)
    edges = np.concatenate([[0.0], np.cumsum(weights / weights.sum()) * config.extent_m])
    half = config.street_width_m / 2
    return [
        (float(snapped(low + half)), float(snapped(high - half))) for low, high in pairwise(edges)
    ]


def _building_span(
    rng: np.random.Generator, low: float, high: float, config: ManhattanConfig
) -> tuple[float, float]:
    """Both ends of a building along one direction of the lot from ``low`` to ``high``."""
    width = (high - low) * rng.uniform(*config.building_share)
    start = low + (high - low - width) * rng.random()
    return float(snapped(start)), float(snapped(start + width))


def snapped(value: ArrayLike) -> NDArray[np.float64]:
    """The nearest odd multiples of 1/8 m. It keeps order, so that what is disjoint stays
    disjoint."""
    return (np.floor(np.asarray(value) * 4) + 0.5) / 4


def _lattice(low: float, high: float, pitch_m: float) -> NDArray[np.float64]:
    """As many points ``pitch_m`` apart as best fill the span, in its middle."""
    count = max(1, round((high - low) / pitch_m))
    return (low + high) / 2 + pitch_m * (np.arange(count, dtype=np.float64) - (count - 1) / 2)


def _crossings(points: NDArray[np.float64], ring: NDArray[np.float64]) -> NDArray[np.int64]:
    """How many edges of the closed ``ring[corner, (x, y)]`` a ray from each of ``points[point, (x,
    y)]`` to the east crosses."""
    x, y = points[:, :1], points[:, 1:]
    (x0, y0), (x1, y1) = ring.T, np.roll(ring, -1, axis=0).T
    straddles = (y0 <= y) != (y1 <= y)  # [point, edge]
    rise = np.where(y1 == y0, 1.0, y1 - y0)
    return np.sum(straddles & (x < x0 + (y - y0) * (x1 - x0) / rise), axis=1)


def _distance_m(points: NDArray[np.float64], ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each of ``points[point, (x, y)]`` from the nearest edge of the closed
    ``ring[corner, (x, y)]``."""
    edge = np.roll(ring, -1, axis=0) - ring
    offset = points[:, None] - ring  # [point, edge, x/y]
    along = np.clip(
        np.sum(offset * edge, axis=-1) / np.maximum(np.sum(edge**2, axis=-1), 1e-12), 0.0, 1.0
    )
    return np.linalg.norm(offset - along[..., None] * edge, axis=-1).min(axis=1)
