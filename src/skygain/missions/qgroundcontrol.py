"""Files for QGroundControl and what understands its formats: ``.plan`` and ``.waypoints``.

Heights are above the take-off place (MAV_FRAME_GLOBAL_RELATIVE_ALT). Importers are strict in ways
of their own: both ``geoFence`` and ``rallyPoints`` have to be there, each item has seven parameters
and ``autoContinue``, and a place is never ``null``, which would become 0, 0.
"""

from __future__ import annotations

__all__ = ["LAND", "RETURN", "SPEED", "TAKEOFF", "WAYPOINT", "Item", "items", "write_plan",
           "write_waypoints"]  # fmt: skip

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skygain.ground.files import atomic_write
from skygain.missions.orders import Orders
from skygain.missions.timing import HOLD_S, ROUNDING_M

WAYPOINT, RETURN, LAND, TAKEOFF, SPEED, DELAY = 16, 20, 21, 22, 178, 93
"""numbers of MAVLink commands"""
RELATIVE, NO_PLACE = 3, 2
"""frames: above the take-off place, and none"""
_FIRMWARE_PX4, _QUADROTOR = 12, 2


@dataclass(frozen=True)
class Item:
    """One item of a mission."""

    command: int
    """number of the MAVLink command"""
    frame: int
    """what the place is measured from"""
    params: tuple[float, float, float, float]
    """the first four parameters"""
    latitude: float = 0.0
    """degrees, or 0 where the command has no place"""
    longitude: float = 0.0
    """degrees, or 0 where the command has no place"""
    height_m: float = 0.0
    """above the take-off place"""


def items(orders: Orders, *, airborne: bool = False) -> list[Item]:
    """Take-off (unless it is ``airborne``), speed, the way, and the return that lands."""
    lat, lon = orders.home
    way = [
        Item(
            WAYPOINT,
            RELATIVE,
            # without a hold an autopilot rounds the corner, from the acceptance radius on
            (HOLD_S if point.stop else 0.0, 0.0 if point.stop else ROUNDING_M, 0.0, 0.0),
            point.latitude,
            point.longitude,
            point.height_m,
        )
        for point in orders.points[1:]
    ]
    up = Item(TAKEOFF, RELATIVE, (0.0, 0.0, 0.0, 0.0), lat, lon, orders.takeoff_m)
    return [
        *([] if airborne else [up]),
        # ground speed, in m/s, throttle as it is
        Item(SPEED, NO_PLACE, (1.0, orders.speed_mps, -1.0, 0.0)),
        *way,
        Item(RETURN, NO_PLACE, (0.0, 0.0, 0.0, 0.0)),
    ]


def write_plan(orders: Orders, path: Path) -> None:
    """A plan with mission, geofence and rally point, for PX4 and ArduPilot."""
    lat, lon = orders.home
    plan: dict[str, Any] = {
        "fileType": "Plan",
        "geoFence": {
            "circles": [],
            "polygons": [
                *(_polygon(ring, True) for ring in orders.fence[:1]),
                *(_polygon(ring, False) for ring in orders.keep_out),
            ],
            "version": 2,
        },
        "groundStation": "QGroundControl",
        "mission": {
            "cruiseSpeed": 15,
            "firmwareType": _FIRMWARE_PX4,
            "globalPlanAltitudeMode": 1,
            "hoverSpeed": orders.speed_mps,
            "items": [_plan_item(item, k) for k, item in enumerate(items(orders), start=1)],
            "plannedHomePosition": [lat, lon, round(orders.home_altitude_m, 2)],
            "vehicleType": _QUADROTOR,
            "version": 2,
        },
        "rallyPoints": {"points": [[lat, lon, orders.return_height_m]], "version": 2},
        "version": 1,
    }
    with atomic_write(path) as tmp:
        tmp.write_text(json.dumps(plan, indent=1) + "\n", encoding="utf-8")


def _polygon(ring: tuple[tuple[float, float], ...], inclusion: bool) -> dict[str, Any]:
    return {"inclusion": inclusion, "polygon": [list(corner) for corner in ring], "version": 1}


def _plan_item(item: Item, number: int) -> dict[str, Any]:
    found: dict[str, Any] = {
        "autoContinue": True,
        "command": item.command,
        "doJumpId": number,
        "frame": item.frame,
        "params": [*item.params, item.latitude, item.longitude, item.height_m],
        "type": "SimpleItem",
    }
    if item.frame == RELATIVE:
        found |= {"AMSLAltAboveTerrain": None, "Altitude": item.height_m, "AltitudeMode": 1}
    return found


def write_waypoints(orders: Orders, path: Path) -> None:
    """The same mission as QGC WPL 110; its first line is the take-off place, as ArduPilot numbers
    items."""
    lat, lon = orders.home
    lines = ["QGC WPL 110"]
    home = Item(WAYPOINT, 0, (0.0, 0.0, 0.0, 0.0), lat, lon, orders.home_altitude_m)
    for number, item in enumerate([home, *items(orders)]):
        numbers = "\t".join(f"{value:.8f}" for value in item.params)
        place = f"{item.latitude:.8f}\t{item.longitude:.8f}\t{item.height_m:.6f}"
        head = f"{number}\t{int(number == 0)}\t{item.frame}\t{item.command}"
        lines.append(f"{head}\t{numbers}\t{place}\t1")
    with atomic_write(path) as tmp:
        tmp.write_text("\n".join(lines) + "\n", encoding="ascii")
