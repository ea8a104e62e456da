"""Whatever stands in a file, a reader gives a city or an `InputError` of one line, nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skygain.cities import manhattan_city, open_city
from skygain.cities.raster import save_heights
from skygain.city import City
from skygain.ground.errors import InputError

geopandas = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")
pytest.importorskip("rasterio")

SUFFIXES = ("tif", "geojson", "gpkg", "shp", "osm", "pbf")

quick = settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

numbers = (
    st.floats(-1e6, 1e6) | st.floats(-180, 180) | st.floats() | st.integers(-(10**400), 10**400)
)
positions = (
    st.lists(numbers, min_size=2, max_size=3)
    | st.just([])
    | st.tuples(st.floats(11, 11.01), st.floats(48, 48.01))
)
rings = st.lists(positions, max_size=6).map(lambda corners: [*corners, *corners[:1]])
geometries = st.one_of(
    st.none(),
    st.fixed_dictionaries({"type": st.just("Polygon"), "coordinates": st.lists(rings, max_size=3)}),
    st.fixed_dictionaries(
        {
            "type": st.just("MultiPolygon"),
            "coordinates": st.lists(st.lists(rings, max_size=2), max_size=2),
        }
    ),
    st.fixed_dictionaries(
        {"type": st.sampled_from(["Point", "LineString", "Heap"]), "coordinates": positions}
    ),
)
values = (
    st.none() | st.booleans() | numbers | st.text(max_size=8) | st.lists(st.integers(), max_size=2)
)
properties = st.dictionaries(
    st.sampled_from(
        ["height", "building", "building:part", "building:levels", "min_height", "other_tags", "x"]
    ),
    values,
)


def opened(path: Path, **options: Any) -> City | None:
    """The city, or nothing if it is refused as it should be."""
    refusal = ""
    try:
        return open_city(str(path), **options)
    except InputError as error:
        refusal = str(error)
    assert "\n" not in refusal
    assert 0 < len(refusal) < 600
    return None


@pytest.fixture(scope="module")
def good_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a readable file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    city = manhattan_city(1)
    rows = [
        {
            "height": str(b.height_m),
            "geometry": shapely.Polygon(b.footprint_m + np.array([6e5, 4e6])),
        }
        for b in city.buildings[:10]
    ]
    frame = geopandas.GeoDataFrame(rows, geometry="geometry", crs="EPSG:32617")
    save_heights(city, folder / "a.tif")
    for suffix in ("gpkg", "shp"):
        frame.to_file(folder / f"a.{suffix}")
    frame.to_crs("EPSG:4326").to_file(folder / "a.geojson")
    assert all(opened(folder / f"a.{suffix}") for suffix in ("tif", "gpkg", "shp", "geojson"))
    return {path.suffix[1:]: path.read_bytes() for path in folder.iterdir()}


@quick
@given(st.sampled_from(SUFFIXES), st.binary(max_size=300))
def test_random_bytes(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(content)
    assert opened(path) is None


@quick
@given(
    st.sampled_from(["tif", "gpkg", "shp", "shx", "dbf", "geojson"]),
    st.integers(0, 2**32),
    st.booleans(),
)
def test_damaged_files(
    tmp_path: Path, good_files: dict[str, bytes], suffix: str, seed: int, cut: bool
) -> None:
    rng = np.random.default_rng(seed)
    for name, content in good_files.items():
        damaged = bytearray(content)
        if name == suffix:
            if cut:
                damaged = damaged[: rng.integers(len(damaged))]
            else:
                where = rng.integers(min(len(damaged), 400), size=5)
                for i in where:
                    damaged[i] = rng.integers(256)
        (tmp_path / f"x.{name}").write_bytes(damaged)
    opened(tmp_path / ("x.shp" if suffix in ("shx", "dbf") else f"x.{suffix}"))


@quick
@given(
    st.lists(st.tuples(geometries, properties), max_size=4),
    st.sampled_from([None, "local", "EPSG:32632"]),
)
def test_wellformed_nonsense(
    tmp_path: Path, features: list[tuple[Any, Any]], crs: str | None
) -> None:
    path = tmp_path / "x.geojson"
    rows = [{"type": "Feature", "geometry": g, "properties": p} for g, p in features]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": rows}))
    city = opened(path, crs=crs, spacing_m=50.0)
    if city is not None:
        assert np.isfinite(city.height_m).all()
        assert city.height_m.min() >= 0


@quick
@given(st.text(max_size=40))
def test_nonsense_as_a_name(text: str) -> None:
    opened(Path("/nowhere") / text if "." in text else Path(f"{text}x"))
