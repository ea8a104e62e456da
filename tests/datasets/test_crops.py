"""Crops, turns and mirror images of a link."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygain.city import Building, City
from skygain.datasets.crops import cropped_link, random_crop, turned_link
from skygain.datasets.link import Link
from skygain.grid import SYMMETRIES, Grid
from skygain.ground.errors import InputError


def numbered_link(rows: int = 9, cols: int = 12, seed: int = 0) -> Link:
    """A link whose every truth value occurs once, with one building over known cells."""
    rng = np.random.default_rng(seed)
    grid = Grid((rows, cols), 4.0, (3.0, -5.0))
    height = np.zeros(grid.shape)
    height[1:3, 2:6] = 20.0
    west, south = grid.xy_m((1, 2)) - 2
    east, north = grid.xy_m((2, 5)) + 2
    ring = np.array([[west, south], [east, south], [east, north], [west, north]])
    truth = rng.permutation(grid.size).reshape(grid.shape).astype(np.float32)
    return Link(
        city=City(grid, height, (Building(ring, 20.0),)),
        transmitter_m=(float(rng.uniform(-40, 80)), float(rng.uniform(-40, 80)), 1.5),
        altitude_m=10.0,
        truth_db=truth,
        ray_traced=truth % 2 == 0,
        split="T1",
        city_index=0,
        index=0,
    )


def distances_by_truth(link: Link) -> dict[float, float]:
    """Distance from the transmitter to the cell that carries each truth value."""
    offset = link.city.grid.xy_m(link.city.grid.cells) - link.transmitter_m[:2]
    return dict(zip(link.truth_db.ravel().tolist(), np.hypot(*offset.T).tolist(), strict=True))


def rasterised(city: City) -> np.ndarray:
    """Heights from the (axis-parallel) polygons."""
    height = np.zeros(city.grid.shape)
    xy = city.grid.xy_m(city.grid.cells).reshape(*city.grid.shape, 2)
    for b in city.buildings:
        low, high = b.footprint_m.min(axis=0), b.footprint_m.max(axis=0)
        height[((xy > low) & (xy < high)).all(axis=-1)] = b.height_m
    return height


def is_counter_clockwise(ring: np.ndarray) -> bool:
    x, y = ring.T
    return bool(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0)


@given(seed=st.integers(0, 10_000), augment=st.booleans())
def test_a_crop_keeps_every_distance_from_the_transmitter(seed: int, augment: bool) -> None:
    link = numbered_link(seed=seed)
    crop = random_crop(link, np.random.default_rng(seed), (5, 7), augment=augment)
    whole = distances_by_truth(link)
    assert crop.truth_db.shape == (5, 7)
    for value, distance in distances_by_truth(crop).items():
        assert distance == pytest.approx(whole[value], abs=1e-9)


@given(seed=st.integers(0, 10_000))
def test_maps_polygons_and_rays_move_together(seed: int) -> None:
    crop = random_crop(numbered_link(seed=seed), np.random.default_rng(seed), (8, 8), augment=True)
    np.testing.assert_array_equal(rasterised(crop.city), crop.city.height_m)
    np.testing.assert_array_equal(crop.ray_traced, crop.truth_db % 2 == 0)
    assert all(is_counter_clockwise(b.footprint_m) for b in crop.city.buildings)


def test_the_crop_starts_its_own_frame() -> None:
    crop = cropped_link(numbered_link(), 2, 3, (4, 4))
    assert crop.city.grid.origin_m == (0.0, 0.0)
    assert crop.truth_db[0, 0] == numbered_link().truth_db[2, 3]


def test_a_quarter_turn_takes_east_to_north() -> None:
    link = numbered_link()
    turned = turned_link(link, 5)
    assert turned.city.grid.shape == link.city.grid.shape[::-1]
    np.testing.assert_array_equal(
        turned.truth_db[:, -1], link.truth_db[0]
    )  # the southern edge becomes the eastern one


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_every_symmetry_is_undone_by_another(symmetry: int) -> None:
    link = numbered_link()
    back = {5: 6, 6: 5}.get(symmetry, symmetry)  # only the quarter turns are not their own inverse
    same = turned_link(turned_link(link, symmetry), back)
    np.testing.assert_array_equal(same.truth_db, link.truth_db)
    assert same.transmitter_m == pytest.approx(link.transmitter_m)
    assert same.city.grid == link.city.grid


def test_a_crop_larger_than_the_map_is_refused() -> None:
    with pytest.raises(InputError, match="smaller crop"):
        random_crop(numbered_link(), np.random.default_rng(0), (10, 12))
