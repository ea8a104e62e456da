"""Properties that the launched gain must have, whatever the city."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skygain.cities.manhattan import manhattan_city, transmitter_sites
from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.propagation.diffraction import free_space_gain_db
from skygain.propagation.launching.antenna import Antenna, sector_gain_dbi
from skygain.propagation.launching.launch import Launching, launch_gain_db

from ..conftest import box, city_of

QUICK = Launching(azimuths=2048)
STREET = [box(20, 20, 40, 60, 15.0), box(60, 30, 90, 50, 25.0), box(50, 80, 100, 100, 12.0)]


def distance_m(city: City, transmitter_m: tuple[float, float, float], h: float) -> np.ndarray:
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    up = h - transmitter_m[2]
    return np.sqrt((x - transmitter_m[0]) ** 2 + (y - transmitter_m[1]) ** 2 + up**2)


def test_without_buildings_only_free_space_and_the_ground_remain() -> None:
    city, transmitter = city_of([]), (60.0, 61.0, 1.5)
    alone = launch_gain_db(city, transmitter, [10.0], settings=replace(QUICK, max_reflections=0))
    away = distance_m(city, transmitter, 10.0)
    far = away > 25  # nearer, the mean over a cell is not the value at its middle
    assert np.abs(alone.gain_db[0, 0] - free_space_gain_db(away))[far].max() < 0.1
    both = launch_gain_db(city, transmitter, [10.0], settings=QUICK)
    # Fresnel's coefficient for the vertical field over a half space of concrete
    sine = 11.5 / np.hypot(np.sqrt(away**2 - 8.5**2), 11.5)
    ghz = 5.0
    e = 5.24 - 1j * 17.98 * 0.0462 * ghz**0.7822 / ghz
    root = np.sqrt(e - (1 - sine**2))
    r = np.abs((e * sine - root) / (e * sine + root)) ** 2
    ground = r * (59.958e-3 / (4 * np.pi)) ** 2 / ((away**2 - 8.5**2) + 11.5**2)
    expected = 10 * np.log10(10 ** (free_space_gain_db(away) / 10) + ground)
    assert np.abs(both.gain_db[0, 0] - expected)[far].max() < 0.1


def test_threads_do_not_change_a_byte() -> None:
    city = city_of(STREET)
    one, three = (
        launch_gain_db(city, (10.0, 10.0, 1.5), [10.0, 20.0], settings=replace(QUICK, threads=n))
        for n in (1, 3)
    )
    assert one.gain_db.tobytes() == three.gain_db.tobytes()


def test_altitudes_together_are_each_alone() -> None:
    """Bit patterns of altitudes and the groups they are cut into leave nothing behind."""
    city, transmitter = city_of(STREET), (10.0, 10.0, 1.5)
    settings = replace(QUICK, azimuths=512)
    many = [2.0 + 0.75 * k for k in range(35)]
    together = launch_gain_db(city, transmitter, many, settings=settings).gain_db[0]
    for k in (0, 11, 31, 34):
        alone = launch_gain_db(city, transmitter, [many[k]], settings=settings).gain_db[0, 0]
        assert np.array_equal(alone, together[k])


def test_ends_can_be_swapped() -> None:
    """The gain from A to B is that from B to A, diffraction included."""
    grid = Grid(shape=(240, 240), spacing_m=0.5, origin_m=(0.25, 0.25))
    city = City(grid, np.zeros(grid.shape, dtype=np.float32), tuple(STREET))
    cells = [(28, 28), (164, 84), (52, 205), (204, 212), (100, 100)]
    where = [(*grid.xy_m(np.array(c)), 10.0) for c in cells]
    gain = launch_gain_db(city, where, [10.0], settings=Launching()).gain_db[:, 0]
    gaps = []
    for i, a in enumerate(cells):
        for j, b in enumerate(cells[:i]):
            there, back = gain[i][b], gain[j][a]
            assert np.isfinite([there, back]).all()
            gaps.append(abs(there - back))
    # a cell is a mean and a transmitter a point: they differ where a ray ends in the cell
    assert max(gaps) < 0.5
    assert np.median(gaps) < 0.01


def test_another_building_never_raises_the_direct_path() -> None:
    direct = replace(QUICK, max_reflections=0, diffraction=False)
    few, more = city_of(STREET[:2]), city_of(STREET)
    for transmitter in ((10.0, 10.0, 1.5), (75.0, 70.0, 30.0)):
        before = launch_gain_db(few, transmitter, [10.0, 20.0], settings=direct).gain_db
        after = launch_gain_db(more, transmitter, [10.0, 20.0], settings=direct).gain_db
        # azimuths are halved elsewhere, so equal paths differ by what their number leaves
        assert (after <= before + 0.02)[before > -120].all()
        assert (after <= before + 1.5).all()


@pytest.mark.parametrize("seed", [1, 2])
def test_no_gain_is_far_above_free_space(seed: int) -> None:
    city = manhattan_city(seed)
    for transmitter in transmitter_sites(city)[[0, 5]]:
        position = tuple(float(v) for v in transmitter)
        gain = launch_gain_db(city, position, [10.0], settings=QUICK).gain_db[0, 0]
        over = gain - free_space_gain_db(distance_m(city, position, 10.0))  # type: ignore[arg-type]
        assert not np.isnan(gain).any()
        assert over[~city.obstructed(10.0)].max() < 11.0


def test_a_roof_carries_a_transmitter_and_mirrors_it() -> None:
    city = city_of([box(40, 40, 80, 80, 20.0)])
    on_roof = (60.0, 60.0, 30.0)
    direct = replace(QUICK, max_reflections=0, diffraction=False)
    once = replace(direct, max_reflections=1)
    plain, mirrored = (
        launch_gain_db(city, on_roof, [3.0, 40.0], settings=s).gain_db[0] for s in (direct, once)
    )
    # below the roof, near the building, there is no direct path; far away there is
    assert np.isneginf(plain[0][14, 21])
    assert np.isfinite(plain[1]).all()
    # above the roof the mirrored path adds up to 3 dB
    middle = (slice(12, 18), slice(12, 18))
    added = mirrored[1][middle] - plain[1][middle]
    assert (added > 0.05).all()
    assert (added < 3.1).all()
    far = np.isfinite(plain[0])
    assert far.any()
    expected = free_space_gain_db(distance_m(city, on_roof, 3.0))
    assert np.percentile((expected - plain[0])[far], 50) < 0.05


def test_a_bridge_lets_rays_pass_beneath() -> None:
    solid, bridge = (city_of([box(50, 10, 58, 110, 20.0, base)]) for base in (0.0, 6.0))
    direct = replace(QUICK, max_reflections=0, diffraction=False)
    behind = (slice(10, 20), slice(22, 28))
    blocked, open_ = (
        launch_gain_db(c, (30.0, 60.0, 1.5), [3.0], settings=direct).gain_db[0, 0][behind]
        for c in (solid, bridge)
    )
    assert np.isneginf(blocked).all()
    assert np.isfinite(open_).all()


def test_a_courtyard_is_open_to_the_sky_only() -> None:
    ring = box(30, 30, 90, 90, 20.0)
    yard = np.array([[50.0, 50.0], [70.0, 50.0], [70.0, 70.0], [50.0, 70.0]])
    city = city_of([replace(ring, holes_m=(yard,))])
    direct = replace(QUICK, max_reflections=0, diffraction=False)
    gain = launch_gain_db(city, (60.0, 60.0, 1.5), [10.0, 100.0], settings=direct).gain_db[0]
    assert np.isfinite(gain[0][14, 14])
    assert np.isneginf(gain[0][2, 2])
    assert np.isfinite(gain[1][14, 14])


def test_walls_of_touching_buildings_do_not_exist() -> None:
    """Two halves side by side are the whole."""
    whole = city_of([box(40, 40, 80, 80, 20.0)])
    halves = city_of([box(40, 40, 60, 80, 20.0), box(60, 40, 80, 80, 20.0)])
    for transmitter in ((20.0, 25.0, 1.5), (61.0, 30.0, 30.0)):
        a, b = (
            launch_gain_db(c, transmitter, [10.0, 30.0], settings=QUICK).gain_db
            for c in (whole, halves)
        )
        outdoor = np.stack([~whole.obstructed(h) for h in (10.0, 30.0)])[None]
        assert np.array_equal(np.isfinite(a) & outdoor, np.isfinite(b) & outdoor)
        gap = np.abs(a[np.isfinite(a) & outdoor] - b[np.isfinite(a) & outdoor])
        assert np.median(gap) < 0.01
        assert np.percentile(gap, 99) < 0.5


def test_a_raster_of_boxes_is_the_polygon_it_was_made_from() -> None:
    polygon = city_of([box(40, 40, 80, 80, 20.0)])
    raster = City(polygon.grid, polygon.height_m)
    a, b = (
        launch_gain_db(c, (20.0, 25.0, 1.5), [10.0], settings=QUICK).gain_db
        for c in (polygon, raster)
    )
    assert np.array_equal(a, b)


def test_overlapping_and_degenerate_outlines_do_no_harm() -> None:
    line = np.array([[5.0, 5.0], [15.0, 5.0], [10.0, 5.0]])
    bowtie = np.array([[40.0, 40.0], [80.0, 80.0], [80.0, 40.0], [40.0, 80.0]])
    odd = [
        replace(box(0, 0, 1, 1, 30.0), footprint_m=line),
        replace(box(0, 0, 1, 1, 30.0), footprint_m=line[:2]),
        replace(box(0, 0, 1, 1, 30.0), footprint_m=bowtie),
        box(60, 60, 100, 100, 20.0),
        box(90, 90, 110, 110, 30.0),
        box(90, 20, 100, 30, 0.0),
    ]
    city = city_of([b for b in odd if len(b.footprint_m) > 2])
    gain = launch_gain_db(city, (20.0, 25.0, 1.5), [10.0, 40.0], settings=QUICK).gain_db
    assert not np.isnan(gain).any()
    assert np.isfinite(gain[0, 1]).mean() > 0.99


@pytest.mark.parametrize(
    ("transmitter", "message"),
    [
        ((30.0, 40.0, 1.5), "inside a building"),
        ((40.0, 40.0, 1.5), "stands on a wall"),
        ((5.0, 5.0, -1.0), "above the street"),
        ((np.nan, 5.0, 1.0), "three finite numbers"),
    ],
)
def test_a_transmitter_that_cannot_be_is_refused(
    transmitter: tuple[float, float, float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        launch_gain_db(city_of(STREET), transmitter, [10.0], settings=QUICK)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"frequency_hz": 1e8}, "0.3 to 100 GHz"),
        ({"max_reflections": 9}, "max_reflections must be a whole number"),
        ({"azimuths": 1}, "azimuths must be"),
        ({"ground": "cheese"}, "unknown material of the ground"),
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Launching(**wrong)  # type: ignore[arg-type]


def test_an_unknown_material_is_answered_with_the_names() -> None:
    city = city_of([replace(STREET[0], material="cheese")])
    with pytest.raises(InputError, match="known: concrete"):
        launch_gain_db(city, (10.0, 10.0, 1.5), [10.0], settings=QUICK)


def test_metal_reflects_more_than_concrete() -> None:
    metal = city_of([replace(b, material="metal") for b in STREET])
    reflected = replace(QUICK, diffraction=False)
    a, b = (
        launch_gain_db(c, (10.0, 10.0, 1.5), [10.0], settings=reflected).gain_db
        for c in (city_of(STREET), metal)
    )
    gained = b[np.isfinite(a)] - a[np.isfinite(a)]
    assert gained.min() > -1e-4
    assert gained.max() > 1.5


def test_a_sector_points_where_it_is_told() -> None:
    city, transmitter = city_of([]), (60.0, 60.0, 20.0)
    direct = replace(QUICK, max_reflections=0)
    plain = launch_gain_db(city, transmitter, [10.0], settings=direct).gain_db[0, 0]
    east = Antenna(gain_dbi=sector_gain_dbi(tilt_deg=10.0))
    north = replace(east, azimuth_deg=90.0)
    for antenna, cell in ((east, (14, 28)), (north, (28, 14))):
        gain = launch_gain_db(city, transmitter, [10.0], settings=direct, antenna=antenna)
        added = gain.gain_db[0, 0] - plain
        assert abs(added[cell] - 8.0) < 0.3
        assert added.min() > -22.5
        assert added.max() < 8.01


def test_a_horizontal_field_meets_the_ground_otherwise() -> None:
    city = city_of([])
    vertical, horizontal = (
        launch_gain_db(
            city, (60.0, 60.0, 5.0), [5.0], settings=QUICK, antenna=Antenna(polarisation=p)
        ).gain_db[0, 0]
        for p in ("vertical", "horizontal")
    )
    # near Brewster's angle the ground swallows the vertical field
    assert (horizontal - vertical)[14, 18] > 0.5


def test_combined_paths_only_add() -> None:
    """Reflections before or after a corner reach more cells and take nothing away."""
    city = city_of(STREET)
    alone, more = (
        launch_gain_db(
            city, (10.0, 10.0, 1.5), [10.0], settings=replace(QUICK, combined=c, fans=256)
        ).gain_db[0, 0]
        for c in (False, True)
    )
    outdoor = ~city.obstructed(10.0)
    assert (more >= alone - 1e-4)[outdoor].all()
    assert np.isfinite(more)[outdoor].sum() > np.isfinite(alone)[outdoor].sum()


def test_a_corner_turns_the_ground_s_reflection_too() -> None:
    """Behind a corner, with no wall to reflect, the ground's mirror image arrives beside the
    direct path."""
    city = city_of([box(40, 40, 120, 120, 60.0)])
    high = replace(QUICK, combined=True, max_reflections=1)
    behind = (slice(20, 29), slice(1, 8))
    alone, more = (
        launch_gain_db(city, (80.0, 20.0, 5.0), [5.0], settings=s).gain_db[0, 0][behind]
        for s in (replace(high, combined=False), high)
    )
    reached = np.isfinite(alone)
    assert reached.any()
    added = (more - alone)[reached]
    assert added.min() >= -1e-4
    assert 0.05 < np.median(added) < 3.1


def test_more_places_in_a_cell_change_little() -> None:
    """Where the diffracted field is steep within a cell, at boundaries and faces, it is summed."""
    city = city_of(STREET)
    few, many = (
        launch_gain_db(
            city, (10.0, 10.0, 1.5), [10.0], settings=replace(QUICK, max_reflections=0, points=p)
        ).gain_db[0, 0]
        for p in (2, 16)
    )
    outdoor = ~city.obstructed(10.0) & np.isfinite(few)
    gap = np.abs(few[outdoor] - many[outdoor])
    assert np.percentile(gap, 95) < 0.2
    assert np.sqrt((gap**2).mean()) < 0.4


def test_small_cells_find_every_corner() -> None:
    """Cells smaller than the reach of a corner add up to the power of large ones."""
    settings = Launching(combined=True, max_reflections=1, azimuths=4096)
    maps = []
    for n in (30, 120):
        side = 120 / n
        grid = Grid(shape=(n, n), spacing_m=side, origin_m=(side / 2, side / 2))
        city = City(grid, np.zeros(grid.shape, dtype=np.float32), tuple(STREET))
        gain = launch_gain_db(city, (10.0, 10.0, 1.5), [10.0], settings=settings).gain_db[0, 0]
        maps.append((10 ** (gain / 10)).reshape(30, n // 30, 30, n // 30).mean(axis=(1, 3)))
    outdoor = ~city_of(STREET).obstructed(10.0) & (maps[0] > 0)
    gap = np.abs(10 * np.log10(maps[0][outdoor] / maps[1][outdoor]))
    assert np.percentile(gap, 90) < 0.5
