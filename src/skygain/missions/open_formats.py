"""A flight for everything else that draws lines on maps: KML, GPX, GeoJSON and CSV."""

from __future__ import annotations

__all__ = ["write_csv", "write_geojson", "write_gpx", "write_kml"]

import csv
import json
from pathlib import Path
from xml.etree import ElementTree as Xml

from skygain.ground.files import atomic_write
from skygain.missions.orders import Orders

_KML = "http://www.opengis.net/kml/2.2"
_GPX = "http://www.topografix.com/GPX/1/1"


def write_kml(orders: Orders, path: Path) -> None:
    """The way as a line and its waypoints as points, heights relative to the ground at home."""
    Xml.register_namespace("", _KML)
    root = Xml.Element(f"{{{_KML}}}kml")
    document = _child(root, _KML, "Document")
    _child(document, _KML, "name", orders.title)
    mark = _child(document, _KML, "Placemark")
    _child(mark, _KML, "name", "way")
    line = _child(mark, _KML, "LineString")
    _child(line, _KML, "tessellate", "0")
    _child(line, _KML, "altitudeMode", "relativeToGround")
    _child(
        line,
        _KML,
        "coordinates",
        " ".join(f"{p.longitude:.8f},{p.latitude:.8f},{p.height_m:.2f}" for p in orders.points),
    )
    for number, point in enumerate(orders.points):
        mark = _child(document, _KML, "Placemark")
        _child(mark, _KML, "name", str(number))
        place = _child(mark, _KML, "Point")
        _child(place, _KML, "altitudeMode", "relativeToGround")
        shown = f"{point.longitude:.8f},{point.latitude:.8f},{point.height_m:.2f}"
        _child(place, _KML, "coordinates", shown)
    _save(root, path)


def write_gpx(orders: Orders, path: Path) -> None:
    """The way as a route; elevations are the map's ground at home plus the height above it."""
    Xml.register_namespace("", _GPX)
    root = Xml.Element(f"{{{_GPX}}}gpx", {"version": "1.1", "creator": "Skygain"})
    route = _child(root, _GPX, "rte")
    _child(route, _GPX, "name", orders.title)
    for number, point in enumerate(orders.points):
        place = {"lat": f"{point.latitude:.8f}", "lon": f"{point.longitude:.8f}"}
        one = Xml.SubElement(route, f"{{{_GPX}}}rtept", place)
        _child(one, _GPX, "ele", f"{orders.home_altitude_m + point.height_m:.2f}")
        _child(one, _GPX, "name", str(number))
    _save(root, path)


def write_geojson(orders: Orders, path: Path) -> None:
    """The way as one line, with what else is known of it."""
    feature = {
        "type": "Feature",
        "properties": {
            "name": orders.title,
            "uav": orders.uav,
            "speed_mps": orders.speed_mps,
            "delay_s": orders.delay_s,
            "moment_s": [round(p.moment_s, 1) for p in orders.points],
        },
        "geometry": {
            "type": "LineString",
            "coordinates": [[p.longitude, p.latitude, p.height_m] for p in orders.points],
        },
    }
    text = json.dumps({"type": "FeatureCollection", "features": [feature]})
    with atomic_write(path) as tmp:
        tmp.write_text(text + "\n", encoding="utf-8")


def write_csv(orders: Orders, path: Path) -> None:
    """One line for each waypoint."""
    with atomic_write(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["number", "latitude", "longitude", "height_m", "moment_s", "part"])
        for number, p in enumerate(orders.points):
            place = [f"{p.latitude:.8f}", f"{p.longitude:.8f}", f"{p.height_m:.2f}"]
            part = "home" if p.homeward else "measuring"
            writer.writerow([number, *place, f"{p.moment_s:.1f}", part])


def _child(parent: Xml.Element, space: str, name: str, text: str | None = None) -> Xml.Element:
    child = Xml.SubElement(parent, f"{{{space}}}{name}")
    child.text = text
    return child


def _save(root: Xml.Element, path: Path) -> None:
    Xml.indent(root, " ")
    with atomic_write(path) as tmp:
        Xml.ElementTree(root).write(tmp, encoding="UTF-8", xml_declaration=True)
