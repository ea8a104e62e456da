"""Cities from building footprints: places, heights and parts as the file means them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skygain.cities.footprints import read_footprints
from skygain.cities.manhattan import manhattan_city
from skygain.cities.opening import open_city
from skygain.cities.prisms import rasterised
from skygain.cities.raster import save_heights
from skygain.grid import Grid
from skygain.ground.errors import InputError

geopandas = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")
pytest.importorskip("rasterio")

UTM = "EPSG:32617"


def square(x: float, y: float, width: float, depth: float | None = None) -> Any:
    """A rectangle with its south-west corner at (600000 + x, 4000000 + y)."""
    depth = width if depth is None else depth
    return shapely.box(600000 + x, 4e6 + y, 600000 + x + width, 4e6 + y + depth)


def write(path: Path, rows: list[dict[str, Any]], crs: str | None = UTM, **options: Any) -> Path:
    """A file of polygons with attributes; ``rows`` have a ``geometry`` each."""
    geopandas.GeoDataFrame(rows, geometry="geometry", crs=crs).to_file(path, **options)
    return path


def at(city: Any, x: float, y: float) -> float:
    """Height at a point, in metres from (600000, 4000000)."""
    return float(city.height_m[tuple(city.grid.cells_at([600000 + x, 4e6 + y]))])


def test_one_building_in_the_north_east(tmp_path: Path) -> None:
    rows = [
        {"height": 10.0, "geometry": square(0, 0, 4)},
        {"height": 30.0, "geometry": square(80, 60, 20, 40)},
    ]
    city = open_city(write(tmp_path / "two.gpkg", rows))
    assert city.grid == Grid((25, 25), 4.0, (600002.0, 4000002.0), UTM)
    assert city.height_m[0, 0] == 10
    assert (city.height_m[15:, 20:] == 30).all()
    assert np.count_nonzero(city.height_m) == 1 + 50
    assert [b.height_m for b in city.buildings] == [10, 30]


@pytest.mark.parametrize("suffix", ["gpkg", "geojson", "shp"])
def test_manhattan_survives_a_file_and_the_raster(tmp_path: Path, suffix: str) -> None:
    """City to polygons in a file to city, and city to GeoTIFF to city, are all the same heights."""
    made = manhattan_city(3)
    rows = [
        {"height": b.height_m, "geometry": shapely.Polygon(b.footprint_m)} for b in made.buildings
    ]
    path = write(tmp_path / f"m.{suffix}", rows, crs=UTM)
    read = open_city(path, crs="local", box=made.grid.bounds_m)
    np.testing.assert_array_equal(read.height_m, made.height_m)
    assert read.grid == made.grid
    assert len(read.buildings) == len(made.buildings)
    save_heights(read, tmp_path / "m.tif")
    np.testing.assert_array_equal(open_city(tmp_path / "m.tif").height_m, made.height_m)


def test_degrees_become_utm_and_keep_their_place(tmp_path: Path) -> None:
    rows = [
        {"height": 30.0, "geometry": square(0, 0, 50)},
        {"height": 9.0, "geometry": square(200, 100, 60)},
    ]
    path = tmp_path / "d.geojson"
    geopandas.GeoDataFrame(rows, geometry="geometry", crs=UTM).to_crs("EPSG:4326").to_file(path)
    city = open_city(path)
    assert city.crs == UTM
    assert [at(city, 25, 25), at(city, 230, 130), at(city, 100, 25)] == [30, 9, 0]
    # GeoJSON keeps 7 decimals of a degree
    np.testing.assert_allclose(city.buildings[0].footprint_m.min(axis=0), (600000, 4e6), atol=0.02)


def test_stretched_and_foreign_projections_become_utm(tmp_path: Path) -> None:
    frame = geopandas.GeoDataFrame(
        [{"height": 30.0, "geometry": square(0, 0, 50)}], geometry="geometry", crs=UTM
    )
    for name, crs in (("mercator", "EPSG:3857"), ("feet", "EPSG:2264")):
        frame.to_crs(crs).to_file(tmp_path / f"{name}.gpkg")
        city = open_city(tmp_path / f"{name}.gpkg")
        assert city.crs == UTM
        assert shapely.Polygon(city.buildings[0].footprint_m).area == pytest.approx(2500, rel=0.002)


def test_holes_and_multipolygons(tmp_path: Path) -> None:
    ring = square(0, 0, 40).difference(square(12, 12, 16))
    both = shapely.MultiPolygon([ring, square(60, 0, 8)])
    city = open_city(write(tmp_path / "h.gpkg", [{"height": 12.0, "geometry": both}]))
    assert [at(city, 2, 2), at(city, 20, 20), at(city, 62, 2)] == [12, 0, 12]
    assert [len(b.holes_m) for b in city.buildings] == [1, 0]
    for building in city.buildings:
        assert shapely.LinearRing(building.footprint_m).is_ccw
        assert not np.array_equal(building.footprint_m[0], building.footprint_m[-1])


def test_a_bow_tie_is_mended_and_what_has_no_area_is_left_out(tmp_path: Path) -> None:
    x, y = 600000, 4e6
    bow = shapely.Polygon([(x, y), (x + 40, y + 40), (x + 40, y), (x, y + 40)])
    rows = [
        {"height": 5.0, "geometry": bow},
        {"height": 5.0, "geometry": shapely.Polygon([(x, y), (x + 9, y), (x, y)])},
        {"height": 5.0, "geometry": shapely.Point(x, y)},
        {"height": 5.0, "geometry": None},
    ]
    reading = read_footprints(write(tmp_path / "b.gpkg", rows))
    assert reading.counts["polygons mended"] >= 1
    assert reading.counts["without a polygon, left out"] == 3
    assert sum(
        shapely.Polygon(b.footprint_m).area for b in reading.city.buildings
    ) == pytest.approx(800)
    assert [at(reading.city, 6, 20), at(reading.city, 22, 6)] == [5, 0]


def test_the_highest_building_wins(tmp_path: Path) -> None:
    rows = [{"height": h, "geometry": square(0, 0, 20)} for h in (10.0, 30.0, 20.0)]
    assert at(open_city(write(tmp_path / "o.gpkg", rows)), 10, 10) == 30


def test_missing_heights_get_the_default_and_are_counted(tmp_path: Path) -> None:
    rows: list[dict[str, Any]] = [
        {"height": "10 m", "levels": None, "geometry": square(0, 0, 8)},
        {"height": None, "levels": "4", "geometry": square(20, 0, 8)},
        {"height": None, "levels": None, "geometry": square(40, 0, 8)},
        {"height": "tall", "levels": None, "geometry": square(60, 0, 8)},
    ]
    path = write(tmp_path / "m.gpkg", rows)
    reading = read_footprints(path)
    assert [b.height_m for b in reading.city.buildings] == [10, 12, 9, 9]
    assert reading.counts == {
        "buildings": 4,
        "heights from levels": 1,
        "heights or levels not understood": 1,
        "without a height, taken as 9 m": 2,
    }
    assert open_city(path, default_height_m=20).buildings[2].height_m == 20
    with pytest.raises(InputError, match="default_height_m"):
        open_city(path, default_height_m=-1)


def test_a_building_covered_by_parts_is_replaced_by_them(tmp_path: Path) -> None:
    rows = [
        {"building": "yes", "building:part": None, "height": 60.0, "geometry": square(0, 0, 40)},
        {
            "building": None,
            "building:part": "yes",
            "height": 12.0,
            "geometry": square(0, 0, 40, 20),
        },
        {
            "building": None,
            "building:part": "yes",
            "height": 60.0,
            "geometry": square(0, 20, 40, 20),
        },
    ]
    reading = read_footprints(write(tmp_path / "p.gpkg", rows))
    assert [at(reading.city, 10, 10), at(reading.city, 10, 30)] == [12, 60]
    assert [b.height_m for b in reading.city.buildings] == [12, 60]
    assert reading.counts["outlines replaced by their parts"] == 1


def test_an_outline_keeps_its_height_where_no_part_is(tmp_path: Path) -> None:
    rows = [
        {"building": "yes", "building:part": None, "height": 15.0, "geometry": square(0, 0, 40)},
        {"building": None, "building:part": "yes", "height": 50.0, "geometry": square(0, 0, 20)},
        {"building": None, "building:part": "yes", "height": None, "geometry": square(20, 20, 20)},
        {"building": "yes", "building:part": None, "height": 8.0, "geometry": square(60, 0, 20)},
        {"building": None, "building:part": "yes", "height": None, "geometry": square(100, 0, 20)},
    ]
    reading = read_footprints(write(tmp_path / "p.gpkg", rows))
    city = reading.city
    assert [at(city, 10, 10), at(city, 30, 10), at(city, 10, 30)] == [50, 15, 15]
    assert at(city, 30, 30) == 15  # a part without a height has its building's
    assert [at(city, 70, 10), at(city, 110, 10)] == [
        8,
        9,
    ]  # a building without parts; a part without a building
    assert reading.counts["outlines cut by their parts"] == 1
    areas = [shapely.Polygon(b.footprint_m).area for b in city.buildings]
    assert sum(areas) == pytest.approx(1600 + 400 + 400)


def test_overhangs_are_obstacles_but_keep_their_base(tmp_path: Path) -> None:
    rows = [
        {"height": 15.0, "min_height": 12.0, "geometry": square(0, 0, 20)},
        {"height": 5.0, "min_height": 9.0, "geometry": square(40, 0, 20)},
    ]
    reading = read_footprints(write(tmp_path / "o.gpkg", rows))
    bridge, upside_down = reading.city.buildings
    assert (bridge.base_m, bridge.height_m) == (12, 15)
    assert at(reading.city, 10, 10) == 15
    assert (upside_down.base_m, upside_down.height_m) == (0, 5)
    assert reading.counts["undersides above the top, taken as the ground"] == 1


def test_only_buildings_where_buildings_are_tagged(tmp_path: Path) -> None:
    rows = [
        {"building": "yes", "location": None, "geometry": square(0, 0, 20)},
        {"building": None, "location": None, "geometry": square(0, 0, 200)},
        {"building": "no", "location": None, "geometry": square(40, 0, 20)},
        {"building": "yes", "location": "underground", "geometry": square(80, 0, 20)},
    ]
    reading = read_footprints(write(tmp_path / "t.gpkg", rows))
    assert len(reading.city.buildings) == 1
    assert reading.counts["features that are no buildings, left out"] == 2
    assert reading.counts["underground, left out"] == 1


def test_tags_in_the_collective_column(tmp_path: Path) -> None:
    rows = [
        {
            "building": "yes",
            "other_tags": '"height"=>"40 ft","building:levels"=>"9"',
            "geometry": square(0, 0, 20),
        }
    ]
    assert open_city(write(tmp_path / "t.gpkg", rows)).buildings[0].height_m == pytest.approx(
        12.192
    )


def test_box_in_degrees_and_metres(tmp_path: Path) -> None:
    rows = [{"height": 10.0 + i, "geometry": square(100 * i, 0, 50)} for i in range(8)]
    frame = geopandas.GeoDataFrame(rows, geometry="geometry", crs=UTM)
    frame.to_file(tmp_path / "m.gpkg")
    frame.to_crs("EPSG:4326").to_file(tmp_path / "d.gpkg")
    metres = (600180.0, 3999990.0, 600380.0, 4000090.0)
    for name in ("m", "d"):
        city = open_city(tmp_path / f"{name}.gpkg", box=metres)
        assert city.grid == Grid((25, 50), 4.0, (600182.0, 3999992.0), UTM)
        assert [b.height_m for b in city.buildings] == [12, 13]
    (south, west), (north, east) = Grid((1, 1), 1.0, crs=UTM).latlon(
        [[3999990, 600180], [4000090, 600380]]
    )
    for name in ("m", "d"):
        city = open_city(tmp_path / f"{name}.gpkg", box=(west, south, east, north))
        assert {12, 13} <= {b.height_m for b in city.buildings}
        assert len(city.buildings) <= 3
        with pytest.raises(InputError, match="swapped"):
            open_city(tmp_path / f"{name}.gpkg", box=(south, west, north, east))
        with pytest.raises(InputError, match="misses the data"):
            open_city(tmp_path / f"{name}.gpkg", box=(-80, 37, -79.9, 37.1))
        with pytest.raises(InputError, match="choose a `box` inside"):
            open_city(tmp_path / f"{name}.gpkg", box=(1, 1, 2, 2))


OSM = """<?xml version='1.0' encoding='UTF-8'?>
<osm version="0.6" generator="hand">
 {nodes}
 <way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="4"/><nd ref="1"/>
  <tag k="building" v="office"/><tag k="building:levels" v="4"/></way>
 <way id="11"><nd ref="5"/><nd ref="6"/><nd ref="7"/><nd ref="8"/><nd ref="5"/>
  <tag k="building:part" v="yes"/><tag k="height" v="39'"/><tag k="min_height" v="3"/></way>
 <way id="12"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="1"/><tag k="landuse" v="grass"/></way>
 <way id="13"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/></way>
</osm>
"""


def osm_text() -> str:
    """A 40 m building with a part in its western half, at a place in UTM zone 17."""
    grid = Grid((1, 1), 1.0, crs=UTM)
    corners = [(0, 0), (40, 0), (40, 40), (0, 40), (0, 0), (20, 0), (20, 40), (0, 40)]
    latlon = grid.latlon([(4e6 + y, 600000 + x) for x, y in corners])
    nodes = "".join(
        f'<node id="{i + 1}" lat="{lat:.9f}" lon="{lon:.9f}"/>'
        for i, (lat, lon) in enumerate(latlon)
    )
    return OSM.format(nodes=nodes)


def test_openstreetmap(tmp_path: Path) -> None:
    path = tmp_path / "block.osm"
    path.write_text(osm_text())
    reading = read_footprints(path, spacing_m=2)
    city = reading.city
    assert (city.crs, city.name) == (UTM, "block")
    assert at(city, 10, 20) == pytest.approx(39 * 0.3048)
    assert at(city, 30, 20) == 12
    assert {b.base_m for b in city.buildings} == {0, 3}
    assert reading.counts["outlines cut by their parts"] == 1
    latlon = city.grid.latlon(city.grid.cells_at([600020, 4e6 + 20]))
    with pytest.raises(InputError, match=r"misses the data.*swapped"):
        read_footprints(
            path, box=(latlon[0] - 0.01, latlon[1] - 0.01, latlon[0] + 0.01, latlon[1] + 0.01)
        )


def test_openstreetmap_protobuf_is_the_same(tmp_path: Path) -> None:
    """``block.osm.pbf`` holds the text above, written by osmium."""
    path = tmp_path / "block.osm"
    path.write_text(osm_text())
    text, binary = (
        read_footprints(p, spacing_m=2) for p in (path, Path(__file__).parent / "block.osm.pbf")
    )
    np.testing.assert_array_equal(binary.city.height_m, text.city.height_m)
    assert (binary.counts, binary.city.grid, binary.city.name) == (
        text.counts,
        text.city.grid,
        "block",
    )


def test_layers(tmp_path: Path) -> None:
    path = tmp_path / "l.gpkg"
    for name, height in (("roads", 1.0), ("old", 5.0), ("new", 6.0)):
        geometry = shapely.LineString([(0, 0), (9, 9)]) if name == "roads" else square(0, 0, 20)
        write(path, [{"height": height, "geometry": geometry}], layer=name)
    with pytest.raises(InputError, match="found old, new; give `layer`"):
        open_city(path)
    assert open_city(path, layer="new").height_m.max() == 6
    with pytest.raises(
        InputError, match=r"no layer .none.; give as `layer` one of roads, old, new"
    ):
        open_city(path, layer="none")
    write(path, [{"height": 7.0, "geometry": square(0, 0, 20)}], layer="Buildings")
    assert open_city(path).height_m.max() == 7


def test_a_coordinate_system_is_needed(tmp_path: Path) -> None:
    path = write(tmp_path / "n.gpkg", [{"height": 5.0, "geometry": square(0, 0, 20)}], crs=None)
    with pytest.raises(InputError, match="give `crs`"):
        open_city(path)
    assert open_city(path, crs=UTM).crs == UTM
    assert open_city(path, crs="local").crs is None
    with pytest.raises(InputError, match="not longitudes and latitudes"):
        open_city(path, crs="EPSG:4326")
    with pytest.raises(InputError, match="unknown coordinate reference system"):
        open_city(path, crs="EPSG:1")


def geojson(*geometries: dict[str, Any]) -> str:
    features = [{"type": "Feature", "properties": {"height": 5}, "geometry": g} for g in geometries]
    return json.dumps({"type": "FeatureCollection", "features": features})


def ring(*corners: tuple[float, float]) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "not readable"),
        ("hello", "not readable"),
        ('{"type": "FeatureCollection", "features": [{"type": "Feat', "not readable"),
        (geojson(), "no building polygons"),
        (
            geojson({"type": "Point", "coordinates": [11, 48]}),
            "no building polygons, found 1 without a polygon",
        ),
        (geojson(ring((691000, 5334000), (691010, 5334000), (691010, 5334010))), "give `crs`"),
        (geojson(ring((48.1, 111.5), (48.2, 111.5), (48.2, 111.6))), "swapped"),
        (geojson(ring((1, 1), (50, 1), (50, 50))), "smaller `box`"),
        ("<OGRVRTDataSource></OGRVRTDataSource>", "no layer at all"),
    ],
)
def test_unusable_geojson(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "bad.geojson"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as error:
        open_city(path)
    assert "\n" not in str(error.value)
    assert "bad.geojson" in str(error.value)


def test_a_file_cannot_send_the_reader_elsewhere(tmp_path: Path) -> None:
    """A GDAL virtual data source in disguise names other files; it is refused whatever it names."""
    write(tmp_path / "other.gpkg", [{"height": 5.0, "geometry": square(0, 0, 20)}], layer="other")
    source = f"<SrcDataSource>{tmp_path / 'other.gpkg'}</SrcDataSource>"
    path = tmp_path / "v.geojson"
    path.write_text(
        f'<OGRVRTDataSource><OGRVRTLayer name="other">{source}</OGRVRTLayer></OGRVRTDataSource>'
    )
    with pytest.raises(InputError, match="OGR_VRT"):
        open_city(path)


def test_no_buildings_is_open_ground() -> None:
    assert not rasterised((), Grid((3, 4), 4.0)).any()


def test_a_box_sees_the_parts_beyond_its_edge(tmp_path: Path) -> None:
    """A building cut by the box is treated as it is in the whole city: its outline goes, since
    parts cover it."""
    rows = [
        {
            "building": "yes",
            "building:part": None,
            "height": 60.0,
            "geometry": square(0, 0, 80, 20),
        },
        {
            "building": None,
            "building:part": "yes",
            "height": 12.0,
            "geometry": square(4, 0, 36, 20),
        },
        {
            "building": None,
            "building:part": "yes",
            "height": 30.0,
            "geometry": square(40, 0, 40, 20),
        },
    ]
    path = write(tmp_path / "e.gpkg", rows)
    whole = open_city(path)
    part = open_city(path, box=(600000, 4e6, 600020, 4000020))
    np.testing.assert_array_equal(part.height_m, whole.height_m[:5, :5])
    assert [b.height_m for b in part.buildings] == [12]
    with pytest.raises(InputError, match="choose a `box` that has some"):
        open_city(path, box=(600100, 4e6, 600120, 4000020))
