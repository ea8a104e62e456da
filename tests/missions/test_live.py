"""Live flights with autopilots on loopback: what is refused, and what a new way keeps."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from skygain.app.progress import SILENT
from skygain.ground.errors import InputError
from skygain.missions.commands import run_fly
from skygain.missions.folder import Mission, made
from skygain.missions.journal import Reading
from skygain.missions.live import LiveFlight
from skygain.missions.new_ways import LiveSettings
from skygain.missions.requests import MissionFlyRequest
from skygain.missions.vehicle_link import VehicleLink
from tests.missions.town import SOUTH_M, TO_DEGREES, WEST_M, mission_request
from tests.missions.vehicles import SimulatedVehicle, free_port

PACE = 8.0


def level(latitude: float, longitude: float) -> float:
    x, y = TO_DEGREES.transform(longitude, latitude, direction="INVERSE")
    return -40.0 - 0.2 * float(np.hypot(x - WEST_M - 20, y - SOUTH_M - 20))


@pytest.fixture
def folder(town, sortie, tmp_path: Path) -> Path:
    folder = made(
        mission_request(town, tmp_path / "mission", planner="sequential-greedy:horizon=16")
    )
    with Mission.opened(folder) as mission:
        mission.journal.add("planned", {"sortie": sortie.as_data()})
    return folder


@pytest.fixture
def fleet(site, sortie):
    """Three vehicles on their pads; their ports."""
    with contextlib.ExitStack() as stack:
        vehicles = []
        for flight in sortie.flights:
            lat, lon = site.latlon(np.array(flight.pad_m[:2]))
            kind = "ARDUPILOTMEGA" if flight.uav == 1 else "PX4"
            vehicles.append(
                stack.enter_context(
                    SimulatedVehicle(
                        free_port(),
                        (float(lat), float(lon)),
                        level,
                        system=flight.uav + 1,
                        autopilot=kind,
                        pace=PACE,
                    )
                )
            )
        yield vehicles


def ports(fleet) -> list[int]:
    return [v.link.destination_addr[1] for v in fleet]


@contextlib.contextmanager
def linked(fleet, sortie):
    with contextlib.ExitStack() as stack:
        links = [
            stack.enter_context(
                VehicleLink(f.uav, f"udpin:127.0.0.1:{port}", "NAMED_VALUE_FLOAT.rsrp")
            )
            for f, port in zip(sortie.flights, ports(fleet), strict=True)
        ]
        for link in links:
            assert link.wait(10.0)
        yield links


def test_a_refused_item_stops_before_anything_is_armed(folder, site, sortie, fleet) -> None:
    fleet[0].reject = 3
    links = tuple(Path(f"udpin:127.0.0.1:{port}") for port in ports(fleet))
    with pytest.raises(InputError, match="UAV 0 did not take the mission; nothing was armed"):
        run_fly(MissionFlyRequest(folder=folder, link=links, arm=True), SILENT)
    assert not any(vehicle.armed for vehicle in fleet)
    assert fleet[1].items[0].command == 16  # ArduPilot got its home first
    assert fleet[2].items[0].command == 22


def test_nothing_is_armed_without_a_typed_yes(
    folder, fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    links = tuple(Path(f"udpin:127.0.0.1:{port}") for port in ports(fleet))
    monkeypatch.setattr("builtins.input", lambda question: "y")
    told = run_fly(MissionFlyRequest(folder=folder, link=links, arm=True), SILENT)
    assert told == "uploaded; nothing was armed"
    assert not any(vehicle.armed for vehicle in fleet)
    assert all(vehicle.uploads == 1 for vehicle in fleet)


def test_a_dry_run_sends_nothing(folder, fleet, sortie) -> None:
    told = run_fly(MissionFlyRequest(folder=folder, dry_run=True), SILENT)
    assert told.count("return and land") == 3
    assert told.count("fly to") == sum(len(f.route_m) - 1 for f in sortie.flights)
    assert not any(vehicle.uploads for vehicle in fleet)


def test_readings_posted_on_the_ground_do_not_end_the_sortie(folder, fleet) -> None:
    with Mission.opened(folder) as mission:
        one = Reading(49.9977, 9.0101, -80.0, None, False, time.time(), 1, 0, "posted, UAV 0")
        mission.journal.take_in("ingested", {"file": "posted", "quantity": "power"}, [one])
    links = tuple(Path(f"udpin:127.0.0.1:{port}") for port in ports(fleet))
    assert "items" in run_fly(MissionFlyRequest(folder=folder, dry_run=True), SILENT)
    with Mission.opened(folder) as mission:
        mission.journal.add("led", {"sortie": 1, "zero_at": time.time(), "pace": 1.0})
    # a leader that died before anybody was in the air: the same command begins again
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("builtins.input", lambda question: "no")
        told = run_fly(MissionFlyRequest(folder=folder, link=links, arm=True), SILENT)
    assert told == "uploaded; nothing was armed"
    with Mission.opened(folder) as mission:
        mission.journal.add("airborne", {"sortie": 1, "uav": 0, "began_s": 0.0, "up_s": 0.0})
    told = run_fly(MissionFlyRequest(folder=folder, link=links, arm=True), SILENT)
    assert "has been flown" in told
    with Mission.opened(folder) as mission:
        assert mission.journal.events()[-1]["kind"] == "flown"
    with pytest.raises(InputError, match="waits to be flown"):
        run_fly(MissionFlyRequest(folder=folder, dry_run=True), SILENT)


def test_links_are_counted_and_places_checked(folder, site, sortie, fleet) -> None:
    one = tuple(Path(f"udpin:127.0.0.1:{port}") for port in ports(fleet))
    with pytest.raises(InputError, match="2 links for the 3 UAVs"):
        run_fly(MissionFlyRequest(folder=folder, link=one[:2]), SILENT)
    with pytest.raises(InputError, match="addresses are missing"):
        run_fly(MissionFlyRequest(folder=folder), SILENT)
    with pytest.raises(InputError, match="is no address"):
        run_fly(MissionFlyRequest(folder=folder, link=(*one[:2], Path("somewhere"))), SILENT)
    fleet[0].xyz = [80.0, 0.0, 0.0]
    time.sleep(0.3)
    with pytest.raises(InputError, match=r"UAV 0 .* stands 80 m from its take-off place"):
        run_fly(MissionFlyRequest(folder=folder, link=one), SILENT)
    silent = (*one[:2], Path(f"udpin:127.0.0.1:{free_port()}"))
    fleet[0].xyz = [0.0, 0.0, 0.0]
    time.sleep(0.3)
    with pytest.raises(InputError, match="UAV 2 is not heard"):
        run_fly(MissionFlyRequest(folder=folder, link=silent, wait_s=0.5), SILENT)


def test_a_new_way_comes_home_in_the_time_that_is_left(folder, site, sortie, fleet) -> None:
    with Mission.opened(folder) as mission, linked(fleet, sortie) as links:
        mission.__dict__["site"] = site
        flight = LiveFlight(mission, sortie, links, LiveSettings(pace=1.0))
        rider = flight.riders[0]
        for k in (5, 20, 40):
            rider.done = k
            xy = site.grid.xy_m(sortie.flights[0].cells[k])
            lon, lat = TO_DEGREES.transform(*xy, direction="FORWARD")
            rider.link.heard.latitude, rider.link.heard.longitude = lat, lon
            for used_s in (60.0, 120.0, 170.0):
                rider.up_s = flight.now() - used_s
                new = flight.planned(rider)
                if new is not None:
                    assert new.air_s <= site.request.usable_s - used_s + 0.5
                    assert site.space.clear(new.route_m[:, :2])
                    assert replace(new).airborne
