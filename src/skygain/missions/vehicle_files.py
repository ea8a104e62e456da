"""The files of a sortie: what each vehicle's ground station reads, and what the crew does."""

from __future__ import annotations

__all__ = ["folder_of", "write_sortie"]

from pathlib import Path

from skygain.missions.brief import write_brief
from skygain.missions.dji import WAYPOINT_LIMIT, write_kmz
from skygain.missions.folder import swapped_in
from skygain.missions.open_formats import write_csv, write_geojson, write_gpx, write_kml
from skygain.missions.orders import Orders, orders_for
from skygain.missions.qgroundcontrol import write_plan, write_waypoints
from skygain.missions.site import Site
from skygain.missions.sortie import Sortie


def folder_of(mission: Path, number: int) -> Path:
    """Where the files of a sortie lie."""
    return mission / "sorties" / f"{number:03d}"


def write_sortie(site: Site, sortie: Sortie, mission: Path) -> Path:
    """Write every file of a sortie, all of them or none; returns their folder."""
    folder = folder_of(mission, sortie.number)
    with swapped_in(folder) as draft:
        for flight in sortie.flights:
            orders = orders_for(site, sortie, flight)
            name = f"uav{flight.uav}"
            write_plan(orders, draft / f"{name}.plan")
            write_waypoints(orders, draft / f"{name}.waypoints")
            write_kml(orders, draft / f"{name}.kml")
            write_gpx(orders, draft / f"{name}.gpx")
            write_geojson(orders, draft / f"{name}.geojson")
            write_csv(orders, draft / f"{name}.csv")
            for part, points in enumerate(_parts(orders), start=1):
                more = f"-{part}" if len(orders.points) > WAYPOINT_LIMIT else ""
                write_kmz(orders, points, draft / f"{name}{more}.kmz")
        write_brief(site, sortie, draft)
    return folder


def _parts(orders: Orders) -> list[slice]:
    """Waypoints of each file of an app that takes so many at once; a part begins where the last
    ended."""
    n, step = len(orders.points), WAYPOINT_LIMIT - 1
    if n <= WAYPOINT_LIMIT:
        return [slice(0, n)]
    return [slice(k, min(n, k + WAYPOINT_LIMIT)) for k in range(0, n - 1, step)]
