"""What stands between two points."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.city import Building
from skygain.propagation.launching.geometry import city_geometry
from skygain.propagation.launching.walking import blocker

from ..conftest import box, city_of

TOWER = box(60, 10, 80, 50, 12.0)


def stopped(buildings: list[Building], a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    g = city_geometry(city_of(buildings), buildings, [0] * len(buildings))
    return bool(blocker(*a, *b, g.walls, g.first, g.listed, g.tallest_m, g.frame, g.ground_m) >= 0)


@pytest.mark.parametrize(
    ("start", "end", "why"),
    [(30.0, 5.0, "enters through the roof"), (15.0, 1.0, "meets the front wall")],
)
def test_a_path_that_comes_down_is_stopped_by_back_walls_too(
    start: float, end: float, why: str
) -> None:
    """Front walls alone let rays through roofs, and their gains are tens of decibels too high."""
    a, b = (0.0, 30.0, start), (100.0, 30.0, end)
    above_front = start + (end - start) * 0.6 > TOWER.height_m
    assert above_front == (why == "enters through the roof")
    assert stopped([TOWER], a, b)
    assert stopped([TOWER], b, a)


def test_a_path_over_the_roof_or_beside_the_building_is_free() -> None:
    assert not stopped([TOWER], (0.0, 30.0, 30.0), (100.0, 30.0, 13.0))
    assert not stopped([TOWER], (0.0, 5.0, 2.0), (110.0, 5.0, 2.0))
    assert stopped([TOWER], (0.0, 30.0, 2.0), (110.0, 30.0, 2.0))


def test_a_path_may_end_on_a_wall() -> None:
    assert not stopped([TOWER], (0.0, 30.0, 2.0), (60.0, 30.0, 2.0))
    assert stopped([TOWER], (0.0, 30.0, 2.0), (80.0, 30.0, 2.0))


def test_beneath_an_overhang_is_free() -> None:
    over = box(60, 10, 80, 50, 12.0, 5.0)
    assert not stopped([over], (0.0, 30.0, 2.0), (110.0, 30.0, 2.0))
    assert stopped([over], (0.0, 30.0, 7.0), (110.0, 30.0, 7.0))


def test_any_building_is_found_whatever_the_direction() -> None:
    """The walk over cells agrees with sampling the line finely."""
    rng = np.random.default_rng(3)
    houses = [box(10, 10, 30, 25, 9.0), box(50, 60, 66, 100, 20.0), box(80, 15, 100, 45, 14.0)]
    for a, b in zip(rng.uniform(0, 120, (300, 3)), rng.uniform(0, 120, (300, 3)), strict=True):
        a[2], b[2] = a[2] / 6, b[2] / 6
        points = a + np.linspace(0, 1, 4001)[:, None] * (b - a)
        inside = np.zeros(len(points), dtype=bool)
        for house in houses:
            (west, south), (east, north) = house.footprint_m[0], house.footprint_m[2]
            x, y, z = points.T
            inside |= (x > west) & (x < east) & (y > south) & (y < north) & (z < house.height_m)
        if inside[0] or inside[-1] or 0 < inside.sum() < 3:
            continue
        assert stopped(houses, tuple(a), tuple(b)) == bool(inside.any())
