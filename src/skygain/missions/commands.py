"""The commands of a mission; each takes its request and returns what to tell the user."""

from __future__ import annotations

__all__ = ["run_fly", "run_ingest", "run_new", "run_plan", "run_serve", "run_status"]

from itertools import takewhile
from typing import TYPE_CHECKING, Protocol

from skygain.ground.declared import part
from skygain.ground.errors import InputError, require
from skygain.missions.requests import (
    MissionFlyRequest,
    MissionIngestRequest,
    MissionNewRequest,
    MissionPlanRequest,
    MissionServeRequest,
    MissionStatusRequest,
)
from skygain.survey.requests import RecordingRequest

_AT_HOME_M = 30.0
"""a vehicle farther from its take-off place stands somewhere else"""

if TYPE_CHECKING:
    from skygain.missions.folder import Mission
    from skygain.missions.sortie import Flight, Sortie
    from skygain.missions.vehicle_link import VehicleLink


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
            told = _outlook_lines(ahead.error_db, ahead.enough, request.stop_std_db)
            first = ahead.sorties[0] if ahead.sorties else None
            if first is not None:
                told += _sortie_lines(first)[1:]
        progress.phase("drawing")
        site_picture(site, folder / "site.png", ahead)
        mission.journal.add("outlook", {"error_db": list(ahead.error_db) if ahead else []})
    return "\n".join(
        [*site_lines(site), *told, f"picture: {folder / 'site.png'}",
         f"next: skygain mission plan {folder}"]
    )  # fmt: skip


def _outlook_lines(error_db: tuple[float, ...], enough: bool, stop_db: float | None) -> list[str]:
    shown = " → ".join(f"{v:.1f}" for v in error_db)
    lines = [f"expected error over the sorties: {shown} dB"]
    n = len(error_db) - 1
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
        f"expected error {sortie.error_before_db:.1f} → {sortie.error_after_db:.1f} dB"
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


def run_ingest(request: MissionIngestRequest, progress: Progress) -> str:
    """Take readings in; returns what came of each log, and what was not flown."""
    from skygain.missions.folder import Mission
    from skygain.missions.ingest import take_in
    from skygain.missions.next_sortie import left_over

    with Mission.opened(request.folder) as mission, mission.writing("skygain mission ingest"):
        progress.phase("reading the map")
        site = mission.site
        progress.phase("reading the logs")
        intake = take_in(mission, request.files, part(request, RecordingRequest),
                         request.shift_hours)  # fmt: skip
        lines = []
        for log in intake.logs:
            lines += [str(log), *(f"  note: {note}" for note in log.notes)]
        missed = sum(len(run.cells) for run in left_over(mission, site))
    if not intake.new:
        lines.append("nothing new: these readings are in the mission already")
    elif missed:
        lines.append(f"{missed} planned cells were not flown; the next plan flies them first")
    return "\n".join([*lines, f"next: skygain mission status {request.folder}"])


def run_status(request: MissionStatusRequest, progress: Progress) -> str:
    """Write the map; returns how good it is and what to do next."""
    from skygain.missions.advice import advice
    from skygain.missions.folder import Mission
    from skygain.missions.map_files import write_map
    from skygain.missions.state import known_belief

    with Mission.opened(request.folder) as mission, mission.writing("skygain mission status"):
        progress.phase("reading the map")
        site = mission.site
        belief = known_belief(mission)
        readings = mission.journal.readings()
        progress.phase("planning ahead")
        found = advice(mission, belief, request.least_gain_db)
        notes: list[str] = []
        lines = [
            f"sorties planned: {len(mission.sorties())}; {len(readings)} readings in "
            f"{int(belief.measurements.visited(site.grid.shape).sum())} cells",
            str(found),
        ]
        if readings:
            progress.phase("writing the map")
            folder, notes = write_map(mission, belief)
            lines += [*notes, f"map: {folder / 'report.html'}"]
        mission.journal.add(
            "advised",
            {"error_db": found.error_db, "next_db": found.next_db, "stop": found.stop},
        )
    return "\n".join(lines)


def run_serve(request: MissionServeRequest, progress: Progress) -> str:
    """Serve the live page until it is interrupted."""
    require("starlette", "serve")
    require("uvicorn", "serve")
    import socket

    import uvicorn

    from skygain.missions.folder import Mission
    from skygain.missions.serve import application, is_loopback, kept_token

    progress.phase("reading the mission")
    with Mission.opened(request.folder):
        token = kept_token(request.folder)
    served = application(request.folder, request.host, token)
    family = socket.AF_INET6 if ":" in request.host else socket.AF_INET
    try:
        listener = socket.create_server((request.host, request.port), family=family)
    except OSError as error:
        raise InputError(
            f"cannot listen on {request.host} port {request.port}: {error.strerror or error}; give "
            "another `port` or `host`"
        ) from error
    port = listener.getsockname()[1]
    shown = f"[{request.host}]" if ":" in request.host else request.host
    progress.note(f"page: http://{shown}:{port}/#token={token}")
    if not is_loopback(request.host):
        progress.note(
            "others who have this address can read and write the mission; it is not encrypted"
        )
    progress.phase("")
    config = uvicorn.Config(served, log_level="warning", timeout_graceful_shutdown=1)
    with listener:
        uvicorn.Server(config).run(sockets=[listener])
    return ""


def run_fly(request: MissionFlyRequest, progress: Progress) -> str:
    """Fly the open sortie live, or show what would be sent."""
    from skygain.missions.dry_run import dry_run
    from skygain.missions.folder import Mission
    from skygain.missions.next_sortie import open_sortie
    from skygain.missions.state import quantity_of

    links = tuple(str(one) for one in request.link)
    with Mission.opened(request.folder) as mission:
        progress.phase("reading the map")
        site = mission.site
        led = led_sortie(mission)
        sortie = led or open_sortie(mission) or _posted_only(mission)
        if sortie is None:
            raise InputError(
                f"no sortie of {request.folder} waits to be flown; plan one with: skygain mission "
                "plan"
            )
        if links and len(links) != len(sortie.flights):
            raise InputError(
                f"{len(links)} links for the {len(sortie.flights)} UAVs of sortie {sortie.number}; "
                "give one `link` for each"
            )
        if quantity_of(mission.journal) == "gain":
            raise InputError(
                "the mission's readings so far are gains in dB, and a live flight brings levels in "
                "dBm; begin another mission for it"
            )
        if request.dry_run:
            return dry_run(site, sortie, links)
        if not links:
            raise InputError(
                "the vehicles' addresses are missing; give one `link` for each UAV, or "
                "`dry_run=True`"
            )
        with mission.writing("skygain mission fly"):
            return _flown_live(mission, sortie, links, request, progress, led is not None)


def led_sortie(mission: Mission) -> Sortie | None:
    """The newest sortie, if a live flight of it began and did not end."""
    last = mission.journal.events("planned", "led", "flown")
    if not last or last[-1]["kind"] != "led":
        return None
    return mission.sorties()[-1]


def _posted_only(mission: Mission) -> Sortie | None:
    """The newest sortie, if all that was read since it was planned was posted: a companion computer
    posts before the take-off too."""
    from skygain.missions.journal import POSTED

    events = mission.journal.events("planned", "ingested", "led")
    since = list(takewhile(lambda event: event["kind"] != "planned", reversed(events)))
    if len(since) == len(events) or any(event.get("file") != POSTED for event in since):
        return None
    return mission.sorties()[-1]


def _flown_live(
    mission: Mission,
    sortie: Sortie,
    links: tuple[str, ...],
    request: MissionFlyRequest,
    progress: Progress,
    led: bool,
) -> str:
    import contextlib

    from skygain.missions.live import LiveFlight
    from skygain.missions.new_ways import LiveSettings
    from skygain.missions.vehicle_link import VehicleLink

    with contextlib.ExitStack() as stack:
        vehicles = [
            stack.enter_context(VehicleLink(flight.uav, link, request.level))
            for flight, link in zip(sortie.flights, links, strict=True)
        ]
        progress.phase("waiting for the vehicles")
        silent = [
            v for v in vehicles if not v.wait(min(request.wait_s, 5.0) if led else request.wait_s)
        ]
        flight_of_all = LiveFlight(
            mission, sortie, vehicles, LiveSettings(pace=request.pace), progress.note
        )
        resumed = led and any(vehicle.heard.armed for vehicle in vehicles)
        if resumed:
            progress.note("taking over vehicles in the air")
            flight_of_all.resume()
        else:
            for vehicle, flight in zip(vehicles, sortie.flights, strict=True):
                _check_place(mission, vehicle, flight, vehicle in silent)
            if led and mission.journal.events("planned", "airborne")[-1]["kind"] == "airborne":
                mission.journal.add("flown", {"sortie": sortie.number, "states": {}})
                return f"sortie {sortie.number} has been flown, and every vehicle is on the ground"
        progress.phase("uploading")
        refused = flight_of_all.upload()
        if refused and not resumed:
            shown = ", ".join(f"UAV {uav}" for uav in refused)
            raise InputError(f"{shown} did not take the mission; nothing was armed")
        armed = False
        if request.arm:
            waiting = sum(not vehicle.heard.armed for vehicle in vehicles)
            question = f"type yes to arm {waiting} vehicles and take off: "
            armed = input(question).strip().lower() == "yes"
            if not armed and not resumed:
                return "uploaded; nothing was armed"
        progress.phase("flying")
        try:
            flight_of_all.lead(arm=armed)
        except KeyboardInterrupt:
            progress.note(
                "the vehicles fly on with what they have on board; the same command takes them over"
            )
            raise
        states = ", ".join(f"UAV {r.uav} {r.state}" for r in flight_of_all.riders)
    return f"sortie {sortie.number}: {states}\nnext: skygain mission status {request.folder}"


def _check_place(mission: Mission, vehicle: VehicleLink, flight: Flight, silent: bool) -> None:
    """A vehicle is there, and stands where it takes off.

    Raises:
        InputError: it is not heard, or stands elsewhere.
    """
    import math

    if silent:
        raise InputError(
            f"UAV {flight.uav} is not heard on {vehicle.link} with a position; check its `link`, "
            "or give a larger `wait_s`"
        )
    heard = vehicle.heard
    place = mission.site.grid.xy_m_at_latlon((heard.latitude, heard.longitude))
    away = math.dist(place, flight.pad_m[:2])
    if away > _AT_HOME_M:
        raise InputError(
            f"UAV {flight.uav} on {vehicle.link} stands {away:.0f} m from its take-off place; put "
            "it there, or exchange the order of `link`"
        )
