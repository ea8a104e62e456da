"""The commands of a mission; each takes its request and returns what to tell the user."""

from __future__ import annotations

__all__ = ["run_new", "run_plan"]

from typing import TYPE_CHECKING, Protocol

from skygain.missions.requests import MissionNewRequest, MissionPlanRequest

if TYPE_CHECKING:
    from skygain.missions.sortie import Sortie


class Progress(Protocol):
    """What a command tells of itself while it works."""

    def phase(self, name: str) -> None: ...
    def __call__(self, done: int, total: int, text: str = "") -> None: ...
    def note(self, line: str) -> None: ...


def run_new(request: MissionNewRequest, progress: Progress) -> str:
    """Check the mission, draw it, make its folder; returns the place in numbers."""
    from skygain.missions.folder import Mission, held, made
    from skygain.missions.outlook import outlook, site_lines
    from skygain.missions.pictures import site_picture
    from skygain.missions.planning import check_battery
    from skygain.missions.site import open_site
    from skygain.missions.state import known_belief

    progress.phase("reading the map")
    site = open_site(request)
    check_battery(site, range(request.uavs))
    folder = made(request)
    with held(folder, "skygain mission new"), Mission.opened(folder) as mission:
        mission.__dict__["site"] = site
        ahead = None
        told: list[str] = []
        belief = known_belief(mission)
        if request.outlook:
            progress.phase("simulating sorties")
            ahead = outlook(
                site,
                belief,
                mission.method.build_planner(),
                request.outlook,
                stop_std_db=request.stop_std_db,
                seed=request.seed,
                told=progress,
            )
            told = _outlook_lines(ahead.std_db, ahead.enough, request.stop_std_db)
            first = ahead.sorties[0] if ahead.sorties else None
            if first is not None:
                told += _sortie_lines(first)[1:]
        progress.phase("drawing")
        site_picture(site, folder / "site.png", ahead)
        mission.journal.add("outlook", {"std_db": list(ahead.std_db) if ahead else []})
    return "\n".join(
        [*site_lines(site), *told, f"picture: {folder / 'site.png'}",
         f"next: skygain mission plan {folder}"]
    )  # fmt: skip


def _outlook_lines(std_db: tuple[float, ...], enough: bool, stop_db: float | None) -> list[str]:
    shown = " → ".join(f"{v:.1f}" for v in std_db)
    lines = [f"mean predicted standard deviation over the sorties: {shown} dB"]
    n = len(std_db) - 1
    if stop_db is not None:
        lines.append(
            f"{n} {'sortie brings' if n == 1 else 'sorties bring'} it below {stop_db:g} dB"
            if enough
            else f"{n} sorties do not bring it below {stop_db:g} dB"
        )
    return lines


def _sortie_lines(sortie: Sortie) -> list[str]:
    lines = [
        f"sortie {sortie.number}: {len(sortie.cells)} cells in {sortie.duration_s / 60:.1f} min, "
        f"mean standard deviation {sortie.std_before_db:.1f} → {sortie.std_after_db:.1f} dB"
    ]
    for flight in sortie.flights:
        start = f", takes off after {flight.delay_s:.0f} s" if flight.delay_s else ""
        lines.append(
            f"  UAV {flight.uav}: {len(flight.cells)} cells, {len(flight.route_m)} waypoints, "
            f"{flight.length_m:.0f} m, {flight.air_s / 60:.1f} min in the air{start}"
        )
    if sortie.refly_cells:
        lines.append(f"  {sortie.refly_cells} cells of earlier sorties are flown again")
    return [*lines, *(f"  {note}" for note in sortie.notes)]


def run_plan(request: MissionPlanRequest, progress: Progress) -> str:
    """Plan the next sortie and write its files."""
    from skygain.missions.folder import Mission
    from skygain.missions.next_sortie import next_sortie
    from skygain.missions.vehicle_files import write_sortie

    with Mission.opened(request.folder) as mission, mission.writing("skygain mission plan"):
        progress.phase("reading the map")
        site = mission.site
        progress.phase("planning")
        sortie, again = next_sortie(
            mission, without=request.without, ahead=request.ahead, told=progress
        )
        progress.phase("writing")
        where = write_sortie(site, sortie, request.folder)
    told = _sortie_lines(sortie)
    if again:
        told.append("nothing was read since it was planned, so it is the same sortie again")
    return "\n".join([*told, f"files: {where}", f"for the crew: {where / 'brief.html'}"])
