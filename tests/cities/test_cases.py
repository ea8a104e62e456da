"""Files as professionals have them: the right heights, or one line with an option that exists."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.cities import CityOptions, read_city
from skygain.ground.errors import InputError

geopandas = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")
rasterio = pytest.importorskip("rasterio")

DATA = Path(__file__).parent / "data"


def heights(name: str | Path, **options: Any) -> list[float]:
    """Heights of the buildings, in the file's order."""
    return [round(b.height_m, 1) for b in read_city(DATA / name, **options).city.buildings]


CITY = [12.0, 20.0, 9.0, 15.0, 30.0, 7.0]


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("city.geojson", CITY),
        ("city.fgb", CITY),
        ("city.kml", CITY),
        ("city.gml", CITY),
        ("seq_as.geojson", CITY),
        ("tile.city.json", CITY),
        ("turbo_mixed.geojson", CITY),
        ("city_25833.geojson", CITY),
        ("overpass.json", [9.0, 12.0, 15.0, 18.0, 21.0, 24.0]),
        ("bdtopo_hauteur.geojson", [18.2, 24.7, 9.1, 12.6, 31.0, 6.4]),
        ("overture.geojson", [14.0, 22.5]),
        ("osm_rooflevels.geojson", [11.0, 12.0]),
        ("osm_levels.geojson", [7.5, 7.5, 9.0, 9.0, 12.0, 12.0, 12.0, 18.0]),
        ("ms_minus1.geojson", [4.4, 6.2, 9.0, 9.0, 9.8, 13.4]),
        ("ms.geojsonl", [4.4, 6.2, 9.0, 9.0, 9.8, 13.4]),
        ("relation.osm", [12.0, 18.5, 30.0]),
    ],
)
def test_heights_of_every_format(name: str, right: list[float]) -> None:
    assert sorted(heights(name)) == sorted(right)


def test_the_one_place_of_every_format() -> None:
    """The same six buildings lie in the same cells, whatever they are written as."""
    maps = [
        read_city(DATA / name).city.height_m
        for name in ("city.geojson", "city.fgb", "city.kml", "city.gml", "seq_as.geojson")
    ]
    for other in maps[1:]:
        np.testing.assert_array_equal(other, maps[0])


def test_a_height_field_is_named_with_its_unit() -> None:
    right = [32.1, 67.1, 19.7, 10.1, 125.2, 8.7]
    assert heights("nyc_heightroof.geojson", height_field="heightroof:ft") == pytest.approx(
        right, abs=0.06
    )
    notes = read_city(DATA / "nyc_heightroof.geojson").notes
    assert notes[0] == "6 of 6 buildings without a height, taken as 9 m"
    assert "`height_field`" in notes[1]
    assert "heightroof" in notes[1]
    with pytest.raises(InputError, match=r"no column 'roofs' for `height_field`.*heightroof"):
        read_city(DATA / "nyc_heightroof.geojson", height_field="roofs")


@pytest.mark.parametrize(
    ("column", "value", "right"),
    [
        ("HEIGHT_M", 12, 12.0),
        ("Building_Height_FT", 100, 30.5),
        ("H\u00f6he", 12, 12.0),
        ("stories", 4, 12.0),
        ("measuredHeight", 11, 11.0),
        ("render_height", 14, 14.0),
    ],
)
def test_columns_of_other_producers(
    tmp_path: Path, column: str, value: float, right: float
) -> None:
    frame = geopandas.read_file(DATA / "city.geojson")[["geometry"]]
    frame[column] = value
    frame.to_file(tmp_path / "c.gpkg")
    assert set(heights(tmp_path / "c.gpkg")) == {right}


@pytest.mark.parametrize("column", ["roof_height", "bldg_hgt", "heightroof"])
def test_columns_that_may_hold_heights_are_named(tmp_path: Path, column: str) -> None:
    frame = geopandas.read_file(DATA / "city.geojson")[["geometry"]]
    frame[column] = 33.0
    frame.to_file(tmp_path / "c.gpkg")
    assert f"heights may stand in {column}" in read_city(tmp_path / "c.gpkg").notes[1]
    assert heights(tmp_path / "c.gpkg", height_field=column) == [33.0] * 6


def test_the_third_coordinate_counts_over_a_terrain() -> None:
    assert any("third coordinate" in note for note in read_city(DATA / "polygonz.geojson").notes)
    assert heights("polygonz.geojson", terrain="200") == [12, 20, 9, 15, 30, 7]
    assert heights("polygonz.geojson", height_field="z", terrain="none")[0] == 212
    with pytest.raises(InputError, match="above sea level; give `terrain`"):
        heights("polygonz.geojson", height_field="z")


def test_what_is_underground_is_left_out_and_said() -> None:
    assert "1 underground, left out" in read_city(DATA / "overture.geojson").notes


def test_an_untagged_footprint_with_a_height_is_a_building(tmp_path: Path) -> None:
    rows = [
        {
            "building": "yes" if i == 0 else None,
            "height": 29.0,
            "geometry": shapely.box(x, 0, x + 8, 8),
        }
        for i, x in enumerate(range(0, 100, 20))
    ]
    rows.append({"building": None, "height": None, "geometry": shapely.box(0, 40, 90, 60)})
    geopandas.GeoDataFrame(rows, geometry="geometry", crs="EPSG:32633").to_file(tmp_path / "u.gpkg")
    reading = read_city(tmp_path / "u.gpkg")
    assert reading.counts["buildings"] == 5
    assert reading.counts["untagged polygons with a height, taken as buildings"] == 4
    assert reading.counts["features that are no buildings, left out"] == 1


def test_a_shapefile_without_prj_is_told_its_system() -> None:
    with pytest.raises(InputError, match="give `crs`"):
        read_city(DATA / "city_utm.shp")
    assert sorted(heights("city_utm.shp", crs="EPSG:32633")) == sorted(CITY)
    assert read_city(DATA / "city_utm.shp", crs="EPSG:32633").city.grid.shape == (32, 61)


def test_geoparquet(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    frame = geopandas.read_file(DATA / "city.geojson")
    frame.to_parquet(tmp_path / "c.parquet")
    right = read_city(DATA / "city.geojson").city
    read = read_city(tmp_path / "c.parquet").city
    np.testing.assert_array_equal(read.height_m, right.height_m)
    frame.to_crs(32633).to_parquet(tmp_path / "m.parquet")
    np.testing.assert_array_equal(read_city(tmp_path / "m.parquet").city.height_m, right.height_m)
    west, south, east, north = right.grid.bounds_m
    part = read_city(tmp_path / "m.parquet", box=(west, south, (west + east) / 2, north)).city
    np.testing.assert_array_equal(part.height_m, right.height_m[:, : part.grid.shape[1]])
    frame.set_crs(None, allow_override=True).to_parquet(tmp_path / "n.parquet")
    with pytest.raises(InputError, match="give `crs`"):
        read_city(tmp_path / "n.parquet")
    frame.drop(columns="geometry").to_parquet(tmp_path / "t.parquet")
    with pytest.raises(InputError, match="no GeoParquet metadata"):
        read_city(tmp_path / "t.parquet")


def test_broken_lines_of_a_sequence_are_named_or_left_out(tmp_path: Path) -> None:
    lines = (DATA / "ms.geojsonl").read_text().splitlines()
    lines.insert(2, '{"type": "Feature", "geom')
    (tmp_path / "b.geojsonl").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"line 3 is no JSON object .*`skip_bad`"):
        read_city(tmp_path / "b.geojsonl")
    reading = read_city(tmp_path / "b.geojsonl", skip_bad=True)
    assert len(reading.city.buildings) == 6
    assert "1 lines that are no features, left out" in reading.notes


def test_overpass_with_the_geometry_inside(tmp_path: Path) -> None:
    """``out geom`` gives what ``out body; >;`` gives."""
    import json

    document = json.loads((DATA / "overpass.json").read_text())
    nodes = {e["id"]: e for e in document["elements"] if e["type"] == "node"}
    inside = [
        {
            **{k: v for k, v in e.items() if k != "nodes"},
            "geometry": [{k: nodes[n][k] for k in ("lat", "lon")} for n in e["nodes"]],
        }
        for e in document["elements"]
        if e["type"] == "way"
    ]
    (tmp_path / "g.json").write_text(json.dumps({**document, "elements": inside}))
    np.testing.assert_array_equal(
        read_city(tmp_path / "g.json").city.height_m,
        read_city(DATA / "overpass.json").city.height_m,
    )


def test_archives(tmp_path: Path) -> None:
    import zipfile

    with zipfile.ZipFile(tmp_path / "c.kmz", "w") as archive:
        archive.write(DATA / "city.kml", "doc.kml")
    assert sorted(heights(tmp_path / "c.kmz")) == sorted(CITY)
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as archive:
        for suffix in ("shp", "shx", "dbf"):
            archive.write(DATA / f"city_utm.{suffix}", f"city_utm.{suffix}")
    assert sorted(heights(tmp_path / "c.zip", crs="EPSG:32633")) == sorted(CITY)
    with zipfile.ZipFile(tmp_path / "n.kmz", "w") as archive:
        archive.writestr("readme.txt", "")
    (tmp_path / "b.kmz").write_bytes(b"PK\x03\x04 no archive")
    for name, message in (("n.kmz", "holds no .kml"), ("b.kmz", "not readable as KMZ")):
        with pytest.raises(InputError, match=message):
            read_city(tmp_path / name)


def test_a_stray_polygon_is_named_with_the_box_that_leaves_it_out(tmp_path: Path) -> None:
    import re

    frame = geopandas.read_file(DATA / "city.geojson")
    frame.loc[len(frame)] = ["yes", 5, shapely.box(0, 0, 1e-4, 1e-4)]
    frame.to_file(tmp_path / "s.geojson")
    with pytest.raises(InputError, match=r"1 of 7 polygons lie up to 5,\d+ km") as error:
        read_city(tmp_path / "s.geojson")
    found = re.search(r"`box=([\d.,]+)`", str(error.value))
    assert found is not None
    box = [float(v) for v in found[1].split(",")]
    assert sorted(heights(tmp_path / "s.geojson", box=box)) == sorted(CITY)


def test_citygml_is_sent_to_a_converter(tmp_path: Path) -> None:
    (tmp_path / "c.gml").write_text(
        '<CityModel xmlns="http://www.opengis.net/citygml/2.0"></CityModel>'
    )
    with pytest.raises(InputError, match="CityJSON"):
        read_city(tmp_path / "c.gml")


def test_options_are_one_frozen_thing() -> None:
    options = CityOptions(height_field="heightroof:ft", spacing_m=8.0)
    reading = read_city(DATA / "nyc_heightroof.geojson", options, spacing_m=2.0)
    assert reading.city.grid.spacing_m == 2.0
    assert reading.city.height_m.max() == pytest.approx(125.2, abs=0.1)


def test_the_account_is_plain_data() -> None:
    import json

    data = read_city(DATA / "nyc_heightroof.geojson").as_data()
    assert json.loads(json.dumps(data)) == data
    assert data["crs"] == "EPSG:32633"
    assert data["centre_latlon"] == pytest.approx([48.2009, 16.3722], abs=1e-3)
    assert data["notes"][0].startswith("6 of 6 buildings")


BOXES = [shapely.box(600000 + 50 * i, 5339000, 600030 + 50 * i, 5339040) for i in range(6)]


def footprints(path: Path, crs: int = 4326, **columns: Any) -> Path:
    frame = geopandas.GeoDataFrame(columns, geometry=BOXES, crs=32633).to_crs(crs)
    frame.to_file(path)
    return path


def raster(path: Path, values: np.ndarray, **about: Any) -> Path:
    units = about.pop("units", None)
    corner = rasterio.Affine(4, 0, 600000, 0, -4, 5340000)
    rows, cols = values.shape
    profile = {"driver": "GTiff", "width": cols, "height": rows, "count": 1, "crs": "EPSG:32633"}
    with rasterio.open(path, "w", **profile, dtype=values.dtype, transform=corner, **about) as sink:
        sink.write(values, 1)
        if units:
            sink.units = (units,)
    return path


def blocks() -> np.ndarray:
    values = np.zeros((60, 60), np.float32)
    for i, height in enumerate(CITY):
        values[8 + i // 3 * 25 : 18 + i // 3 * 25, 5 + i % 3 * 18 : 15 + i % 3 * 18] = height
    return values


def test_heights_above_the_sea_need_the_ground(tmp_path: Path) -> None:
    path = footprints(tmp_path / "a.geojson", height=[200 + h for h in CITY])
    with pytest.raises(InputError, match=r"207 to 230 m high.*give `terrain`"):
        read_city(path)
    assert heights(path, terrain="200") == CITY
    assert heights(path, terrain="none") == [200 + h for h in CITY]


def test_heights_in_another_unit_are_refused(tmp_path: Path) -> None:
    path = footprints(tmp_path / "cm.geojson", height=[100 * h for h in CITY])
    with pytest.raises(InputError, match=r"4 of 6 buildings.*height_field=height:cm"):
        read_city(path)
    assert heights(path, height_field="height:cm") == CITY


def test_towers_stay_towers(tmp_path: Path) -> None:
    towers = [110.0, 150.0, 240.0, 300.0, 120.0, 180.0]
    assert heights(footprints(tmp_path / "t.gpkg", height=towers)) == towers


@pytest.mark.parametrize("name", ["geb_hoehe", "RelHMax", "bldg_height", "HEIGHT_AGL"])
def test_further_names_of_heights(tmp_path: Path, name: str) -> None:
    assert heights(footprints(tmp_path / "n.geojson", **{name: CITY})) == CITY


def test_folders_of_kml_are_one_heap(tmp_path: Path) -> None:
    marks = ""
    for box, height in zip(geopandas.GeoSeries(BOXES, crs=32633).to_crs(4326), CITY, strict=True):
        ring = " ".join(f"{x},{y}" for x, y in box.exterior.coords)
        marks += (
            f"<Folder><name>Block</name><Placemark><ExtendedData><Data name='height'><value>"
            f"{height}</value></Data></ExtendedData><Polygon><outerBoundaryIs><LinearRing>"
            f"<coordinates>{ring}</coordinates></LinearRing></outerBoundaryIs></Polygon>"
            "</Placemark></Folder>"
        )
    path = tmp_path / "folders.kml"
    path.write_text(
        f"<kml xmlns='http://www.opengis.net/kml/2.2'><Document>{marks}</Document></kml>",
        encoding="utf-8",
    )
    assert heights(path) == CITY


def test_ways_without_coordinates_say_what_to_ask_for(tmp_path: Path) -> None:
    way = {"type": "way", "id": 1, "tags": {"building": "yes"}, "center": {"lat": 48, "lon": 16}}
    (tmp_path / "o.json").write_text(json.dumps({"osm3s": {}, "elements": [way]}))
    with pytest.raises(InputError, match="ask the Overpass API for 'out geom'"):
        read_city(tmp_path / "o.json")


def test_compound_systems_of_cityjson(tmp_path: Path) -> None:
    tile = json.loads((DATA / "tile.city.json").read_text())
    plane = tile["metadata"]["referenceSystem"]
    right = read_city(DATA / "tile.city.json").city
    code = re.search(r"(\d+)$", plane)
    assert code
    compound = f"urn:ogc:def:crs,crs:EPSG::{code[1]},crs:EPSG::5773"
    tile["metadata"]["referenceSystem"] = compound
    (tmp_path / "c.city.json").write_text(json.dumps(tile))
    np.testing.assert_array_equal(read_city(tmp_path / "c.city.json").city.height_m, right.height_m)


@pytest.mark.parametrize(
    ("unit", "each"), [("mm", 1e3), ("meters above ground", 1.0), ("Feet", 1 / 0.3048)]
)
def test_units_of_a_raster(tmp_path: Path, unit: str, each: float) -> None:
    values = (blocks() * each).astype(np.float32)
    city = read_city(raster(tmp_path / "u.tif", values, units=unit)).city
    np.testing.assert_allclose(np.unique(city.height_m), [0.0, *sorted(CITY)], rtol=1e-5)


def test_a_level_street_above_zero_is_the_ground(tmp_path: Path) -> None:
    reading = read_city(raster(tmp_path / "one.tif", blocks() + 1.0))
    np.testing.assert_allclose(np.unique(reading.city.height_m), [0.0, *sorted(CITY)])
    assert reading.notes == ("the lowest level, 1 m, is taken as the ground",)


def test_the_noise_of_a_street_is_not_built(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 0.15, (60, 60)).astype(np.float32)
    reading = read_city(raster(tmp_path / "noise.tif", blocks() + noise))
    assert (reading.city.height_m > 0).mean() == pytest.approx((blocks() > 0).mean(), abs=0.002)
    assert any("cells below 0.5 m" in note for note in reading.notes)


def test_a_mask_of_buildings_is_no_height(tmp_path: Path) -> None:
    path = raster(tmp_path / "mask.tif", (blocks() > 0).astype(np.uint8))
    with pytest.raises(InputError, match=r"nothing but 0 and 1.*height_field=1:m"):
        read_city(path)
    assert read_city(path, height_field="1:m").city.height_m.max() == 1.0


def test_undeclared_largest_numbers_are_no_heights(tmp_path: Path) -> None:
    values = np.where(blocks() == 0, np.float32(3.4028e38), blocks())
    assert read_city(raster(tmp_path / "max.tif", values)).city.height_m.max() == max(CITY)
