"""An invented town for missions: three blocks, an area of 160 x 160 m, a no-fly zone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from skygain.missions.requests import MissionNewRequest

pyproj = pytest.importorskip("pyproj")

CRS, WEST_M, SOUTH_M = "EPSG:32632", 500_600.0, 5_538_200.0
TO_DEGREES = pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
BLOCKS = ((40, 40, 70, 70, 60.0), (110, 50, 130, 120, 55.0), (50, 110, 80, 140, 70.0))
"""west, south, east, north from the corner of the town, and height, in metres"""


def degrees(x: float, y: float) -> tuple[float, float]:
    """Longitude and latitude of metres from the corner of the town."""
    lon, lat = TO_DEGREES.transform(WEST_M + x, SOUTH_M + y)
    return float(lon), float(lat)


def box(west: float, south: float, east: float, north: float) -> list[list[float]]:
    """A ring in degrees."""
    corners = ((west, south), (east, south), (east, north), (west, north), (west, south))
    return [list(degrees(*corner)) for corner in corners]


def write_polygons(path: Path, rings: list, properties: list[dict] | None = None) -> Path:
    """Polygons as GeoJSON."""
    features = [
        {
            "type": "Feature",
            "properties": (properties or [{}] * len(rings))[k],
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }
        for k, ring in enumerate(rings)
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def home(x: float, y: float) -> str:
    """A take-off place as the command line takes it."""
    lon, lat = degrees(x, y)
    return f"{lat:.8f},{lon:.8f}"


def mission_request(town: Path, folder: Path | str = "mission", **changes: object):
    """A mission that a battery of 4 minutes flies quickly."""
    asked = {
        "folder": folder,
        "city": str(town / "town.geojson"),
        "area": town / "area.geojson",
        "no_fly": town / "zones.geojson",
        "home": home(90, 85),
        "altitude_m": 30.0,
        "battery_min": 4.0,
        "clearance_m": 6.0,
        "separation_m": 12.0,
        "planner": "sequential-greedy:horizon=16",
        "outlook": 0,
    }
    return MissionNewRequest.of({**asked, **changes})
