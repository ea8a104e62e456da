"""Small scenes, really traced."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skygain.city import City
from skygain.ground.errors import InputError
from skygain.propagation import sionna
from skygain.propagation.diffraction import free_space_gain_db
from skygain.propagation.launching.launch import Launching, launch_gain_db
from skygain.propagation.sionna import GUARD_DB, trace_gain_db

from .conftest import box, city_of, needs_rays

pytestmark = needs_rays

TRANSMITTER = (60.0, 60.0, 1.5)
SAMPLES = 200_000


def friis_mean_db(
    city: City, transmitter: tuple[float, float, float], altitude: float
) -> np.ndarray:
    """Free-space gain averaged over each cell's area, as the solver averages."""
    offsets = (np.arange(16) + 0.5) / 16 - 0.5
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    dx = x[..., None, None] + 4.0 * offsets[:, None] - transmitter[0]
    dy = y[..., None, None] + 4.0 * offsets[None, :] - transmitter[1]
    gain = free_space_gain_db(np.sqrt(dx**2 + dy**2 + (altitude - transmitter[2]) ** 2))
    return 10 * np.log10((10 ** (gain / 10)).mean(axis=(-1, -2)))


@pytest.fixture(scope="module")
def two_boxes() -> City:
    return city_of([box(20, 40, 40, 80, 25.0), box(80, 40, 100, 80, 25.0)])


def test_the_direct_path_is_friis_averaged_over_the_cell(two_boxes: City) -> None:
    traced = trace_gain_db(
        two_boxes, TRANSMITTER, [10.0], samples=SAMPLES, max_reflections=0, diffraction=False
    )
    sight = traced.ray_reached[0, 0]
    error = (traced.gain_db[0, 0] - friis_mean_db(two_boxes, TRANSMITTER, 10.0))[8:22, 10:20]
    assert sight[8:22, 10:20].all()
    assert np.abs(error).max() < 0.5
    assert abs(error.mean()) < 0.02
    # Directly behind the boxes there is no sight.
    assert not sight[15, :4].any()


def test_reflections_and_diffraction_only_add(two_boxes: City) -> None:
    direct = trace_gain_db(
        two_boxes, TRANSMITTER, [10.0], samples=SAMPLES, max_reflections=0, diffraction=False
    )
    reflected = trace_gain_db(two_boxes, TRANSMITTER, [10.0], samples=SAMPLES, diffraction=False)
    everything = trace_gain_db(two_boxes, TRANSMITTER, [10.0], samples=SAMPLES)
    assert (reflected.gain_db >= direct.gain_db - 1e-4).all()
    assert (everything.gain_db >= reflected.gain_db - 1e-4).all()
    assert everything.ray_reached.sum() > reflected.ray_reached.sum() >= direct.ray_reached.sum()
    assert np.isneginf(everything.gain_db[~everything.ray_reached]).all()


def test_a_symmetric_scene_gives_a_symmetric_map(two_boxes: City) -> None:
    gain = trace_gain_db(
        two_boxes, TRANSMITTER, [10.0], samples=SAMPLES, diffraction=False
    ).gain_db[0, 0]
    both = np.isfinite(gain) & np.isfinite(gain[:, ::-1])
    difference = gain[both] - gain[:, ::-1][both]
    assert abs(difference.mean()) < 0.05
    assert np.median(np.abs(difference)) < 0.3


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(two_boxes: City) -> None:
    first, again, other = (
        trace_gain_db(two_boxes, TRANSMITTER, [10.0], samples=SAMPLES, seed=s) for s in (4, 4, 5)
    )
    assert first.gain_db.tobytes() == again.gain_db.tobytes()
    assert first.gain_db.tobytes() != other.gain_db.tobytes()
    assert first.settings.seed == 4


def test_several_transmitters_in_one_call_agree_with_one_call_each(two_boxes: City) -> None:
    positions = [TRANSMITTER, (60.0, 20.0, 1.5), (10.0, 100.0, 30.0)]
    alone = trace_gain_db(two_boxes, positions, [10.0, 30.0], samples=SAMPLES)
    shared = trace_gain_db(
        two_boxes, positions, [10.0, 30.0], samples=SAMPLES, transmitters_per_call=3
    )
    assert alone.gain_db.shape == shared.gain_db.shape == (3, 2, 30, 30)
    both = alone.ray_reached & shared.ray_reached
    difference = alone.gain_db[both] - shared.gain_db[both]
    assert np.median(np.abs(difference)) < 0.2
    power = [10 ** (t.gain_db / 10) for t in (alone, shared)]
    assert power[0].sum(axis=(2, 3)) == pytest.approx(power[1].sum(axis=(2, 3)), rel=0.02)


def test_a_georeferenced_city_far_from_the_origin_loses_no_precision(two_boxes: City) -> None:
    far = city_of(
        [
            box(500_020, 4_000_040, 500_040, 4_000_080, 25.0),
            box(500_080, 4_000_040, 500_100, 4_000_080, 25.0),
        ],
        origin_m=(500_002.0, 4_000_002.0),
    )
    near = trace_gain_db(two_boxes, TRANSMITTER, [10.0], samples=SAMPLES)
    moved = trace_gain_db(far, (500_060.0, 4_000_060.0, 1.5), [10.0], samples=SAMPLES)
    assert near.gain_db.tobytes() == moved.gain_db.tobytes()


def test_a_raster_city_traces_like_its_polygons(two_boxes: City) -> None:
    raster = City(grid=two_boxes.grid, height_m=two_boxes.height_m)
    a = trace_gain_db(two_boxes, TRANSMITTER, [10.0], samples=SAMPLES)
    b = trace_gain_db(raster, TRANSMITTER, [10.0], samples=SAMPLES)
    assert a.gain_db == pytest.approx(b.gain_db, abs=1e-3)


def test_an_empty_city_has_sight_and_one_reflection_everywhere() -> None:
    city = city_of([])
    traced = trace_gain_db(city, TRANSMITTER, [10.0], samples=SAMPLES)
    excess = (traced.gain_db[0, 0] - friis_mean_db(city, TRANSMITTER, 10.0))[8:22, 8:22]
    assert traced.ray_reached.all()
    # The ground adds its reflected power without its phase: at most doubled, and hardly anything
    # where the ray falls steeply.
    assert excess.min() > -0.3
    assert 0.05 < excess.mean() < 3.0
    assert excess.max() < 3.3


def test_the_guard_cuts_what_is_above_and_counts_it_outdoors(two_boxes: City) -> None:
    transmitters, altitudes = np.array([TRANSMITTER]), np.array([10.0])
    power = np.full((1, 1, 30, 30), 1e-30, dtype=np.float32)
    power[0, 0, 2, 3] = 1.0  # outdoors
    power[0, 0, 15, 7] = 1.0  # inside the western box
    power[0, 0, 4, 4] = np.nan
    gain, guarded = sionna._guarded(power, two_boxes, transmitters, altitudes, 5e9)
    distance = np.sqrt((14.0 - 60) ** 2 + (10.0 - 60) ** 2 + 8.5**2)
    assert guarded == 1
    assert gain[0, 0, 2, 3] == pytest.approx(free_space_gain_db(distance) + GUARD_DB, abs=1e-4)
    assert np.isneginf(gain[0, 0, 4, 4])
    assert gain[0, 0, 20, 20] == pytest.approx(-300, abs=0.1)


def test_a_roof_edge_that_nearly_lies_in_the_plane_causes_no_bursts() -> None:
    """Left where it is, the roof of this wall throws single cells 14 to 56 dB above free space
    (benchmarks/ray_excess.py)."""
    city = city_of([box(20, 0, 460, 20, 10.26)], shape=(121, 121))
    transmitter = (243.0, 40.0, 1.5)
    far = np.broadcast_to(city.grid.y_m[:, None] > 60, city.grid.shape)
    friis = friis_mean_db(city, transmitter, 10.0)
    for seed in range(3):
        power = [
            10
            ** (
                trace_gain_db(
                    city,
                    transmitter,
                    [10.0],
                    samples=1_000_000,
                    seed=seed,
                    max_reflections=1,
                    diffraction=d,
                ).gain_db
                / 10
            )
            for d in (True, False)
        ]
        diffracted = np.maximum(power[0] - power[1], 1e-30)[0, 0]
        assert (10 * np.log10(diffracted) - friis)[far].max() < 0


def test_roofs_are_kept_away_from_the_cells_by_less_than_a_storey() -> None:
    """The error of direction that makes it necessary grows with the map, so the distance does too,
    up to a bound."""
    small, protocol, large = (
        sionna._clearance_m(city_of([], shape=(n, n))) for n in (30, 121, 1000)
    )
    assert 0.03 < small < protocol < 0.8
    assert large == sionna.LARGEST_CLEARANCE_M


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0},
        {"seed": -1},
        {"max_reflections": 1.5},
        {"threads": 0},
        {"frequency_hz": 1e8},
        {"transmitters_per_call": 0},
    ],
)
def test_unusable_settings_are_named(two_boxes: City, wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        trace_gain_db(two_boxes, TRANSMITTER, [10.0], **wrong)  # type: ignore[arg-type]


def test_the_launcher_diffracts_as_much_at_each_edge(two_boxes: City) -> None:
    """Where one edge gives most of the power, both programs agree on its sum."""
    settings = Launching(max_reflections=0, wedge="sionna")
    ours = launch_gain_db(two_boxes, TRANSMITTER, [10.0], settings=settings).gain_db[0, 0]
    lit = launch_gain_db(
        two_boxes, TRANSMITTER, [10.0], settings=replace(settings, diffraction=False)
    ).ray_reached[0, 0]
    theirs = trace_gain_db(
        two_boxes, TRANSMITTER, [10.0], samples=4_000_000, max_reflections=1
    ).gain_db[0, 0]
    reflected = launch_gain_db(
        two_boxes, TRANSMITTER, [10.0], settings=Launching(max_reflections=1, diffraction=False)
    ).ray_reached[0, 0]
    dark = ~lit & ~reflected & ~two_boxes.obstructed(10.0) & np.isfinite(ours)
    assert dark.sum() > 30
    ratio = (10 ** (ours[dark] / 10)).sum() / (10 ** (theirs[dark] / 10)).sum()
    assert 0.8 < ratio < 1.25
    both = dark & np.isfinite(theirs)
    assert np.median(np.abs(ours - theirs)[both]) < 1.0
