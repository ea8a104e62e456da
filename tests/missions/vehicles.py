"""Autopilots on loopback for tests: as much of MAVLink as a mission needs, flown fast."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

os.environ.setdefault("MAVLINK20", "1")


def free_port() -> int:
    """A port of loopback that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Heartbeats:
    """A vehicle that only says which firmware it runs."""

    def __init__(self, autopilot: str) -> None:
        self.autopilot, self.port = autopilot, free_port()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Heartbeats:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _beat(self) -> None:
        from pymavlink import mavutil

        link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{self.port}", source_system=1, source_component=1
        )
        kind = getattr(mavutil.mavlink, f"MAV_AUTOPILOT_{self.autopilot}")
        while not self._over.wait(0.2):
            link.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_QUADROTOR, kind, 0, 0, 4)
        link.close()


_IMPORT = """
import sys, time, json
from mavsdk import Configuration, Mavsdk, ComponentType
from mavsdk.plugins.mission_raw import MissionRaw
sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
sdk.add_any_connection(f"udpin://127.0.0.1:{sys.argv[1]}")
system = sdk.first_autopilot(20.0)
items = MissionRaw(system).import_qgroundcontrol_mission(sys.argv[2]).mission_items
names = "seq frame command x y z".split()
print(json.dumps([{name: getattr(i, name) for name in names} for i in items]))
"""


def imported_by_mavsdk(port: int, plan: Path) -> list[Any]:
    """The mission items that MAVSDK's own importer makes of a plan."""
    done = subprocess.run(
        [sys.executable, "-c", _IMPORT, str(port), str(plan)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return [SimpleNamespace(**one) for one in json.loads(done.stdout)]
