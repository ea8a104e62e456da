"""Cities from GeoTIFF: heights keep their place, and unusable files are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.cities.manhattan import manhattan_city
from skygain.cities.opening import open_city
from skygain.cities.raster import read_raster, save_heights
from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.scenario import Scenario

rasterio = pytest.importorskip("rasterio")


def write(
    path: Path,
    values: np.ndarray,
    transform: Any = None,
    crs: str | None = "EPSG:32617",
    **options: Any,
) -> Path:
    """A GeoTIFF of ``values[..., row from the north, col]``, by default of 4 m pixels with the
    south-west corner at (600000, 4e6)."""
    values = values if values.ndim == 3 else values[None]
    if transform is None:
        transform = rasterio.Affine(4, 0, 600000, 0, -4, 4e6 + 4 * values.shape[1])
    units = options.pop("units", None)
    profile = {
        "driver": "GTiff",
        "count": len(values),
        "height": values.shape[1],
        "width": values.shape[2],
        "dtype": values.dtype,
    }
    with rasterio.open(path, "w", crs=crs, transform=transform, **profile, **options) as sink:
        sink.write(values)
        if units:
            sink.units = (units,) * len(values)
    return path


def heights(**cells: float) -> np.ndarray:
    """6 x 8 pixels, north up, with a building in the north-east corner."""
    values = np.zeros((6, 8), dtype=np.float32)
    values[:2, -3:] = 20.0
    return values


def test_north_is_the_last_row(tmp_path: Path) -> None:
    city = open_city(write(tmp_path / "corner.tif", heights()))
    assert city.grid == Grid((6, 8), 4.0, (600002.0, 4000002.0), "EPSG:32617")
    assert (city.height_m[-2:, -3:] == 20).all()
    assert np.count_nonzero(city.height_m) == 6
    assert city.name == "corner"


def test_latitude_grows_with_the_row_and_longitude_with_the_column(tmp_path: Path) -> None:
    grid = open_city(write(tmp_path / "corner.tif", heights())).grid
    south_west, north_west, south_east = grid.latlon([(0, 0), (5, 0), (0, 7)])
    assert north_west[0] > south_west[0]
    assert south_east[1] > south_west[1]
    np.testing.assert_array_equal(grid.cells_at_latlon(grid.latlon([(3, 5)])), [(3, 5)])


@pytest.mark.parametrize("crs", [None, "EPSG:32617"])
def test_a_saved_city_comes_back(tmp_path: Path, crs: str | None) -> None:
    made = manhattan_city(4)
    city = City(Grid((121, 121), 4.0, made.grid.origin_m, crs), made.height_m)
    save_heights(city, tmp_path / "m.tif")
    back = open_city(tmp_path / "m.tif")
    assert back.grid == city.grid
    np.testing.assert_array_equal(back.height_m, city.height_m)
    assert [p.name for p in tmp_path.iterdir()] == ["m.tif"]


def test_saving_where_one_cannot_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "taken.tif").mkdir()
    with pytest.raises(InputError, match="cannot write"):
        save_heights(manhattan_city(0), tmp_path / "taken.tif")
    assert [p.name for p in tmp_path.iterdir()] == ["taken.tif"]


def test_a_south_up_raster_is_the_same_city(tmp_path: Path) -> None:
    north_up = open_city(write(tmp_path / "n.tif", heights()))
    upside_down = rasterio.Affine(4, 0, 600000, 0, 4, 4e6)
    south_up = open_city(write(tmp_path / "s.tif", heights()[::-1].copy(), upside_down))
    np.testing.assert_array_equal(south_up.height_m, north_up.height_m)
    assert south_up.grid == north_up.grid


def test_finer_and_coarser_cells_take_the_value_at_their_centre(tmp_path: Path) -> None:
    path = write(tmp_path / "c.tif", heights())
    own = open_city(path)
    for spacing in (1.0, 2.0, 12.0):
        city = open_city(path, spacing_m=spacing)
        at = own.grid.cells_at(city.grid.xy_m(city.grid.cells))
        np.testing.assert_array_equal(city.height_m.ravel(), own.height_m[at[:, 0], at[:, 1]])


def test_a_raster_in_degrees_goes_to_utm(tmp_path: Path) -> None:
    """A block 200 m wide and 100 m long around a point keeps its size and place."""
    step = 1e-5
    lon, lat = -78.94, 36.0
    values = np.zeros((600, 600), dtype=np.uint8)
    values[280:320, 250:350] = 30
    path = write(
        tmp_path / "d.tif",
        values,
        rasterio.Affine(step, 0, lon - 300 * step, 0, -step, lat + 300 * step),
        "EPSG:4326",
    )
    city = open_city(path)
    assert city.crs == "EPSG:32617"
    assert city.grid.spacing_m == 4.0
    built = city.height_m > 0
    east, north = 100 * step * 111320 * np.cos(np.radians(lat)), 40 * step * 110950
    assert built.sum() * 16 == pytest.approx(east * north, rel=0.1)
    middle = city.grid.latlon(np.argwhere(built)).mean(axis=0)
    np.testing.assert_allclose(middle, (lat, lon), atol=2e-5)


def test_box_in_metres_and_degrees(tmp_path: Path) -> None:
    path = write(tmp_path / "c.tif", heights())
    whole = open_city(path)
    part = open_city(
        path, box=(600008.5, 4000007.5, 600024.2, 4000020.1)
    )  # nearest pixel edges: 8..24, 8..20
    np.testing.assert_array_equal(part.height_m, whole.height_m[2:5, 2:6])
    assert part.grid == whole.grid.cropped(2, 2, (3, 4))
    (south, west), (north, east) = whole.grid.latlon([(2, 2), (4, 5)])
    assert open_city(path, box=(west, south, east, north)).grid.contains((0, 0))
    with pytest.raises(InputError, match="swapped"):
        open_city(path, box=(south, west, north, east))
    with pytest.raises(InputError, match="misses the data"):
        open_city(path, box=(0, 0, 100, 100))


def test_a_box_beyond_the_data_is_open_ground_and_counted(tmp_path: Path) -> None:
    reading = read_raster(
        write(tmp_path / "c.tif", heights()), box=(599992, 4000000, 600032, 4000024)
    )
    assert reading.city.grid.shape == (6, 10)
    assert not reading.city.height_m[:, :2].any()
    assert reading.counts == {"cells without data, taken as open ground": 12}


def test_missing_and_low_values_are_ground_and_counted(tmp_path: Path) -> None:
    values = heights()
    values[0, 0], values[1, 1], values[2, 2], values[3, 3] = np.nan, -9999, -0.4, np.inf
    reading = read_raster(write(tmp_path / "c.tif", values, nodata=-9999))
    assert reading.counts == {
        "cells without data, taken as open ground": 3,
        "cells below ground, taken as open ground": 1,
    }
    assert np.count_nonzero(reading.city.height_m) == 6
    assert "3 cells without data" in str(reading)


def test_integer_nodata_and_scale(tmp_path: Path) -> None:
    values = np.array([[0, 200], [65535, 100]], dtype=np.uint16)
    path = write(tmp_path / "c.tif", values, nodata=65535)
    with rasterio.open(path, "r+") as sink:
        sink.scales = (0.1,)
    np.testing.assert_allclose(open_city(path).height_m, [[0, 10], [0, 20]])


def test_heights_in_feet(tmp_path: Path) -> None:
    assert open_city(
        write(tmp_path / "c.tif", heights(), units="ft")
    ).height_m.max() == pytest.approx(6.096)
    with pytest.raises(InputError, match="furlong"):
        open_city(write(tmp_path / "d.tif", heights(), units="furlong"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((4, 4), np.nan, np.float32), "no cell has a value"),
        (heights() + 95, "no cell at street level, so the terrain"),
        (heights() * 100, "not building heights"),
        (heights() - 9999, "not building heights"),
        (np.zeros((4, 4), np.complex64), "real numbers"),
    ],
)
def test_values_that_are_no_heights(tmp_path: Path, values: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        open_city(write(tmp_path / "c.tif", values))
    assert "\n" not in str(error.value)


def test_pictures_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="picture"):
        open_city(write(tmp_path / "c.tif", np.zeros((3, 4, 4), np.uint8), photometric="rgb"))
    with pytest.raises(InputError, match="no band 2"):
        open_city(write(tmp_path / "d.tif", heights()), height_field="2")


def test_georeference_is_needed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="georeference"):
        open_city(write(tmp_path / "a.tif", heights(), rasterio.Affine.identity(), None))
    degrees = rasterio.Affine(1e-5, 0, 11, 0, -1e-5, 48)
    with pytest.raises(InputError, match="give `crs`"):
        open_city(write(tmp_path / "b.tif", heights(), degrees, None))
    assert (
        open_city(
            write(tmp_path / "b.tif", heights(), degrees, None), crs="EPSG:4326", spacing_m=1
        ).crs
        == "EPSG:32632"
    )
    with pytest.raises(InputError, match="EPSG:32617"):
        open_city(write(tmp_path / "c.tif", heights(), crs="EPSG:4326"))
    with pytest.raises(InputError, match="unknown coordinate"):
        open_city(write(tmp_path / "c.tif", heights()), crs="nonsense")


def test_damaged_and_foreign_files(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).uniform(0, 30, (256, 256)).astype(np.float32)
    whole = write(tmp_path / "whole.tif", noise).read_bytes()
    for name, content in {
        "half": whole[: len(whole) // 2],
        "header": whole[:200],
        "empty": b"",
        "text": b"latitude,longitude\n1,2\n",
        "vrt": b'<VRTDataset rasterXSize="1" rasterYSize="1">'
        b'<VRTRasterBand dataType="Byte" band="1"/></VRTDataset>',
    }.items():
        path = tmp_path / f"{name}.tif"
        path.write_bytes(content)
        with pytest.raises(InputError, match=f"{name}.tif"):
            open_city(path)
    with pytest.raises(InputError, match="no file"):
        open_city(tmp_path / "absent.tif")
    (tmp_path / "folder.tif").mkdir()
    with pytest.raises(InputError, match="no file"):
        open_city(tmp_path / "folder.tif")


def test_a_few_bytes_cannot_ask_for_terabytes(tmp_path: Path) -> None:
    path = tmp_path / "bomb.tif"
    profile = {
        "driver": "GTiff",
        "width": 900_000,
        "height": 900_000,
        "count": 1,
        "dtype": "float32",
        "sparse_ok": True,
    }
    transform = rasterio.Affine(1, 0, 100_000, 0, -1, 4_900_000)
    with rasterio.open(
        path, "w", tiled=True, crs="EPSG:32617", bigtiff="yes", transform=transform, **profile
    ):
        pass
    with pytest.raises(InputError, match="cells, more than"):
        open_city(path)
    with pytest.raises(InputError, match="too many to read at once"):
        open_city(path, spacing_m=1000)
    assert open_city(path, box=(500_000, 4_500_000, 500_100, 4_500_100)).grid.shape == (100, 100)


def test_a_city_without_free_cells_is_refused_by_the_scenario(tmp_path: Path) -> None:
    city = City(Grid((4, 4), 4.0), np.full((4, 4), 50, np.float32))
    with pytest.raises(InputError, match="no cell"):
        Scenario(city)
