"""Links to vehicles: every address, slow and deaf ones, and what MAVSDK makes of our missions."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from skygain.ground.errors import InputError
from skygain.missions.orders import orders_for
from skygain.missions.qgroundcontrol import Item, items
from skygain.missions.vehicle_files import write_sortie
from skygain.missions.vehicle_link import VehicleLink, connection_text, same_mission
from tests.missions.vehicles import Heartbeats, SimulatedVehicle, free_port, imported_by_mavsdk

LEVEL = "NAMED_VALUE_FLOAT.rsrp"
HOME = (49.9977, 9.0101)


@pytest.fixture(scope="module")
def mission(site, sortie) -> list[Item]:
    return items(orders_for(site, sortie, sortie.flights[0]))


def vehicle(link: str, **changes: object) -> SimulatedVehicle:
    return SimulatedVehicle(0, HOME, lambda lat, lon: -80.0, link=link, **changes)  # type: ignore[arg-type]


@contextlib.contextmanager
def serial_line() -> Iterator[tuple[str, str]]:
    """The device of one end, and the link of the other: a pseudo-terminal beside a UDP socket."""
    main, side = os.openpty()
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(("127.0.0.1", port))
        over = threading.Event()
        sender: list[tuple[str, int]] = []

        def in_() -> None:
            while not over.is_set():
                with contextlib.suppress(OSError):
                    data, address = udp.recvfrom(4096)
                    sender[:] = [address]
                    os.write(main, data)

        def out() -> None:
            while not over.is_set():
                with contextlib.suppress(OSError):
                    data = os.read(main, 4096)
                    if sender:
                        udp.sendto(data, sender[0])

        udp.settimeout(0.1)
        for run in (in_, out):
            threading.Thread(target=run, daemon=True).start()
        yield os.ttyname(side), f"udpout:127.0.0.1:{port}"
        over.set()


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcpin", "tcpout", "serial"])
def test_a_mission_goes_up_and_comes_back_over_every_address(mission, kind: str) -> None:
    with contextlib.ExitStack() as stack:
        port = free_port()
        there = f"127.0.0.1:{port}"
        if kind == "serial":
            if not hasattr(os, "openpty"):
                pytest.skip("this system has no pseudo-terminals")
            device, other = stack.enter_context(serial_line())
            ours = f"{device},57600"
        else:
            ours = f"{kind}://{there}"
            other = {"udpin": "udpout", "udpout": "udpin", "tcpin": "tcp", "tcpout": "tcpin"}[kind]
            other = f"{other}:{there}"
        if kind == "tcpout":  # who listens is there first
            stack.enter_context(vehicle(other))
        link = stack.enter_context(VehicleLink(0, ours, LEVEL))
        if kind != "tcpout":
            stack.enter_context(vehicle(other))
        assert link.wait(10.0)
        assert link.upload(mission, HOME) is True
        aboard = link.download()
        assert aboard is not None
        assert same_mission(aboard, mission)


def test_a_slow_vehicle_gets_its_mission_once() -> None:
    """Items come and go with a delay of 2 s: sending the count again would begin anew each time."""
    port = free_port()
    some = [Item(16, 3, (0.0, 0.0, 0.0, 0.0), 49.9977 + 1e-4 * k, 9.0101, 30.0) for k in range(2)]
    with (
        VehicleLink(0, f"udpin:127.0.0.1:{port}", LEVEL) as link,
        vehicle(f"udpout:127.0.0.1:{port}", delay_s=1.0) as slow,
    ):
        assert link.wait(10.0)
        assert link.upload(some, HOME) is True
        assert slow.uploads == 1


def test_a_vehicle_whose_answer_is_lost_may_have_either_mission(mission) -> None:
    port = free_port()
    with (
        VehicleLink(0, f"udpin:127.0.0.1:{port}", LEVEL) as link,
        vehicle(f"udpout:127.0.0.1:{port}", acknowledges=False) as quiet,
    ):
        assert link.wait(10.0)
        assert link.upload(mission, HOME, most_s=3.0) is None
        assert quiet.uploads >= 1
        aboard = link.download()
        assert aboard is not None
        assert same_mission(aboard, mission)


@pytest.mark.parametrize(
    ("link", "message"),
    [
        ("somewhere", "is no address; write udpin:HOST:PORT"),
        ("udpin:127.0.0.1", "is no address"),
        ("udpin://256.0.0.1:14550", "cannot open `link`"),
        ("tcp:127.0.0.1:1", "cannot open `link`"),
        ("/dev/nothing,57600", "cannot open `link`"),
    ],
)
def test_an_address_that_cannot_be_opened_is_told_in_one_line(link: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        VehicleLink(0, link, LEVEL)
    assert "\n" not in str(caught.value)


def test_addresses_of_mavsdk_are_understood() -> None:
    for link, text in (
        ("udpin://0.0.0.0:14550", "udpin:0.0.0.0:14550"),
        ("udpout://10.0.0.2:14550", "udpout:10.0.0.2:14550"),
        ("tcpin://0.0.0.0:5760", "tcpin:0.0.0.0:5760"),
        ("tcpout://127.0.0.1:5760", "tcp:127.0.0.1:5760"),
    ):
        assert connection_text(link) == (text, 0)
    assert connection_text("serial:///dev/ttyACM0:115200") == ("/dev/ttyACM0", 115200)


_SERVER = """
import json, sys, threading
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mission_raw_server import MissionRawServer
sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
sdk.add_any_connection(f"udpout://127.0.0.1:{sys.argv[1]}")
server, came = MissionRawServer(sdk.server_component()), threading.Event()
names = "frame command param1 param2 param3 param4 x y z".split()
def show(result, plan, _):
    rows = [{name: getattr(i, name) for name in names} for i in plan.mission_items]
    print("\\n" + json.dumps(rows), flush=True)
    came.set()
server.subscribe_incoming_mission(show)
came.wait(60)
sys.stdin.read()
"""


def test_mavsdk_receives_what_the_link_sends(mission) -> None:
    """Its server takes the place of an autopilot."""
    pytest.importorskip("mavsdk")
    port = free_port()
    server = subprocess.Popen(
        [sys.executable, "-c", _SERVER, str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    with VehicleLink(0, f"udpin:127.0.0.1:{port}", LEVEL) as link:
        until = time.monotonic() + 60
        while link.heard.beat_s < 0 and time.monotonic() < until:
            time.sleep(0.05)
        assert link.upload(mission, HOME) is True
        line = next(line for line in server.stdout if line.startswith("[{"))
        aboard = link.download()
    server.communicate(timeout=30)
    assert aboard is not None
    assert same_mission(aboard, mission)
    got = json.loads(line)
    assert [(g["command"], g["frame"]) for g in got] == [(i.command, i.frame) for i in mission]
    for g, item in zip(got, mission, strict=True):
        params = [g[f"param{k}"] for k in (1, 2, 3, 4)]
        assert params == pytest.approx(item.params)
        assert (g["x"], g["y"]) == (round(item.latitude * 1e7), round(item.longitude * 1e7))
        assert g["z"] == pytest.approx(item.height_m, abs=1e-4)


def test_a_plan_file_and_a_live_upload_are_the_same_mission(
    site, sortie, mission, tmp_path: Path
) -> None:
    """What MAVSDK's importer makes of the file is what the link sends."""
    pytest.importorskip("mavsdk")
    folder = write_sortie(site, sortie, tmp_path)
    with Heartbeats("PX4") as beats:
        found = imported_by_mavsdk(beats.port, folder / "uav0.plan")
    imported = [Item(i.command, i.frame, (), i.x / 1e7, i.y / 1e7, i.z) for i in found]  # type: ignore[arg-type]
    assert same_mission(imported, mission)
    assert np.isfinite([i.z for i in found]).all()
