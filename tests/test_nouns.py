"""City, scenario, measurements, posterior and registry: what they promise, and what they refuse."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from skygain.city import Building, City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.ground.registry import Registry
from skygain.measurements import Measurements
from skygain.posterior import GaussianProcessPosterior, Posterior
from skygain.scenario import Scenario


def box_city() -> City:
    height = np.zeros((10, 10))
    height[2:5, 6:9] = 20.0
    square = Building(np.array([(22.0, 6.0), (34.0, 6.0), (34.0, 18.0), (22.0, 18.0)]), 20.0)
    return City(Grid((10, 10), 4.0), height, (square,), "box")


def test_obstructed_includes_the_roof_height_itself() -> None:
    city = box_city()
    assert city.obstructed(20.0).sum() == 9
    assert city.obstructed(20.1).sum() == 0


def test_rebased_crop_starts_at_zero_and_moves_its_buildings() -> None:
    crop = box_city().cropped(1, 5, (6, 5), rebase=True)
    assert crop.grid.origin_m == (0.0, 0.0)
    assert crop.obstructed(10.0)[1:4, 1:4].all()
    assert crop.buildings[0].footprint_m.min(axis=0).tolist() == [2.0, 2.0]


def test_crop_drops_buildings_outside() -> None:
    assert box_city().cropped(6, 0, (4, 4)).buildings == ()


def hill_city() -> City:
    """The box city on ground that rises by 3 m a row, from 100 m."""
    city = box_city()
    ground = 100.0 + 3.0 * np.arange(10)[:, None] + np.zeros(10)
    return City(city.grid, city.height_m, city.buildings, "hill", ground)


def test_ground_is_level_zero_unless_given() -> None:
    assert box_city().is_level
    assert box_city().ground_m.shape == (10, 10)
    assert not box_city().ground_m.any()
    assert City(Grid((2, 2), 4.0), np.zeros((2, 2)), ground_m=np.float32(7)).ground_at(0, 0) == 7
    with pytest.raises(ValueError, match="ground_m has shape"):
        City(Grid((2, 2), 4.0), np.zeros((2, 2)), ground_m=np.arange(3.0))


def test_ground_goes_with_its_cells_and_heights_stay_above_it() -> None:
    city = hill_city()
    assert not city.is_level
    np.testing.assert_array_equal(city.obstructed(10.0), box_city().obstructed(10.0))
    assert city.ground_at(0.0, 8.0) == 106
    assert city.ground_at(-500.0, 1e4) == 127  # off the map: the nearest cell
    assert city.surface_m[3, 7] == 129
    np.testing.assert_array_equal(city.cropped(2, 1, (3, 4)).ground_m, city.ground_m[2:5, 1:5])


def test_a_level_flight_meets_the_hill_and_not_the_roof_it_passes_over() -> None:
    following = Scenario(hill_city(), 10.0, 10.0)
    np.testing.assert_array_equal(following.flyable, ~box_city().obstructed(10.0))
    level = Scenario.at_level(hill_city(), 120.0, transmitter_m=(0.0, 8.0, 1.5))
    np.testing.assert_array_equal(level.flyable, hill_city().surface_m < 120.0)
    assert level.transmitter_m == (0.0, 8.0, 7.5)
    assert level.altitude_text == "120 m above sea level"
    assert following.altitude_text == "10 m above ground"
    with pytest.raises(InputError, match="lowest ground, 100 m"):
        Scenario.at_level(hill_city(), 99.0)


def test_heights_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        box_city().height_m[0, 0] = 1.0


def test_no_fly_blocks_flight_but_not_prediction() -> None:
    mask = np.zeros((10, 10), dtype=bool)
    mask[0] = True
    scenario = Scenario(box_city(), no_fly=mask)
    assert not scenario.flyable[0].any()
    assert scenario.outdoor[0].all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transmitter_m": (28.0, 12.0, 1.5)}, "inside a building"),
        ({"transmitter_m": (28.0, float("nan"), 1.5)}, "finite"),
        ({"uav_altitude_m": -1.0}, "positive"),
        ({"no_fly": np.ones((10, 10), dtype=bool)}, "no cell"),
        ({"no_fly": np.ones((2, 2), dtype=bool)}, "shape"),
    ],
)
def test_scenario_refuses_what_cannot_be_flown(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scenario(box_city(), **change)


def test_transmitter_may_stand_on_a_roof_or_off_the_map() -> None:
    Scenario(box_city(), transmitter_m=(28.0, 12.0, 25.0))
    Scenario(box_city(), transmitter_m=(-100.0, 12.0, 1.5))


def test_measurements_only_grow() -> None:
    first = Measurements.at([(0, 1)], [-90.0])
    both = first.extended(
        Measurements.at([(2, 2), (0, 1)], [-95.0, -91.0], noise_std_db=[1.0, 2.0], uav=[0, 1])
    )
    assert len(first) == 1
    assert both.gain_db.tolist() == [-90.0, -95.0, -91.0]
    assert both.visited((3, 3)).sum() == 2
    with pytest.raises(ValueError, match="read-only"):
        both.gain_db[0] = 0.0


@pytest.mark.parametrize(
    "bad",
    [
        {"gain_db": [np.nan]},
        {"gain_db": [np.inf]},
        {"noise_std_db": -1.0},
        {"cell": [(0, 0), (1, 1)]},
    ],
)
def test_measurements_refuse_bad_columns(bad: dict) -> None:
    columns = {"cell": [(0, 0)], "gain_db": [-90.0]} | bad
    with pytest.raises(InputError):
        Measurements.at(**columns)


def test_posterior_interval_and_entropy_agree_with_scipy(rng: np.random.Generator) -> None:
    posterior = Posterior(rng.normal(size=(3, 4)), rng.uniform(0.5, 4, size=(3, 4)))
    low, high = posterior.interval(0.8)
    expected = stats.norm(posterior.mean_db, posterior.std_db)
    assert np.allclose(low, expected.ppf(0.1))
    assert np.allclose(high, expected.ppf(0.9))
    cells = np.array([(0, 0), (2, 3)])
    assert np.isclose(posterior.entropy(cells), expected.entropy()[cells[:, 0], cells[:, 1]].sum())


def test_joint_posterior_entropy_and_samples_agree_with_scipy(rng: np.random.Generator) -> None:
    root = rng.normal(size=(6, 6))
    sigma = root @ root.T

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return sigma[np.ix_(a @ (3, 1), b @ (3, 1))]

    posterior = GaussianProcessPosterior(
        rng.normal(size=(2, 3)), np.diag(sigma).reshape(2, 3), covariance
    )
    cells = np.array([(0, 1), (1, 0), (1, 2)])
    block = covariance(cells, cells)
    assert np.isclose(posterior.entropy(cells), stats.multivariate_normal(cov=block).entropy())
    draws = posterior.sample_at(cells, rng, 20_000)
    assert np.allclose(np.cov(draws.T), block, atol=0.06 * np.abs(block).max())


def test_registry_names_what_it_knows() -> None:
    registry: Registry[object] = Registry("planner")
    registry.register("lawnmower", object)
    with pytest.raises(
        InputError,
        match=r"unknown planner 'lawnmover'; did you mean 'lawnmower'\? known: lawnmower",
    ):
        registry.create("lawnmover")
    with pytest.raises(ValueError, match="already"):
        registry.register("lawnmower", object)


def test_importing_the_core_loads_nothing_heavy() -> None:
    heavy = [
        "torch",
        "numba",
        "sionna",
        "mitsuba",
        "matplotlib",
        "rasterio",
        "xarray",
        "pandas",
        "geopandas",
    ]
    core = (
        "skygain.survey.loop, skygain.app.cli, skygain.predictors, skygain.planners, "
        "skygain.instruments, skygain.cities, skygain.testing"
    )
    code = f"import sys, {core}; print([m for m in {heavy} if m in sys.modules])"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert shown.strip() == "[]"


def test_a_point_in_a_courtyard_is_outdoors() -> None:
    outer = np.array([(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)])
    yard = Building(outer, 12.0, holes_m=(outer * 0.5 + 5.0,))
    city = City(Grid((5, 5), 4.0, (2.0, 2.0)), np.full((5, 5), 12.0), (yard,))
    assert city.roof_m(2.0, 10.0) == 12.0
    assert city.roof_m(10.0, 10.0) == 0.0
    assert city.roof_m(30.0, 10.0) == 0.0
    Scenario(city, uav_altitude_m=15.0, prediction_altitude_m=15.0, transmitter_m=(10.0, 10.0, 1.5))


def test_points_in_polygons_agree_with_shapely(rng: np.random.Generator) -> None:
    shapely = pytest.importorskip("shapely")
    star = np.array(
        [
            (np.cos(a) * r, np.sin(a) * r)
            for a, r in zip(np.arange(10) * np.pi / 5, [10.0, 4.0] * 5, strict=True)
        ]
    )
    points = rng.uniform(-11, 11, (300, 2))
    ours = [Building(star, 5.0).covers(x, y) for x, y in points]
    assert ours == shapely.contains_xy(shapely.Polygon(star), points).tolist()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_heights_that_are_no_numbers_are_refused(value: float) -> None:
    height = np.zeros((4, 4))
    height[1, 2] = value
    grid = Grid((4, 4), 4.0)
    with pytest.raises(InputError, match="1 heights that are no finite numbers"):
        City(grid, height)
    for ground in (height, np.float32(value), np.full((4, 4), value)):
        with pytest.raises(InputError, match="ground"):
            City(grid, np.zeros((4, 4)), ground_m=ground)
