"""Random cities with the street patterns of European towns: cities beyond Manhattan to train on.

The square is split again and again by streets of different widths into blocks of different sizes.
What stands in a block depends on the kind of town: closed perimeters of terraced houses around a
courtyard (``centre``), parallel slabs (``estate``), or detached houses (``suburb``). Walls run
along the axes, so that such a city can be stored like a Manhattan one.
"""

from __future__ import annotations

__all__ = ["KINDS", "EuropeanConfig", "european_city"]

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skygain.cities.manhattan import city_of_rectangles, snapped
from skygain.city import City
from skygain.ground.errors import InputError

_STREAM = 1492
"""sets the stream of city seed 7 apart from that of any other thing seeded with 7"""

_Rectangle = tuple[float, float, float, float]
"""west, south, east, north"""


@dataclass(frozen=True)
class EuropeanConfig:
    """How a town is drawn; `KINDS` has three to choose from.

    Raises:
        InputError: a value is outside its range.
    """

    pattern: str = "perimeter"
    """what stands in a block: ``"perimeter"``, ``"slabs"`` or ``"detached"``"""
    extent_m: float = 486.0
    """side of the square"""
    spacing_m: float = 4.0
    """side of a cell"""
    block_m: tuple[float, float] = (45.0, 110.0)
    """a block wider than the second is split; no part is narrower than the first"""
    street_m: tuple[float, float] = (9.0, 20.0)
    """clear widths of streets, uniform"""
    depth_m: tuple[float, float] = (9.0, 14.0)
    """depth of houses, uniform"""
    frontage_m: tuple[float, float] = (10.0, 24.0)
    """frontage of houses, uniform"""
    height_m: tuple[float, float] = (11.0, 22.0)
    """heights around a block's own level, which is uniform between these two"""
    height_spread_m: float = 2.5
    """standard deviation of the heights within a block"""
    open_share: float = 0.08
    """probability that a block is a square or a park"""
    gap_share: float = 0.06
    """probability that the place of a house stays empty"""

    def __post_init__(self) -> None:
        ranges = (self.block_m, self.street_m, self.depth_m, self.frontage_m, self.height_m)
        demands = {
            "pattern must be 'perimeter', 'slabs' or 'detached'": self.pattern in _PATTERNS,
            "ranges must be two positive numbers in order": all(
                0 < a <= b < 1e4 for a, b in ranges
            ),
            "spacing_m must be positive and at most extent_m": 0
            < self.spacing_m
            <= self.extent_m
            < 1e5,
            "block_m must have room for two houses": self.block_m[0] > 2 * self.depth_m[1] + 4,
            "shares must lie in [0, 1]": 0 <= self.open_share <= 1 and 0 <= self.gap_share <= 1,
            "height_spread_m must not be negative": self.height_spread_m >= 0,
        }
        for demand, met in demands.items():
            if not met:
                raise InputError(f"{demand}; got {self}")


def european_city(seed: int, config: EuropeanConfig | None = None) -> City:
    """Draw a town.

    Args:
        seed: a non-negative integer, which with the configuration alone decides the city (named
            ``"european-<seed>"``).
        config: how to draw; a centre when left out.

    Raises:
        InputError: the seed is negative.

    >>> city = european_city(7)
    >>> city.name, city.grid.shape
    ('european-7', (121, 121))
    """
    config = config or EuropeanConfig()
    if seed < 0:
        raise InputError(f"a city seed is an integer of 0 or more, got {seed}")
    rng = np.random.default_rng([_STREAM, int(seed)])
    half = config.street_m[0] / 2
    square = (half, half, config.extent_m - half, config.extent_m - half)
    found = []
    for block in _blocks(rng, square, config):
        if rng.random() < config.open_share:
            continue
        level = rng.uniform(*config.height_m)
        for place in _PATTERNS[config.pattern](rng, block, config):
            if rng.random() < config.gap_share:
                continue
            height = max(level + config.height_spread_m * rng.standard_normal(), 3.0)
            west, south, east, north, roof = snapped([*place, height]).tolist()
            if east - west >= 2 and north - south >= 2:
                found.append((west, south, east, north, roof))
    return city_of_rectangles(found, config.extent_m, config.spacing_m, f"european-{seed}")


def _blocks(
    rng: np.random.Generator, area: _Rectangle, config: EuropeanConfig
) -> Iterator[_Rectangle]:
    """The blocks that streets split an area into."""
    west, south, east, north = area
    wide, deep = east - west, north - south
    least, most = config.block_m
    street = rng.uniform(*config.street_m)
    longer = max(wide, deep)
    if longer <= most or longer < 2 * least + street:
        yield area
        return
    cut = rng.uniform(least, longer - street - least)
    if wide >= deep:
        parts = (west, south, west + cut, north), (west + cut + street, south, east, north)
    else:
        parts = (west, south, east, south + cut), (west, south + cut + street, east, north)
    for part in parts:
        yield from _blocks(rng, part, config)


def _spans(
    rng: np.random.Generator, low: float, high: float, size: tuple[float, float]
) -> list[tuple[float, float]]:
    """A stretch divided into parts of about uniform sizes."""
    count = max(1, round((high - low) / rng.uniform(*size)))
    weights = rng.uniform(0.7, 1.3, count)
    ends = low + np.concatenate([[0.0], np.cumsum(weights / weights.sum())]) * (high - low)
    return [(float(a), float(b)) for a, b in pairwise(ends)]


def _perimeter(
    rng: np.random.Generator, block: _Rectangle, config: EuropeanConfig
) -> Iterator[_Rectangle]:
    """Terraced houses along the four sides, a courtyard within."""
    west, south, east, north = block
    depth = min(rng.uniform(*config.depth_m), (east - west) / 3, (north - south) / 3)
    for a, b in _spans(rng, west, east, config.frontage_m):
        yield a, south, b, south + depth
        yield a, north - depth, b, north
    for a, b in _spans(rng, south + depth, north - depth, config.frontage_m):
        yield west, a, west + depth, b
        yield east - depth, a, east, b


def _slabs(
    rng: np.random.Generator, block: _Rectangle, config: EuropeanConfig
) -> Iterator[_Rectangle]:
    """Parallel slabs with lawns between."""
    west, south, east, north = block
    pitch = (config.depth_m[1] * 2.2, config.depth_m[1] * 3.5)
    along_x = bool(rng.random() < 0.5)
    low, high = (south, north) if along_x else (west, east)
    for a, b in _spans(rng, low, high, pitch):
        depth = min(rng.uniform(*config.depth_m), b - a)
        inset = rng.uniform(1.0, 8.0)
        if along_x:
            yield west + inset, a, east - inset, a + depth
        else:
            yield a, south + inset, a + depth, north - inset


def _detached(
    rng: np.random.Generator, block: _Rectangle, config: EuropeanConfig
) -> Iterator[_Rectangle]:
    """Houses in gardens, on lots of about their frontage and half as much again."""
    west, south, east, north = block
    lot = (config.frontage_m[0] * 1.5, config.frontage_m[1] * 1.5)
    for x0, x1 in _spans(rng, west, east, lot):
        for y0, y1 in _spans(rng, south, north, lot):
            wide = min(rng.uniform(*config.depth_m), x1 - x0 - 2)
            deep = min(rng.uniform(*config.depth_m), y1 - y0 - 2)
            x = x0 + rng.random() * (x1 - x0 - wide)
            y = y0 + rng.random() * (y1 - y0 - deep)
            yield x, y, x + wide, y + deep


_PATTERNS = {"perimeter": _perimeter, "slabs": _slabs, "detached": _detached}

KINDS = {
    "centre": EuropeanConfig(),
    "estate": EuropeanConfig(
        pattern="slabs",
        block_m=(70.0, 170.0),
        street_m=(12.0, 30.0),
        height_m=(12.0, 40.0),
        height_spread_m=5.0,
    ),
    "suburb": EuropeanConfig(
        pattern="detached",
        block_m=(50.0, 120.0),
        street_m=(8.0, 14.0),
        height_m=(5.0, 10.0),
        height_spread_m=1.5,
        gap_share=0.12,
    ),
}
"""closed blocks around courtyards, slabs of a housing estate, detached houses"""
