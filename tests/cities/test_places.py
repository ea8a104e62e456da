"""Positions by hand: metres or degrees, in the right order, on this map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.cities.places import FAR, check_near, position_on
from skygain.grid import Grid
from skygain.ground.errors import InputError

pytest.importorskip("pyproj")

VIENNA = Grid((32, 61), 4.0, (601838.0, 5339478.0), "EPSG:32633")
LOCAL = Grid((32, 61), 4.0, (0.0, 0.0))


def test_degrees_are_understood() -> None:
    assert position_on(VIENNA, (48.2005, 16.372)) == pytest.approx((601946, 5339495), abs=1)
    assert position_on(VIENNA, (601900.0, 5339500.0)) == (601900, 5339500)


@settings(max_examples=50, deadline=None)
@given(st.floats(-1, 33), st.floats(-1, 62))
def test_metres_and_degrees_of_one_point_are_one_point(row: float, col: float) -> None:
    """PROJ's there-and-back is good to a millimetre."""
    metres = VIENNA.xy_m((row, col))
    degrees = VIENNA.latlon((row, col))
    np.testing.assert_allclose(position_on(VIENNA, degrees), metres, atol=1e-3)
    np.testing.assert_allclose(position_on(VIENNA, metres), metres)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((16.372, 48.2005), r"latitude comes first: give `transmitter=48.2005,16.372`"),
        ((52.5, 13.4), r"as latitude, longitude it is \d+ km off"),
        ((5339495.0, 601946.0), r"x and y seem exchanged: give `transmitter=601946,5339495`"),
        ((120.0, 80.0), r"not on this map: as metres it is 5,\d+ km off"),
        ((0.0, 0.0), "not on this map"),
        ((691000.0, 5334000.0), "of another projection"),
        ((float("nan"), 3.0), "off the map"),
    ],
)
def test_what_is_not_on_the_map_is_refused_with_the_likely_reason(
    numbers: tuple[float, float], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        position_on(VIENNA, numbers)
    assert "\n" not in str(error.value)


def test_a_map_without_a_place_takes_metres_only() -> None:
    assert position_on(LOCAL, (48.2, 16.4)) == (48.2, 16.4)
    with pytest.raises(InputError, match="no place on Earth"):
        position_on(LOCAL, (601946.0, 5339495.0))


def test_ten_sizes_away_is_the_limit() -> None:
    side = 61 * 4.0
    check_near(LOCAL, (-2.0 - FAR * side + 1, 10.0))
    with pytest.raises(InputError, match="off the map"):
        check_near(LOCAL, (-2.0 - FAR * side - 1, 10.0))


def test_areas_are_masks_and_zones_end_at_their_ceilings(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    shapely = pytest.importorskip("shapely")
    pytest.importorskip("rasterio")
    from skygain.cities.areas import read_areas

    west, south, _, _ = VIENNA.bounds_m
    low = shapely.box(west, south, west + 40, south + 20)
    high = shapely.box(west + 80, south, west + 120, south + 20)
    rows = [
        {"ceiling": "100 ft", "floor": None, "geometry": low},
        {"ceiling": None, "floor": 60.0, "geometry": high},
    ]
    frame = geopandas.GeoDataFrame(rows, geometry="geometry", crs=VIENNA.crs)
    frame.to_file(tmp_path / "z.gpkg")
    frame.to_crs(4326).to_file(tmp_path / "z.geojson")
    for name in ("z.gpkg", "z.geojson"):
        areas = read_areas(tmp_path / name, VIENNA, name="no_fly")
        assert areas.mask().sum() == 2 * 10 * 5
        assert areas.mask()[:5, :10].all()
        assert areas.mask(30.0).sum() == 50
        assert areas.mask(50.0).sum() == 0
        assert areas.mask(90.0)[:5, 20:30].all()
        assert areas.notes == ("1 of 2 zones have a ceiling above ground",)
    frame.translate(1e6, 0).to_file(tmp_path / "far.gpkg")
    with pytest.raises(InputError, match="no polygon touches the map"):
        read_areas(tmp_path / "far.gpkg", VIENNA)
    geopandas.GeoSeries([shapely.Point(west, south)], crs=VIENNA.crs).to_file(tmp_path / "p.gpkg")
    with pytest.raises(InputError, match="found none among 1 features"):
        read_areas(tmp_path / "p.gpkg", VIENNA)


def test_a_kml_zone_above_the_ground(tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    from skygain.cities.areas import read_areas

    south, west = VIENNA.latlon((0, 0))
    north, east = VIENNA.latlon((10, 10))
    ring = " ".join(
        f"{x:.9f},{y:.9f},45"
        for x, y in ((west, south), (east, south), (east, north), (west, north), (west, south))
    )
    (tmp_path / "z.kml").write_text(
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><Polygon>'
        "<extrude>1</extrude><altitudeMode>relativeToGround</altitudeMode><outerBoundaryIs>"
        f"<LinearRing><coordinates>{ring}</coordinates></LinearRing></outerBoundaryIs></Polygon>"
        "</Placemark></Document></kml>"
    )
    areas = read_areas(tmp_path / "z.kml", VIENNA, name="no_fly")
    assert areas.ceiling_m == (45.0,)
    assert areas.mask(40.0).any()
    assert not areas.mask(50.0).any()
