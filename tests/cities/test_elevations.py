"""Height rasters: above the ground, or with the terrain still in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.cities import read_city
from skygain.cities.elevations import heights_above_ground, heights_over_terrain
from skygain.cities.manhattan import manhattan_city
from skygain.ground.errors import InputError

rasterio = pytest.importorskip("rasterio")

DATA = Path(__file__).parent / "data"


def check_city(city: Any) -> None:
    """Buildings of 8-20 m on 36 % of the cells, 33.8 % at or above 10 m."""
    built = city.height_m[city.height_m > 0]
    assert len(built) / city.height_m.size == pytest.approx(0.36, abs=0.001)
    assert (city.height_m >= 10).mean() == pytest.approx(0.338, abs=0.001)
    assert built.min() == pytest.approx(8, abs=0.01)
    assert built.max() == pytest.approx(20, abs=0.01)


@pytest.mark.parametrize("name", ["dsm_harbour_hill", "dsm_coastal_flat", "dsm_600", "dsm_1200"])
def test_a_surface_model_is_refused_with_the_option_that_helps(name: str) -> None:
    with pytest.raises(InputError, match=r"the terrain seems to be in them; give `terrain`"):
        read_city(DATA / f"{name}.tif")


@pytest.mark.parametrize("name", ["dsm_harbour_hill", "dsm_coastal_flat", "dsm_600"])
def test_a_terrain_model_takes_the_terrain_out(tmp_path: Path, name: str) -> None:
    """The ground of these models is what is left where the buildings of a flat one are taken."""
    with (
        rasterio.open(DATA / f"{name}.tif") as surface,
        rasterio.open(DATA / "ndsm_nd0.tif") as roofs,
    ):
        ground = surface.read(1) - roofs.read(1)
        with rasterio.open(tmp_path / "dtm.tif", "w", **surface.profile) as sink:
            sink.write(ground.astype(np.float32), 1)
    city = read_city(DATA / f"{name}.tif", terrain=str(tmp_path / "dtm.tif")).city
    check_city(city)
    np.testing.assert_allclose(city.ground_m, ground[::-1], atol=1e-3)
    assert not city.is_level
    np.testing.assert_allclose(city.surface_m, city.ground_m + city.height_m)


def test_the_second_band_is_the_terrain() -> None:
    for options in ({}, {"terrain": "band:2"}, {"terrain": "300"}):
        city = read_city(DATA / "dsm_dtm_two_band.tif", **options).city
        check_city(city)
        assert city.ground_m.min() == city.ground_m.max() == 300
        assert city.is_level


def test_level_ground_below_zero_is_found() -> None:
    reading = read_city(DATA / "dsm_polder.tif")
    check_city(reading.city)
    assert reading.city.ground_at(0, 0) == -4.5
    assert any("-4.5 m, is taken as the ground" in note for note in reading.notes)
    check_city(read_city(DATA / "dsm_polder.tif", terrain="-4.5").city)


def test_zero_for_no_data_is_open_ground() -> None:
    reading = read_city(DATA / "ndsm_nd0.tif")
    check_city(reading.city)
    assert reading.counts == {"cells without data, taken as open ground": 4096}


def test_heights_declared_above_a_datum_are_not_terrain() -> None:
    city = read_city(DATA / "dsm_ftus_compound.tif").city
    assert city.ground_datum == "NAVD88 height (ftUS)"
    assert city.height_m.max() == pytest.approx(20, abs=0.01)


def test_feet_that_nobody_declares_are_said_and_can_be_given() -> None:
    reading = read_city(DATA / "ndsm_ft_plane.tif")
    assert any("taken as metres although the plane is in feet" in note for note in reading.notes)
    feet = read_city(DATA / "ndsm_ft_plane.tif", height_field="1:ft").city
    np.testing.assert_allclose(feet.height_m, 0.3048 * reading.city.height_m, rtol=1e-5)


@pytest.mark.parametrize(
    "name", ["rotated", "southup", "aniso", "deg", "dm_scale", "nodata", "nodata_undeclared"]
)
def test_heights_above_ground_stay_what_they_are(name: str) -> None:
    height_m = read_city(DATA / f"ndsm_{name}.tif").city.height_m
    assert (height_m.min(), height_m.max()) == (0, pytest.approx(20, abs=0.01))
    assert set(np.round(height_m[height_m > 0])) <= set(range(8, 21))


def test_generated_cities_are_never_taken_for_terrain() -> None:
    """And on any slope they are."""
    for seed in range(20):
        roofs = manhattan_city(seed).height_m.astype(float)
        found = heights_above_ground(roofs, 4.0)
        np.testing.assert_array_equal(found.height_m, roofs.astype(np.float32))
        slope = np.linspace(0, 12, roofs.shape[1])[None] + 0 * roofs
        with pytest.raises(InputError, match="terrain"):
            heights_above_ground(roofs + slope, 4.0)
        split = heights_over_terrain(roofs + slope, slope, 4.0)
        np.testing.assert_allclose(split.height_m, roofs, atol=1e-4)
        above = heights_over_terrain(
            roofs, slope + 100, 4.0
        )  # heights above ground, with their ground
        np.testing.assert_allclose(above.height_m, roofs, atol=1e-4)
        assert above.ground_m.max() == pytest.approx(112)


def test_models_of_two_places_are_refused() -> None:
    roofs = manhattan_city(1).height_m.astype(float) + 500
    with pytest.raises(InputError, match="nowhere touches it"):
        heights_over_terrain(roofs, np.full(roofs.shape, 300.0), 4.0)


def test_a_terrain_with_gaps_is_filled_and_said() -> None:
    roofs = manhattan_city(1).height_m.astype(float)
    ground = np.full(roofs.shape, 50.0)
    ground[:10] = np.nan
    found = heights_over_terrain(roofs + 50, ground, 4.0)
    np.testing.assert_allclose(found.height_m, roofs, atol=1e-4)
    assert found.counts["cells beyond the terrain model, taken as its nearest"] == 10 * 121


def test_noise_is_no_polder(rng: np.random.Generator) -> None:
    """Heights above ground that err by 0.3 m stay where they are."""
    roofs = manhattan_city(2).height_m.astype(float)
    found = heights_above_ground(roofs + rng.normal(0, 0.3, roofs.shape), 4.0)
    assert not found.ground_m.any()
    np.testing.assert_allclose(found.height_m, roofs, atol=1.5)


def test_elevations_of_masked_roofs_are_refused() -> None:
    roofs = manhattan_city(2).height_m.astype(float)
    with pytest.raises(InputError, match="all else is masked"):
        heights_above_ground(np.where(roofs > 0, roofs + 400, np.nan), 4.0)
    masked = heights_above_ground(np.where(roofs > 0, roofs, np.nan), 4.0)
    np.testing.assert_array_equal(masked.height_m, roofs.astype(np.float32))


def test_the_wrong_terrain_does_not_let_a_surface_model_pass() -> None:
    with pytest.raises(InputError, match="terrain seems to be in them"):
        read_city(DATA / "dsm_harbour_hill.tif", terrain="5")
