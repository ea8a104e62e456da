from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import fresnel

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.propagation.diffraction import (
    EFFECTIVE_EARTH_RADIUS_M,
    bullington_loss_db,
    free_space_gain_db,
    knife_edge_loss_db,
    over_rooftop_gain_db,
)

from .conftest import box, city_of

WAVELENGTH_M = 299_792_458 / 5e9


def knife_edge_by_fresnel_db(nu: np.ndarray) -> np.ndarray:
    """Exact loss of a half plane: |½ − C(ν) + ½ − S(ν) …|, by the complex Fresnel integral."""
    s, c = fresnel(nu)
    return -20 * np.log10(np.sqrt((1 - c - s) ** 2 + (c - s) ** 2) / 2)


def test_the_knife_edge_is_the_fresnel_integral_within_a_fraction_of_a_decibel() -> None:
    nu = np.linspace(-0.7, 20, 500)
    approximate = np.array([knife_edge_loss_db(v) for v in nu])
    assert np.abs(approximate - knife_edge_by_fresnel_db(nu)).max() < 0.4
    assert knife_edge_loss_db(-0.8) == 0.0


@pytest.mark.parametrize("top_m", [12.0, 20.0, 45.0, 90.0])
def test_one_thin_edge_loses_what_the_half_plane_loses_plus_the_bullington_correction(
    top_m: float,
) -> None:
    profile = np.zeros(199)
    profile[79] = top_m
    d = 400.0
    near = 80 * d / 200
    loss = bullington_loss_db(profile, d, 8.0, 10.0, WAVELENGTH_M, np.inf)
    nu = (top_m - (8.0 + 2.0 * near / d)) * np.sqrt(2 * d / (WAVELENGTH_M * near * (d - near)))
    edge = knife_edge_by_fresnel_db(np.array(nu))
    assert loss == pytest.approx(edge + (1 - np.exp(-edge / 6)) * (10 + 0.02 * d / 1000), abs=0.3)


def test_agrees_with_pycraf_over_random_profiles() -> None:
    """The 50 % diffraction loss of pycraf's P.452-16 is Bullington's where a smooth Earth adds
    nothing."""
    pathprof = pytest.importorskip("pycraf.pathprof")
    units = pytest.importorskip("astropy.units")
    rng = np.random.default_rng(5)
    beyond_horizon = 0
    for case in range(40):
        d = rng.uniform(300.0, 3000.0)
        points = int(rng.integers(20, 200))
        ground = np.where(rng.random(points) < 0.3, rng.uniform(0, 60, points), 0.0)
        ends = rng.uniform(1.0, 25.0), rng.uniform(10.0, 60.0)
        heights = np.concatenate([[0.0], ground, [0.0]])
        path = pathprof.PathProp(
            freq=5 * units.GHz,
            temperature=290 * units.K,
            pressure=1013 * units.hPa,
            lon_t=0 * units.deg,
            lat_t=50 * units.deg,
            lon_r=0.01 * units.deg,
            lat_r=50 * units.deg,
            h_tg=ends[0] * units.m,
            h_rg=ends[1] * units.m,
            hprof_step=d / (points + 1) * units.m,
            timepercent=50 * units.percent,
            hprof_dists=np.linspace(0, d / 1000, points + 2) * units.km,
            hprof_heights=heights * units.m,
            hprof_bearing=90 * units.deg,
            hprof_backbearing=-90 * units.deg,
            generic_heights=False,
        )
        expected, *_ = pathprof.loss_diffraction(path)
        radius = path.a_e_50.to(units.m).value
        wavelength = 0.299792458 / 5.0  # pycraf's rounding of the speed of light is the same
        ours = bullington_loss_db(ground, d, ends[0], ends[1], wavelength, radius)
        assert ours == pytest.approx(float(expected.value), abs=0.02), case
        beyond_horizon += ours > 6.9
    assert beyond_horizon > 10


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), higher=st.floats(0.5, 30.0))
def test_a_higher_roof_on_the_path_never_helps(seed: int, higher: float) -> None:
    rng = np.random.default_rng(seed)
    profile = rng.uniform(0, 40, 60)
    raised = profile.copy()
    raised[int(rng.integers(60))] += higher
    args = (250.0, 1.5, 10.0, WAVELENGTH_M, EFFECTIVE_EARTH_RADIUS_M)
    # A new horizon edge moves the equivalent one, so that a strict order needs a little slack.
    assert (
        bullington_loss_db(raised, *args) >= bullington_loss_db(profile, *args) - 1e-9
        or raised.max() == profile.max()
    )


def test_nothing_in_the_way_is_free_space() -> None:
    city = city_of([])
    gain = over_rooftop_gain_db(city, [60.0, 60.0, 20.0], [25.0])[0, 0]
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    assert gain == pytest.approx(
        free_space_gain_db(np.sqrt((x - 60) ** 2 + (y - 60) ** 2 + 25)), abs=1e-4
    )


def test_a_map_is_the_loss_of_its_profiles() -> None:
    """One row of cells behind a wall, with profiles made by hand."""
    city = city_of([box(20, 0, 28, 120, 30.0)])
    tx, altitude = (
        np.array([10.3, 62.0, 1.5]),
        10.0,
    )  # on the centre line of row 15, no point on a cell border
    gain = over_rooftop_gain_db(city, tx, [altitude])[0, 0]
    for col in (9, 20, 29):
        d = city.grid.x_m[col] - tx[0]
        points = int(np.ceil(2 * d / 4.0)) - 1
        x = tx[0] + d * np.arange(1, points + 1) / (points + 1)
        profile = np.where((x > 20) & (x < 28), 30.0, 0.0)
        loss = bullington_loss_db(profile, d, 1.5, altitude, WAVELENGTH_M, EFFECTIVE_EARTH_RADIUS_M)
        assert loss > 10
        assert gain[15, col] == pytest.approx(free_space_gain_db(np.hypot(d, 8.5)) - loss, abs=1e-3)


def test_mirrored_city_mirrored_map() -> None:
    rng = np.random.default_rng(2)
    height = np.where(rng.random((25, 25)) < 0.3, rng.uniform(5, 40, (25, 25)), 0.0)
    height[12, 5] = 0.0
    grid = Grid((25, 25), 4.0, (0.0, 0.0))
    gain = over_rooftop_gain_db(City(grid, height), [20.0, 48.0, 1.5], [10.0])[0, 0]
    flipped = over_rooftop_gain_db(City(grid, height[:, ::-1]), [76.0, 48.0, 1.5], [10.0])[0, 0][
        :, ::-1
    ]
    # Profiles that run exactly along cell borders may fall on either side.
    assert np.median(np.abs(gain - flipped)) < 1e-4


def test_every_cell_is_finite_also_from_outside_the_map_and_right_above_the_transmitter() -> None:
    city = city_of([box(20, 20, 60, 60, 12.0)])
    gain = over_rooftop_gain_db(
        city, [[-150.0, 40.0, 1.5], [90.0, 90.0, 1.5], [90.0, 90.0, 10.0]], [10.0, 30.0]
    )
    assert gain.shape == (3, 2, 30, 30)
    assert np.isfinite(gain).all()
    assert (gain < 0).all()


@pytest.mark.parametrize(
    ("transmitter", "altitude", "frequency"),
    [
        ([40.0, 40.0, 1.5], [10.0], 5e9),  # indoors
        ([np.nan, 40.0, 1.5], [10.0], 5e9),
        ([5.0, 5.0], [10.0], 5e9),
        ([5.0, 5.0, -1.0], [10.0], 5e9),
        ([5.0, 5.0, 1.5], [], 5e9),
        ([5.0, 5.0, 1.5], [-10.0], 5e9),
        ([5.0, 5.0, 1.5], [10.0], 0.0),
    ],
)
def test_unusable_arguments_are_named(
    transmitter: list[float], altitude: list[float], frequency: float
) -> None:
    city = city_of([box(20, 20, 60, 60, 12.0)])
    with pytest.raises(InputError):
        over_rooftop_gain_db(city, transmitter, altitude, frequency_hz=frequency)


def test_level_ground_changes_nothing() -> None:
    from dataclasses import replace

    city = city_of([box(40, 40, 60, 60, 25.0)])
    transmitters = [(10.0, 10.0, 1.5), (-300.0, 50.0, 30.0)]
    flat = over_rooftop_gain_db(city, transmitters, [2.0, 40.0])
    raised = replace(city, ground_m=np.float32(431.5))
    np.testing.assert_array_equal(over_rooftop_gain_db(raised, transmitters, [2.0, 40.0]), flat)


def test_a_hill_is_worth_what_a_building_of_its_height_is() -> None:
    """A ridge of ground shadows what lies behind it exactly as a wall of that height does."""
    from dataclasses import replace

    city = city_of([])
    wall, hill = np.zeros(city.grid.shape, np.float32), np.zeros(city.grid.shape, np.float32)
    wall[:, 12:15] = hill[:, 12:15] = 18.0
    walled = over_rooftop_gain_db(replace(city, height_m=wall), [(10.0, 60.0, 1.5)], [2.0])[0, 0]
    hilly = over_rooftop_gain_db(replace(city, ground_m=hill), [(10.0, 60.0, 1.5)], [2.0])[0, 0]
    behind = np.ones(city.grid.shape, bool)
    behind[:, 12:15] = False
    np.testing.assert_allclose(hilly[behind], walled[behind], atol=1e-5)
    on_top = over_rooftop_gain_db(city, [(10.0, 60.0, 1.5)], [20.0])[0, 0]
    np.testing.assert_allclose(
        hilly[:, 12], on_top[:, 12], atol=1.5
    )  # a receiver 20 m up, by ridge


def test_both_ends_stand_on_their_own_ground() -> None:
    """On a plane that tilts, every path clears the ground as it does on level ground."""
    from dataclasses import replace

    city = city_of([])
    tilt = 0.2 * 4.0 * np.arange(city.grid.shape[1])[None] + np.zeros(city.grid.shape)
    flat = over_rooftop_gain_db(city, [(10.0, 60.0, 5.0)], [5.0], earth_radius_m=np.inf)[0, 0]
    slope = over_rooftop_gain_db(
        replace(city, ground_m=tilt), [(10.0, 60.0, 5.0)], [5.0], earth_radius_m=np.inf
    )[0, 0]
    far = np.hypot(*(city.grid.xy_m(city.grid.cells) - (10.0, 60.0)).T).reshape(slope.shape) > 30
    np.testing.assert_allclose(slope[far], flat[far], atol=1.5)
