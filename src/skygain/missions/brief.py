"""One page for the crew: the map, the numbers, and what can go wrong."""

from __future__ import annotations

__all__ = ["risks", "write_brief"]

import base64
import html
import io
from pathlib import Path

from skygain.ground.errors import require
from skygain.ground.files import atomic_write
from skygain.missions.orders import orders_for
from skygain.missions.pictures import sortie_figure
from skygain.missions.site import Site
from skygain.missions.sortie import Sortie
from skygain.missions.timing import ROUNDING_M, SLIP_S, nearest

_STYLE = """
:root { color-scheme: light; --ink: #1f2933; --soft: #5b6672; --line: #d8dee4; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 20px; max-width: 900px; color: var(--ink); background: #fff;
  font: 14px/1.45 system-ui, sans-serif; }
h1 { font-size: 22px; margin: 0 0 2px; } h2 { font-size: 15px; margin: 16px 0 4px; }
p { margin: 0 0 8px; color: var(--soft); }
img { width: 100%; max-width: 640px; display: block; margin: 8px auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 4px 8px; border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; } th:first-child, td:first-child { text-align: left; }
ul { margin: 0; padding-left: 18px; } li { margin: 2px 0; }
.scroll { overflow-x: auto; }
@page { size: A4; margin: 12mm; }
@media print { body { padding: 0; font-size: 11px; } img { max-width: 118mm; }
  h2 { margin-top: 8px; }
  h1 { font-size: 18px; } th, td { padding: 2px 6px; } }
"""


def write_brief(site: Site, sortie: Sortie, folder: Path) -> None:
    """Write ``brief.html``, complete in one file, and its map as ``brief.png``."""
    picture = io.BytesIO()
    sortie_figure(site, sortie).savefig(picture, format="png", dpi=150)
    with atomic_write(folder / "brief.png") as tmp:
        tmp.write_bytes(picture.getvalue())
    with atomic_write(folder / "brief.html") as tmp:
        tmp.write_text(_page(site, sortie, picture.getvalue()), encoding="utf-8")


def _page(site: Site, sortie: Sortie, picture: bytes) -> str:
    request = site.request
    name = html.escape(site.reading.city.name)
    uavs = "1 UAV" if len(sortie.flights) == 1 else f"{len(sortie.flights)} UAVs"
    lead = (
        f"{uavs} at {site.altitude_text}, {request.speed_mps:g} m/s, "
        f"{sortie.duration_s / 60:.1f} min from the first take-off to the last landing. "
        f"{len(sortie.cells)} cells are measured; the map's expected error should fall "
        f"from {sortie.error_before_db:.1f} to {sortie.error_after_db:.1f} dB."
    )
    rows = "\n".join(_row(site, sortie, k) for k in range(len(sortie.flights)))
    items = "\n".join(f"<li>{html.escape(line)}</li>" for line in risks(site, sortie))
    steps = "\n".join(f"<li>{html.escape(line)}</li>" for line in _steps(sortie))
    image = base64.b64encode(picture).decode("ascii")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{name}, sortie {sortie.number}</title>
<style>{_STYLE}</style>
</head>
<body>
<h1>{name}, sortie {sortie.number}</h1>
<p>{html.escape(lead)}</p>
<img src="data:image/png;base64,{image}" alt="map of the sortie">
<h2>Vehicles</h2>
<div class="scroll"><table>
<thead><tr><th>UAV</th><th>take-off place</th><th>at</th><th>in the air</th><th>way</th>
<th>waypoints</th><th>highest</th><th>return height</th></tr></thead>
<tbody>
{rows}
</tbody></table></div>
<h2>Order of work</h2>
<ul>
{steps}
</ul>
<h2>What can go wrong</h2>
<ul>
{items}
</ul>
</body>
</html>
"""


def _row(site: Site, sortie: Sortie, index: int) -> str:
    flight = sortie.flights[index]
    orders = orders_for(site, sortie, flight)
    lat, lon = orders.home
    cells = (
        f"UAV {flight.uav}",
        f"{lat:.6f}, {lon:.6f}",
        f"{int(flight.delay_s) // 60}:{int(flight.delay_s) % 60:02d}",
        f"{flight.air_s / 60:.1f} min",
        f"{flight.length_m:.0f} m",
        str(len(orders.points)),
        f"{max(p.height_m for p in orders.points):.0f} m",
        f"{orders.return_height_m:.0f} m",
    )
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"


def _steps(sortie: Sortie) -> list[str]:
    delayed = [f for f in sortie.flights if f.delay_s]
    start = "All take off together."
    if delayed:
        start = "; ".join(
            [
                f"UAV {f.uav} takes off {f.delay_s:.0f} s after the first"
                for f in sortie.flights
                if f.delay_s
            ]
        )
        start = start[0].upper() + start[1:] + "."
    return [
        "Put every UAV on its take-off place and load its file (uavN.plan, .waypoints or .kmz).",
        "Set each vehicle's return height (RTL_RETURN_ALT, RTL_ALT) to the one in the table, and "
        "the fence to what the file holds. Waypoints are rounded within "
        f"{ROUNDING_M:g} m: ArduPilot takes that from WPNAV_RADIUS, the others from their file.",
        start,
        "After landing: skygain mission ingest with the logs, then skygain mission plan.",
    ]


def risks(site: Site, sortie: Sortie) -> list[str]:
    """What the plan keeps, by how much, and what it does not know."""
    shapely, request = require("shapely", "geo"), site.request
    lines = []
    solid = [*site.solid, *site.zones]
    near = min(
        (
            float(shapely.distance(shapely.LineString(f.route_m[:, :2]), one))
            for f in sortie.flights
            for one in solid
        ),
        default=None,
    )
    if near is not None:
        lines.append(
            f"The nearest building, ground or no-fly zone is {near:.1f} m from a leg "
            f"({request.clearance_m:g} m asked for). Trees, cranes, masts and wires are not in the "
            "map: look for them."
        )
    late_s = max(float(f.timeline.slip_s[-1]) for f in sortie.flights)
    pairs = [
        (nearest(a.timeline, b.timeline, request.speed_mps), a.uav, b.uav)
        for i, a in enumerate(sortie.flights)
        for b in sortie.flights[:i]
    ]
    if pairs:
        gap, one, other = min(pairs)
        if gap < 1e6:
            lines.append(
                f"UAVs {other} and {one} come nearest: not below {gap:.0f} m as long as none is "
                f"more than {SLIP_S:g} s early or late, and some more for each corner it has "
                f"passed, {late_s:.0f} s at the end ({request.separation_m:g} m asked for). A UAV "
                "that waits longer breaks this: bring the others home."
            )
        else:
            lines.append("No two UAVs come near each other while they are in the air.")
    most = max(f.air_s for f in sortie.flights)
    lines.append(
        f"The longest flight takes {most / 60:.1f} of {request.battery_min:g} min of battery, in "
        "still air. Wind and cold cost more: watch the voltage, not the plan."
    )
    below = site.highest_m - min(float(f.route_m[:, 2].min()) for f in sortie.flights)
    if below > 0:
        lines.append(
            f"The map rises {below:.0f} m above the flight. A vehicle that returns by itself has "
            "to climb first: check the return height on the vehicle."
        )
    lines.append(
        "Heights are above the take-off place: arm the vehicle where it stands on the map."
    )
    return [*lines, *sortie.notes]
