"""WPML: the way as a ``.kmz`` for DJI's apps, which take so many waypoints at once.

The archive holds ``wpmz/template.kml``, which the app shows, and ``wpmz/waylines.wpml``, which the
aircraft flies. The elements stand in the order in which DJI documents them.
"""

from __future__ import annotations

__all__ = ["WAYPOINT_LIMIT", "write_kmz"]

import zipfile
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from skygain.ground.files import atomic_write
from skygain.missions.orders import Orders, Point
from skygain.missions.timing import HOLD_S, ROUNDING_M

WAYPOINT_LIMIT = 200
"""waypoints that DJI's apps take in one mission"""
_KML = "http://www.opengis.net/kml/2.2"
_WPML = "http://www.dji.com/wpmz/1.0.2"
_STOPS = "toPointAndStopWithDiscontinuityCurvature"
_ROUNDS = "coordinateTurn"
_MOMENT = (2000, 1, 1, 0, 0, 0)
_DRONE = 77
"""the Mavic 3 Enterprise; an app with another aircraft asks and changes it"""
_EARTH_M = 6_371_008.8


def write_kmz(orders: Orders, part: slice, path: Path) -> None:
    """The waypoints of ``part``, heights relative to the take-off place."""
    points = orders.points[part]
    files = {
        "wpmz/template.kml": _template(orders, points),
        "wpmz/waylines.wpml": _waylines(orders, points),
    }
    with atomic_write(path) as tmp, zipfile.ZipFile(tmp, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name, _MOMENT)
            archive.writestr(info, content, zipfile.ZIP_DEFLATED)


def _template(orders: Orders, points: tuple[Point, ...]) -> bytes:
    root, document = _document()
    _wpml(document, "author", "Skygain")
    _config(document, orders)
    folder = Xml.SubElement(document, f"{{{_KML}}}Folder")
    _wpml(folder, "templateType", "waypoint")
    _wpml(folder, "templateId", "0")
    frame = _wpml(folder, "waylineCoordinateSysParam")
    _wpml(frame, "coordinateMode", "WGS84")
    _wpml(frame, "heightMode", "relativeToStartPoint")
    _wpml(folder, "autoFlightSpeed", f"{orders.speed_mps:g}")
    _wpml(folder, "globalHeight", f"{orders.takeoff_m:.2f}")
    _wpml(folder, "gimbalPitchMode", "manual")
    _heading(folder, "globalWaypointHeadingParam")
    _wpml(folder, "globalWaypointTurnMode", _STOPS)
    _wpml(folder, "globalUseStraightLine", "1")
    lengths = _lengths(points)
    for number, point in enumerate(points):
        mark = _placemark(folder, number, point)
        _wpml(mark, "ellipsoidHeight", f"{point.height_m:.2f}")
        _wpml(mark, "height", f"{point.height_m:.2f}")
        _wpml(mark, "useGlobalHeight", "0")
        _wpml(mark, "useGlobalSpeed", "1")
        _wpml(mark, "useGlobalHeadingParam", "1")
        _wpml(mark, "useGlobalTurnParam", "0")
        _turn(mark, points, number, lengths)
        _wpml(mark, "useStraightLine", "1")
        _wpml(mark, "gimbalPitchAngle", "0")
    return _bytes(root)


def _waylines(orders: Orders, points: tuple[Point, ...]) -> bytes:
    lengths = _lengths(points)
    root, document = _document()
    _config(document, orders)
    folder = Xml.SubElement(document, f"{{{_KML}}}Folder")
    _wpml(folder, "templateId", "0")
    _wpml(folder, "executeHeightMode", "relativeToStartPoint")
    _wpml(folder, "waylineId", "0")
    _wpml(folder, "distance", f"{lengths.sum():.2f}")
    _wpml(folder, "duration", f"{points[-1].moment_s - points[0].moment_s:.2f}")
    _wpml(folder, "autoFlightSpeed", f"{orders.speed_mps:g}")
    for number, point in enumerate(points):
        mark = _placemark(folder, number, point)
        _wpml(mark, "executeHeight", f"{point.height_m:.2f}")
        _wpml(mark, "waypointSpeed", f"{orders.speed_mps:g}")
        _heading(mark, "waypointHeadingParam")
        _turn(mark, points, number, lengths)
        _wpml(mark, "useStraightLine", "1")
        if point.stop:
            _hover(mark, number)
    return _bytes(root)


def _document() -> tuple[Xml.Element, Xml.Element]:
    Xml.register_namespace("", _KML)
    Xml.register_namespace("wpml", _WPML)
    root = Xml.Element(f"{{{_KML}}}kml")
    return root, Xml.SubElement(root, f"{{{_KML}}}Document")


def _config(document: Xml.Element, orders: Orders) -> None:
    config = _wpml(document, "missionConfig")
    _wpml(config, "flyToWaylineMode", "safely")
    _wpml(config, "finishAction", "goHome")
    _wpml(config, "exitOnRCLost", "executeLostAction")
    _wpml(config, "executeRCLostAction", "goBack")
    _wpml(config, "takeOffSecurityHeight", f"{np.clip(orders.takeoff_m, 1.2, 1500):.1f}")
    _wpml(config, "globalTransitionalSpeed", f"{orders.speed_mps:g}")
    _wpml(config, "globalRTHHeight", f"{orders.return_height_m:.0f}")
    drone = _wpml(config, "droneInfo")
    _wpml(drone, "droneEnumValue", str(_DRONE))
    _wpml(drone, "droneSubEnumValue", "0")


def _heading(parent: Xml.Element, name: str) -> None:
    heading = _wpml(parent, name)
    _wpml(heading, "waypointHeadingMode", "followWayline")


def _turn(mark: Xml.Element, points: tuple[Point, ...], number: int, lengths: np.ndarray) -> None:
    """A stop, or a corner rounded within what two rounded corners leave of the shorter leg."""
    turn = _wpml(mark, "waypointTurnParam")
    if points[number].stop or number in (0, len(points) - 1):
        _wpml(turn, "waypointTurnMode", _STOPS)
        _wpml(turn, "waypointTurnDampingDist", "0")
        return
    room = min(ROUNDING_M, 0.45 * float(lengths[number - 1 : number + 1].min()))
    _wpml(turn, "waypointTurnMode", _ROUNDS)
    _wpml(turn, "waypointTurnDampingDist", f"{room:.2f}")


def _hover(mark: Xml.Element, number: int) -> None:
    group = _wpml(mark, "actionGroup")
    _wpml(group, "actionGroupId", str(number))
    _wpml(group, "actionGroupStartIndex", str(number))
    _wpml(group, "actionGroupEndIndex", str(number))
    _wpml(group, "actionGroupMode", "sequence")
    _wpml(_wpml(group, "actionTrigger"), "actionTriggerType", "reachPoint")
    action = _wpml(group, "action")
    _wpml(action, "actionId", "0")
    _wpml(action, "actionActuatorFunc", "hover")
    _wpml(_wpml(action, "actionActuatorFuncParam"), "hoverTime", f"{HOLD_S:g}")


def _placemark(folder: Xml.Element, number: int, point: Point) -> Xml.Element:
    mark = Xml.SubElement(folder, f"{{{_KML}}}Placemark")
    place = Xml.SubElement(mark, f"{{{_KML}}}Point")
    coordinates = Xml.SubElement(place, f"{{{_KML}}}coordinates")
    coordinates.text = f"{point.longitude:.8f},{point.latitude:.8f}"
    _wpml(mark, "index", str(number))
    return mark


def _wpml(parent: Xml.Element, name: str, text: str | None = None) -> Xml.Element:
    child = Xml.SubElement(parent, f"{{{_WPML}}}{name}")
    child.text = text
    return child


def _lengths(points: tuple[Point, ...]) -> np.ndarray:
    """Metres of each leg, on a sphere."""
    lat, lon, height = np.array([(p.latitude, p.longitude, p.height_m) for p in points]).T
    north = np.radians(np.diff(lat))
    east = np.radians(np.diff(lon)) * np.cos(np.radians(lat[:-1]))
    return np.sqrt((north * _EARTH_M) ** 2 + (east * _EARTH_M) ** 2 + np.diff(height) ** 2)


def _bytes(root: Xml.Element) -> bytes:
    Xml.indent(root, " ")
    return Xml.tostring(root, encoding="UTF-8", xml_declaration=True)
