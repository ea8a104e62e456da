"""Somebody's own cities and gain maps become data sets that everything takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skygain.cities import CityOptions, read_city
from skygain.datasets import ChannelDataset, build_dataset, survey_cases
from skygain.datasets.gain_maps import read_gain_maps, seen_on
from skygain.datasets.importing import import_dataset
from skygain.datasets.links import load_links
from skygain.datasets.own import own_cities
from skygain.grid import Grid
from skygain.ground.errors import InputError

pytest.importorskip("rasterio", reason="writes and reads rasters")
TOWN = str(Path(__file__).parents[2] / "examples" / "data" / "buildings.geojson")


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A height raster of another size than the town."""
    from skygain.cities.raster import save_heights
    from skygain.city import City

    height = np.zeros((50, 60), np.float32)
    height[10:20, 10:20], height[30:40, 25:50] = 12.0, 25.0
    path = tmp_path_factory.mktemp("own") / "b.tif"
    save_heights(City(Grid((50, 60), 4.0, (500002.0, 5500002.0), "EPSG:32632"), height), path)
    return str(path)


@pytest.fixture(scope="module")
def built(raster: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = own_cities(
        [TOWN, raster],
        splits=("T1", "T4"),
        transmitters=3,
        altitudes_m=(10.0, 30.0),
        propagation="gudmundson",
    )
    assert any("cut to the 50 x 60" in note for note in config.notes)
    return build_dataset(config, tmp_path_factory.mktemp("built") / "own.zarr.zip")


def test_cities_are_cut_to_one_size_and_keep_their_heights(built: Path) -> None:
    dataset = ChannelDataset.open(built)
    assert dataset.grid == Grid((50, 60), 4.0)
    assert dataset.splits == ("T1", "T4")
    assert dataset.altitudes_m == (10.0, 30.0)
    assert np.bincount(dataset.city_index).tolist() == [3, 3]
    whole = read_city(TOWN).city.height_m
    row, col = (whole.shape[0] - 50) // 2, (whole.shape[1] - 60) // 2
    np.testing.assert_allclose(
        dataset.city(0).height_m, whole[row : row + 50, col : col + 60], rtol=1e-3
    )
    for index in range(dataset.n_links):
        link = dataset.link(index)
        assert np.isfinite(link.truth_db[link.outdoor]).all()
        assert link.city.roof_m(*link.transmitter_m[:2]) == 0


def test_surveys_and_training_take_it(built: Path) -> None:
    assert len(survey_cases(ChannelDataset.open(built), "T4", crop_shape=(50, 60))) == 3
    view = load_links(built, "T1").draw(np.random.default_rng(0), 40)
    assert np.isfinite(view.gain_db[view.outdoor]).all()
    with pytest.raises(InputError, match="smaller than the 96 x 96 that networks learn from"):
        load_links(built, "T1").draw(np.random.default_rng(0), 96)


def test_more_transmitters_begin_with_the_fewer(raster: str) -> None:
    few, more = (own_cities([raster], transmitters=n) for n in (2, 5))
    city = few.drawn(0)
    np.testing.assert_array_equal(more.sites(0, city)[:2], few.sites(0, city))
    assert "own" not in str(few.as_data()["cities"][0][0])  # the file's name, not its folder


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"splits": ("T5",)}, "splits"),
        ({"splits": ("T1", "T2", "T4")}, "3 splits for 2 cities"),
        ({"side": 900}, "smallest city has, 50 x 60"),
        ({"transmitters": 0}, "transmitters"),
        ({"altitudes_m": (10.0, 10.0)}, "altitudes_m"),
        ({"options": CityOptions(spacing_m=40.0)}, "too small"),
    ],
)
def test_what_cannot_be_built_is_said_before(raster: str, changed: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        own_cities([TOWN, raster], **changed)


def gains(shape: tuple[int, int] = (30, 40)) -> np.ndarray:
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    return (-60 - 25 * np.log10(np.hypot(x - 20.0, y - 12.0) + 1)).astype(np.float32)


def written(kind: str, folder: Path) -> Path:
    """The same two maps as a file of a kind, the first with a hole."""
    maps = np.stack([gains(), gains() - 5])
    maps[:, 3:6, 30:35] = np.nan
    path = folder / f"maps.{kind}"
    if kind == "npz":
        np.savez(path, gain_db=maps, spacing_m=4.0, origin_m=(2.0, 2.0))
    elif kind == "nc":
        import xarray as xr

        axes = {"y": 2.0 + 4.0 * np.arange(30), "x": 2.0 + 4.0 * np.arange(40)}
        data = xr.Dataset({"gain_db": (("link", "y", "x"), maps)}, coords=axes)
        data.isel(y=slice(None, None, -1)).to_netcdf(path, engine="h5netcdf")
    else:
        import rasterio

        profile = {"driver": "GTiff", "height": 30, "width": 40, "count": 2, "dtype": "float32"}
        place = rasterio.Affine(4.0, 0, 0.0, 0, -4.0, 120.0)
        with rasterio.open(path, "w", transform=place, nodata=-9999, **profile) as file:
            file.write(np.nan_to_num(maps[:, ::-1], nan=-9999))
    return path


@pytest.mark.parametrize("kind", ["npz", "nc", "tif"])
def test_a_map_is_the_same_from_any_kind_of_file(kind: str, tmp_path: Path) -> None:
    maps = read_gain_maps(written(kind, tmp_path))
    assert maps.grid == Grid((30, 40), 4.0, (2.0, 2.0))
    assert np.isnan(maps.gain_db[:, 3:6, 30:35]).all()
    np.testing.assert_array_equal(np.nan_to_num(maps.gain_db[0]).min(), gains().min())
    strongest = maps.grid.cells_at(maps.transmitters_m[:, :2])
    assert strongest.tolist() == [[12, 20], [12, 20]]


def test_imported_maps_are_flown(tmp_path: Path) -> None:
    out = tmp_path / "imported.zarr.zip"
    notes = import_dataset([written("npz", tmp_path)], out, altitude_m=20.0, frequency_hz=3.5e9)
    assert any("strongest cell" in note for note in notes)
    assert any("15 cells without a gain count as built up" in note for note in notes)
    dataset = ChannelDataset.open(out)
    assert dataset.frequency_hz == 3.5e9
    (case, _) = survey_cases(dataset, "T4", altitude_m=20.0, crop_shape=(30, 40))
    np.testing.assert_allclose(
        case.truth_db[case.crop.outdoor], gains()[case.crop.outdoor], atol=0.07
    )


def test_the_buildings_of_a_city_are_laid_under_the_maps(raster: str, tmp_path: Path) -> None:
    city = read_city(raster).city
    path, out = tmp_path / "on-it.npz", tmp_path / "on-it.zarr.zip"
    np.savez(path, gain_db=gains((50, 60)), spacing_m=4.0, origin_m=(0.0, 0.0))
    local = type(city)(Grid((50, 60), 4.0), city.height_m)
    import_dataset([path, path], out, city=local)
    dataset = ChannelDataset.open(out)
    assert (dataset.n_cities, dataset.n_links) == (1, 2)
    np.testing.assert_array_equal(dataset.city(0).height_m, city.height_m)
    with pytest.raises(InputError, match="coordinate reference system, or both none"):
        import_dataset([path], out, city=city)
    beyond = seen_on(Grid((2, 2), 4.0, (0.0, -4.0)), local.grid, np.ones((50, 60)))
    assert np.isnan(beyond[0]).all()
    assert (beyond[1] == 1).all()


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"gain": gains(), "spacing_m": 4.0}, "no array 'gain_db or truth_db or mean_db'"),
        ({"gain_db": -gains(), "spacing_m": 4.0}, "turn the sign of a path loss"),
        ({"gain_db": gains()}, "give `spacing_m`"),
        ({"gain_db": np.full((5, 5), np.nan), "spacing_m": 4.0}, "map 0 holds no gain"),
        ({"gain_db": np.array(["a"]), "spacing_m": 4.0}, "must be numbers"),
        ({"gain_db": gains(), "spacing_m": 4.0, "height_m": np.zeros(3)}, "height_m has shape"),
        ({"gain_db": gains(), "spacing_m": 4.0, "transmitter_m": [1.0]}, "expected x, y and z"),
    ],
)
def test_a_file_that_cannot_be_used_says_why(arrays: dict, said: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "maps.npz", **arrays)
    with pytest.raises(InputError, match=said):
        read_gain_maps(tmp_path / "maps.npz")
