"""What a live flight would send, in words."""

from __future__ import annotations

__all__ = ["dry_run"]

from skygain.missions.orders import orders_for
from skygain.missions.qgroundcontrol import RETURN, SPEED, TAKEOFF, items
from skygain.missions.site import Site
from skygain.missions.sortie import Sortie


def dry_run(site: Site, sortie: Sortie, links: tuple[str, ...]) -> str:
    """The items for each vehicle, a line each; nothing is sent."""
    lines = []
    for k, flight in enumerate(sortie.flights):
        orders = orders_for(site, sortie, flight)
        where = f" over {links[k]}" if k < len(links) else ""
        found = items(orders)
        lines.append(
            f"UAV {flight.uav}{where}: {len(found)} items, start at {flight.delay_s:.0f} s"
        )
        for number, item in enumerate(found):
            if item.command == SPEED:
                told = f"speed {item.params[1]:g} m/s"
            elif item.command == RETURN:
                told = "return and land"
            else:
                what = "take off to" if item.command == TAKEOFF else "fly to"
                place = f"{item.latitude:.7f}, {item.longitude:.7f}"
                told = f"{what} {place}, {item.height_m:.1f} m"
            lines.append(f"  {number:3d}  {told}")
    lines.append("nothing was sent; without --dry-run this is uploaded, and --arm would take off")
    return "\n".join(lines)
