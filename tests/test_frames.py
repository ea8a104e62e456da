"""From coordinates to a grid: projections, boxes and their errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skygain.cities.reading import check_overlap
from skygain.frames import (
    box_in_metres,
    crs_label,
    grid_over,
    metric_crs,
    parse_crs,
    transformed_bounds,
)
from skygain.ground.errors import InputError

pytest.importorskip("pyproj")

DEGREES = parse_crs("EPSG:4326")


def small_box(lon: float, lat: float) -> tuple[float, float, float, float]:
    return lon - 0.001, lat - 0.001, lon + 0.001, lat + 0.001


@settings(max_examples=40, deadline=None)
@given(st.floats(-179.9, 179.9), st.floats(-79, 79))
def test_degrees_go_to_a_projection_whose_metre_is_a_metre(lon: float, lat: float) -> None:
    """Ground distances (pyproj's geodesic) and grid distances agree within UTM's 0.1 %."""
    import pyproj

    assume(abs(lat) > 1e-6)  # on the equator the centre of the box decides, by its last bit
    target = metric_crs(DEGREES, small_box(lon, lat))
    assert target.to_epsg() // 100 == (326 if lat >= 0 else 327)
    assert (
        abs((target.to_epsg() % 100 * 6 - 183 - lon + 180) % 360 - 180) <= 3.01
    )  # the zone's middle is at most 3 degrees away
    x, y = pyproj.Transformer.from_crs("EPSG:4326", target, always_xy=True).transform(
        [lon, lon + 1e-3], [lat, lat + 1e-3]
    )
    truth = pyproj.Geod(ellps="WGS84").inv(lon, lat, lon + 1e-3, lat + 1e-3)[2]
    assert np.hypot(np.diff(x), np.diff(y))[0] == pytest.approx(truth, rel=1.1e-3)


def test_geopandas_chooses_the_same_zone() -> None:
    geopandas = pytest.importorskip("geopandas")
    for lon, lat in (
        (-78.94, 36.0),
        (11.57, 48.14),
        (139.7, 35.7),
        (151.2, -33.9),
        (-43.2, -22.9),
        (18.4, -33.9),
    ):
        points = geopandas.GeoSeries.from_xy([lon], [lat], crs="EPSG:4326")
        assert metric_crs(DEGREES, small_box(lon, lat)) == points.estimate_utm_crs()


def test_a_true_metric_projection_is_kept_and_a_stretched_one_is_not() -> None:
    gauss_krueger = parse_crs("EPSG:31468")
    assert metric_crs(gauss_krueger, (4468000, 5333000, 4469000, 5334000)) == gauss_krueger
    web_mercator = (1287900, 6129900, 1288900, 6130900)  # Munich; a metre on this map is 0.67 m
    assert crs_label(metric_crs(parse_crs("EPSG:3857"), web_mercator)) == "EPSG:32632"
    state_plane_feet = (
        2030000,
        810000,
        2031000,
        811000,
    )  # Durham, North Carolina, in US survey feet
    assert crs_label(metric_crs(parse_crs("EPSG:2264"), state_plane_feet)) == "EPSG:32617"


def test_local_frames_have_no_crs() -> None:
    assert parse_crs("local") is None
    assert metric_crs(None, (0, 0, 1, 1)) is None
    assert parse_crs('LOCAL_CS["site",UNIT["metre",1]]') is None


@pytest.mark.parametrize("text", ["", "EPSG:0", "moon", "EPSG:999999", "\x00"])
def test_unknown_crs(text: str) -> None:
    with pytest.raises(InputError, match="crs"):
        parse_crs(text)


def test_metres_read_as_degrees_are_refused() -> None:
    with pytest.raises(InputError, match="`crs` as the system they are in"):
        metric_crs(DEGREES, (691000, 5334000, 692000, 5335000))
    with pytest.raises(InputError, match="swapped"):
        metric_crs(DEGREES, (35.9, -178.94, 36.0, -178.9))
    with pytest.raises(InputError, match="84 degrees"):
        metric_crs(DEGREES, small_box(0, 89))


def test_box_in_degrees_or_metres() -> None:
    utm = parse_crs("EPSG:32632")
    degrees = (11.57, 48.13, 11.58, 48.14)
    metres = box_in_metres(degrees, utm)
    assert 690000 < metres[0] < metres[2] < 693000
    back = transformed_bounds(metres, utm, DEGREES)
    assert back[0] <= degrees[0]
    assert back[1] <= degrees[1]
    assert back[2] >= degrees[2]
    assert back[3] >= degrees[3]
    assert box_in_metres(metres, utm) == metres
    assert box_in_metres(degrees, None) == degrees  # without a CRS small numbers are metres


@pytest.mark.parametrize(
    "box", [(1, 2, 1, 3), (0, 5, 1, 4), (0, 0, float("nan"), 1), (0, 0, float("inf"), 1), (1, 2, 3)]
)
def test_bad_boxes(box: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="box"):
        box_in_metres(box, None)  # type: ignore[arg-type]


def test_a_missing_box_says_where_the_data_is() -> None:
    utm = parse_crs("EPSG:32632")
    data = box_in_metres((11.57, 48.13, 11.58, 48.14), utm)
    with pytest.raises(InputError, match=r"covers \[11.5.*swapped"):
        check_overlap((0, 0, 1, 1), data, (48.13, 11.57, 48.14, 11.58), utm)
    with pytest.raises(InputError, match=r"covers \[0, 0, 9, 9\]; choose"):
        check_overlap((10, 10, 20, 20), (0, 0, 9, 9), (10, 10, 20, 20), None)


def test_grids_have_a_limit() -> None:
    assert grid_over((0, 0, 10, 6.1), 4.0, None).shape == (2, 2)
    assert grid_over((0, 0, 0.1, 0.1), 4.0, None).shape == (1, 1)
    for bounds in ((0, 0, 1e5, 1e5), (0, 0, 1e308, 1e308), (-1e308, 0, 1e308, 1)):
        with pytest.raises(InputError, match="smaller `box` or a larger `spacing_m`"):
            grid_over(bounds, 4.0, None)
    for spacing in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="spacing_m"):
            grid_over((0, 0, 10, 10), spacing, None)
