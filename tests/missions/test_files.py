"""The files of a sortie say the same to the programs that read them, to the centimetre."""

from __future__ import annotations

import csv
import json
import zipfile
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest

from skygain.missions.dji import WAYPOINT_LIMIT
from skygain.missions.orders import Orders, orders_for
from skygain.missions.qgroundcontrol import RETURN, SPEED, TAKEOFF, WAYPOINT
from skygain.missions.sortie import flight_along
from skygain.missions.vehicle_files import write_sortie
from tests.missions.town import TO_DEGREES

TO_METRES = TO_DEGREES


@pytest.fixture(scope="module")
def folder(site, sortie, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sortie(site, sortie, tmp_path_factory.mktemp("files"))


@pytest.fixture(scope="module")
def orders(site, sortie) -> Orders:
    return orders_for(site, sortie, sortie.flights[0])


def metres(latlon: np.ndarray) -> np.ndarray:
    x, y = TO_METRES.transform(latlon[:, 1], latlon[:, 0], direction="INVERSE")
    return np.column_stack([x, y])


def same_way(sortie, latlon, heights) -> None:
    """Within a centimetre of the planned route in the map's metres."""
    route = sortie.flights[0].route_m
    off = np.hypot(*(metres(np.asarray(latlon)) - route[:, :2]).T)
    assert off.max() < 0.01
    assert np.abs(np.asarray(heights) - route[:, 2]).max() < 0.011


def test_waypoints_are_read_by_pymavlink(folder: Path, sortie) -> None:
    mavwp = pytest.importorskip("pymavlink.mavwp")
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(folder / "uav0.waypoints")) == loader.count()
    found = [loader.wp(k) for k in range(loader.count())]
    assert [w.command for w in found[:3]] == [WAYPOINT, TAKEOFF, SPEED]
    assert found[-1].command == RETURN
    assert all(w.autocontinue == 1 for w in found)
    way = [w for w in found[1:] if w.command in (TAKEOFF, WAYPOINT)]
    assert {w.frame for w in way} == {3}
    same_way(sortie, [(w.x, w.y) for w in way], [w.z for w in way])


def test_plans_have_what_importers_demand(folder: Path, sortie) -> None:
    plan = json.loads((folder / "uav0.plan").read_text())
    assert plan["fileType"] == "Plan"
    assert {"geoFence", "rallyPoints", "mission"} <= set(plan)
    items = plan["mission"]["items"]
    for item in items:
        assert len(item["params"]) == 7
        assert item["autoContinue"] is True
        assert all(isinstance(value, float | int) for value in item["params"])
    way = [i["params"] for i in items if i["command"] in (TAKEOFF, WAYPOINT)]
    same_way(sortie, [p[4:6] for p in way], [p[6] for p in way])
    (fence, zone) = plan["geoFence"]["polygons"]
    assert (fence["inclusion"], zone["inclusion"]) == (True, False)


@pytest.mark.parametrize("autopilot", ["PX4", "ARDUPILOTMEGA"])
def test_plans_are_imported_by_mavsdk(folder: Path, sortie, autopilot: str) -> None:
    """Behind the heartbeat of each firmware; ArduPilot counts its home as item 0."""
    from tests.missions.vehicles import Heartbeats, imported_by_mavsdk

    pytest.importorskip("mavsdk")
    with Heartbeats(autopilot) as vehicle:
        items = imported_by_mavsdk(vehicle.port, folder / "uav0.plan")
    way = [i for i in items if i.command in (TAKEOFF, WAYPOINT)]
    if autopilot == "ARDUPILOTMEGA":
        way = way[1:] if way[0].command == WAYPOINT else way
    assert {i.frame for i in way} == {3} or {int(i.frame) for i in way} == {3}
    latlon = [(i.x / 1e7, i.y / 1e7) for i in way]
    same_way(sortie, latlon, [i.z for i in way])


def test_kml_is_read_by_gdal(folder: Path, sortie) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    frame = pyogrio.read_dataframe(folder / "uav0.kml")
    (line,) = [shape for shape in frame.geometry if shape.geom_type == "LineString"]
    lon, lat, height = np.array(line.coords).T
    same_way(sortie, np.column_stack([lat, lon]), height)
    assert sum(shape.geom_type == "Point" for shape in frame.geometry) == len(lon)


def test_gpx_is_read_by_gpxpy(folder: Path, sortie, orders: Orders) -> None:
    gpxpy = pytest.importorskip("gpxpy")
    (route,) = gpxpy.parse((folder / "uav0.gpx").read_text()).routes
    points = [(p.latitude, p.longitude) for p in route.points]
    same_way(sortie, points, [p.elevation - orders.home_altitude_m for p in route.points])


def test_geojson_and_csv_say_the_same(folder: Path, sortie) -> None:
    (feature,) = json.loads((folder / "uav0.geojson").read_text())["features"]
    lon, lat, height = np.array(feature["geometry"]["coordinates"]).T
    same_way(sortie, np.column_stack([lat, lon]), height)
    with (folder / "uav0.csv").open() as file:
        rows = list(csv.DictReader(file))
    latlon = [(float(r["latitude"]), float(r["longitude"])) for r in rows]
    same_way(sortie, latlon, [float(r["height_m"]) for r in rows])
    assert rows[0]["part"] == "measuring"
    assert rows[-1]["part"] == "home"


def kmz_points(path: Path) -> list[tuple[float, float]]:
    """Places of the waylines, and a look at the order of a waypoint's elements."""
    with zipfile.ZipFile(path) as archive:
        assert sorted(archive.namelist()) == ["wpmz/template.kml", "wpmz/waylines.wpml"]
        root = Xml.fromstring(archive.read("wpmz/waylines.wpml"))
    kml = "{http://www.opengis.net/kml/2.2}"
    points = []
    for number, mark in enumerate(root.iter(f"{kml}Placemark")):
        names = [child.tag.partition("}")[2] for child in mark]
        assert names[:4] == ["Point", "index", "executeHeight", "waypointSpeed"]
        assert names[4:7] == ["waypointHeadingParam", "waypointTurnParam", "useStraightLine"]
        assert names[7:] in ([], ["actionGroup"])
        assert mark[1].text == str(number)
        lon, lat = mark[0][0].text.split(",")
        points.append((float(lat), float(lon)))
    return points


def test_waylines_hold_the_way(folder: Path, sortie) -> None:
    points = kmz_points(folder / "uav0.kmz")
    route = sortie.flights[0].route_m
    same_way(sortie, points, route[:, 2])


def test_long_ways_are_split_at_the_limit_of_the_app(site, sortie, tmp_path: Path) -> None:
    from dataclasses import replace

    cells = sortie.flights[0].cells
    zigzag = [cells[0], cells[1], cells[1] * 2 - cells[0]]
    long = np.array([zigzag[k % 2] for k in range(2 * WAYPOINT_LIMIT + 7)])
    flight = flight_along(site, 0, long, site.ways_home[0])
    where = write_sortie(site, replace(sortie, flights=(flight,)), tmp_path)
    parts = [kmz_points(path) for path in sorted(where.glob("uav0-*.kmz"))]
    assert len(parts) == 3
    assert max(map(len, parts)) <= WAYPOINT_LIMIT
    for before, after in pairwise(parts):
        assert before[-1] == after[0]
    assert sum(map(len, parts)) - 2 == len(flight.route_m)


def test_return_heights_are_over_everything_and_apart(site, sortie) -> None:
    heights = [orders_for(site, sortie, f).return_height_m for f in sortie.flights]
    assert min(heights) >= 70 + 6  # the highest block and the clearance
    assert np.diff(sorted(heights)).min() >= 12


def test_the_brief_stands_alone(folder: Path) -> None:
    page = (folder / "brief.html").read_text()
    assert "http" not in page.replace("http-equiv", "")
    assert "What can go wrong" in page
    assert (folder / "brief.png").read_bytes()[:4] == b"\x89PNG"
