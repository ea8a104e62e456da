"""Crops, turns and mirror images, one link at a time and in batches."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygain.city import Building, City
from skygain.datasets.crops import cropped_link, mirrored_link, random_crop, turned_link
from skygain.datasets.link import Link
from skygain.datasets.loader import CropLoader
from skygain.datasets.sample import open_sample
from skygain.grid import Grid
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
    turned = turned_link(link)
    assert turned.city.grid.shape == link.city.grid.shape[::-1]
    np.testing.assert_array_equal(
        turned.truth_db[:, -1], link.truth_db[0]
    )  # the southern edge becomes the eastern one


def test_four_turns_and_two_mirrors_change_nothing() -> None:
    link = numbered_link()
    for same in (
        turned_link(link, 4),
        turned_link(turned_link(link, 3)),
        mirrored_link(mirrored_link(link)),
    ):
        np.testing.assert_array_equal(same.truth_db, link.truth_db)
        assert same.transmitter_m == pytest.approx(link.transmitter_m)
        assert same.city.grid == link.city.grid


def test_a_crop_larger_than_the_map_is_refused() -> None:
    with pytest.raises(InputError, match="smaller crop"):
        random_crop(numbered_link(), np.random.default_rng(0), (10, 12))


@pytest.mark.parametrize("shape", [(96, 96), (40, 64)])
def test_a_batch_holds_what_the_single_steps_give(shape: tuple[int, int]) -> None:
    dataset = open_sample()
    batch = CropLoader(dataset, "T1", shape=shape, batch_size=24, seed=3).batch(0)
    for k, index in enumerate(batch.link.tolist()):
        link = dataset.link(index)
        assert batch.height_m[k].shape == shape
        # every crop, turn and mirror image of this link, told apart by its transmitter
        x, y, z = batch.transmitter_m[k].tolist()
        candidates = []
        for mirror in (False, True):
            for quarters in range(4):
                cut = shape[::-1] if quarters % 2 else shape
                at = cropped_link(link, 0, 0, cut)
                at = turned_link(at, quarters)
                candidates.append((mirror, quarters, mirrored_link(at) if mirror else at))
        matches = 0
        for mirror, quarters, at in candidates:
            # where the south-west corner must have been for the transmitter to come out here
            dx, dy = np.array(at.transmitter_m[:2]) - (x, y)
            dx = -dx if mirror else dx
            for _ in range(quarters):
                dx, dy = dy, -dx
            col, row = round(dx / 4), round(dy / 4)
            cut = shape[::-1] if quarters % 2 else shape
            if not (0 <= row <= 121 - cut[0] and 0 <= col <= 121 - cut[1]):
                continue
            crop = turned_link(cropped_link(link, row, col, cut), quarters)
            crop = mirrored_link(crop) if mirror else crop
            if np.array_equal(np.where(crop.outdoor, crop.truth_db, 0), batch.gain_db[k]):
                matches += 1
                assert crop.transmitter_m == pytest.approx((x, y, z), abs=1e-3)
                np.testing.assert_array_equal(crop.city.height_m, batch.height_m[k])
                np.testing.assert_array_equal(crop.outdoor, batch.outdoor[k])
                np.testing.assert_array_equal(crop.ray_traced, batch.ray_traced[k])
        assert matches == 1


def test_a_loader_is_a_function_of_seed_and_step() -> None:
    dataset = open_sample()
    one, two, other = (CropLoader(dataset, "T1", batch_size=4, seed=s) for s in (1, 1, 2))
    for _ in range(3):
        two.batch(0)
    np.testing.assert_array_equal(one.batch(5).gain_db, two.batch(5).gain_db)
    assert not np.array_equal(one.batch(5).gain_db, other.batch(5).gain_db)
    assert one.batch(0).gain_db.dtype == one.batch(0).transmitter_m.dtype == np.float32


def test_every_map_is_used_once_per_epoch() -> None:
    dataset = open_sample()
    loader = CropLoader(dataset, "T4", altitudes_m=dataset.altitudes_m, batch_size=1, seed=1)
    used = [
        (int(b.link[0]), float(b.altitude_m[0])) for b in map(loader.batch, range(loader.n_items))
    ]
    assert len(set(used)) == loader.n_items == loader.steps_per_epoch


def test_gains_of_a_batch_are_finite_and_zero_inside_buildings() -> None:
    batch = next(iter(CropLoader(open_sample(), "T1", batch_size=8)))
    assert np.isfinite(batch.gain_db).all()
    assert (batch.gain_db[~batch.outdoor] == 0).all()
    assert (batch.gain_db[batch.outdoor] < 0).all()


@pytest.mark.parametrize(
    "options",
    [{"shape": (122, 96)}, {"shape": (0, 5)}, {"batch_size": 0}, {"altitudes_m": (17.0,)}],
)
def test_a_loader_refuses_what_cannot_be(options: dict) -> None:
    with pytest.raises(InputError):
        CropLoader(open_sample(), "T1", **options)
