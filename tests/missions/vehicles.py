"""Autopilots on loopback for tests: as much of MAVLink as a mission needs, flown fast."""

from __future__ import annotations

import json
import math
import os
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

os.environ.setdefault("MAVLINK20", "1")

ACCELERATION = 2.5
"""m/s² of a simulated vehicle"""


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


class SimulatedVehicle:
    """An autopilot that speaks the mission protocol and flies what it was sent.

    Args:
        port: of the ground station on loopback.
        home: latitude and longitude where it stands.
        level: what its receiver hears at a latitude and longitude.
        autopilot: ``"PX4"`` or ``"ARDUPILOTMEGA"``.
        pace: its seconds in one second.
        reject: number of an item that it refuses.
        link: its end of the connection, where it is not UDP to ``port``.
        delay_s: what it hears, it hears so late.
        acknowledges: whether it says that a mission has come.
    """

    def __init__(
        self,
        port: int,
        home: tuple[float, float],
        level: Callable[[float, float], float],
        *,
        system: int = 1,
        autopilot: str = "PX4",
        pace: float = 20.0,
        reject: int | None = None,
        link: str | None = None,
        delay_s: float = 0.0,
        acknowledges: bool = True,
    ) -> None:
        from pymavlink import mavutil

        self.mav = mavutil.mavlink
        self.link = mavutil.mavlink_connection(
            link or f"udpout:127.0.0.1:{port}", source_system=system, source_component=1
        )
        self.delay_s, self.acknowledges = delay_s, acknowledges
        self._late: deque[tuple[float, Any]] = deque()
        self.level, self.pace, self.reject = level, pace, reject
        self.px4 = autopilot == "PX4"
        self.autopilot = getattr(self.mav, f"MAV_AUTOPILOT_{autopilot}")
        self.home = home
        self.east_m = 111_319.5 * math.cos(math.radians(home[0]))
        self.xyz = [0.0, 0.0, 0.0]
        self.items: list[Any] = []
        self.coming: list[Any] = []
        self.wanted = 0
        self.current = 0
        self.armed, self.mode, self.speed, self.battery = False, 0, 5.0, 1.0
        self.silent_until = self.hold = self.pace_mps = self.through_mps = 0.0
        self.trace: list[tuple[float, float, float, float]] = []
        """(wall time, latitude, longitude, height) at every step"""
        self.uploads = 0
        self.sent_s: list[float] = []
        """moments at which it sent a reading"""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> SimulatedVehicle:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self.link.close()

    def kill(self) -> None:
        """End at once, as a vehicle that falls."""
        self._over.set()
        self._thread.join(timeout=2.0)

    def cut(self, seconds: float) -> None:
        """Say and hear nothing for so long; it flies on."""
        self.silent_until = time.monotonic() + seconds

    @property
    def place(self) -> tuple[float, float]:
        """Latitude and longitude."""
        return (
            self.home[0] + self.xyz[1] / 111_319.5,
            self.home[1] + self.xyz[0] / self.east_m,
        )

    def _run(self) -> None:
        last = time.monotonic()
        said = {"beat": 0.0, "place": 0.0, "level": 0.0}
        while not self._over.wait(0.01):
            now = time.monotonic()
            step, last = (now - last) * self.pace, now
            self._fly(step)
            lat, lon = self.place
            self.trace.append((now, lat, lon, self.xyz[2]))
            cut = now < self.silent_until
            while (message := self.link.recv_match(blocking=False)) is not None:
                if not cut:
                    self._late.append((now + self.delay_s, message))
            while self._late and self._late[0][0] <= now:
                self._hear(self._late.popleft()[1])
            if cut:
                continue
            for name, every, say in (
                ("beat", 1.0, self._beat),
                ("place", 0.2, self._place),
                ("level", 1.0, self._level),
            ):
                if (now - said[name]) * self.pace >= every:
                    said[name] = now
                    say()

    def _fly(self, step: float) -> None:
        if not self.armed:
            return
        self.battery -= step / (18 * 60)
        left = max(0.0, step - self.hold)
        self.hold = max(0.0, self.hold - step)
        while left > 0 and self.armed and self.current < len(self.items):
            item = self.items[self.current]
            if item.command == 178:
                self.speed, self.current = item.param2, self.current + 1
            elif item.command in (16, 22) and not (item.command == 16 and item.frame == 0):
                to = (
                    (item.y / 1e7 - self.home[1]) * self.east_m,
                    (item.x / 1e7 - self.home[0]) * 111_319.5,
                    item.z,
                )
                if item.command == 22:
                    to = (self.xyz[0], self.xyz[1], item.z)
                self.through_mps = self._through(to) if item.command == 16 else 0.0
                left = self._toward(to, 2.0 if item.command == 22 else self.speed, left)
            elif item.command == 20:
                self.through_mps = 0.0
                left = self._toward((0.0, 0.0, 0.0), 1.0, left)
                if self.xyz[2] <= 0.01:
                    self.armed = False
            else:
                self.current += 1

    def _through(self, corner: tuple[float, float, float]) -> float:
        """Speed at which a corner without a hold is passed, as PX4 reckons it."""
        item, after = self.items[self.current], self.items[self.current + 1]
        if item.param1 > 0 or after.command != 16:
            return 0.0
        ahead = (
            (after.y / 1e7 - self.home[1]) * self.east_m - corner[0],
            (after.x / 1e7 - self.home[0]) * 111_319.5 - corner[1],
        )
        come = corner[0] - self.xyz[0], corner[1] - self.xyz[1]
        if math.hypot(*come) < 0.01 or math.hypot(*ahead) < 0.01:
            return self.through_mps
        turn = math.atan2(come[0] * ahead[1] - come[1] * ahead[0],
                          come[0] * ahead[0] + come[1] * ahead[1])  # fmt: skip
        half = max(abs(turn) / 2, 1e-3)
        room = min(item.param2, math.hypot(*ahead) / 2)
        return min(self.speed, math.sqrt(1.5 * room / math.tan(half)))

    def _toward(self, to: tuple[float, float, float], speed: float, left: float) -> float:
        """Move for at most ``left`` seconds, with an acceleration and a stop at the end, or the
        speed at which the corner there is passed."""
        while left > 0:
            gap = math.dist(to, self.xyz)
            step = min(left, 0.05)
            self.pace_mps = min(
                self.pace_mps + ACCELERATION * step,
                speed,
                math.sqrt(2 * ACCELERATION * gap + self.through_mps**2) + 0.05,
            )
            left -= step
            if gap <= self.pace_mps * step:
                self.xyz, self.pace_mps = list(to), self.through_mps
                item = self.items[self.current]
                self.hold = item.param1 if item.command == 16 else 0.0
                self.current += 1
                return 0.0
            share = self.pace_mps * step / gap
            self.xyz = [a + share * (b - a) for a, b in zip(self.xyz, to, strict=True)]
        return 0.0

    def _beat(self) -> None:
        base = 1 | (128 if self.armed else 0)
        self.link.mav.heartbeat_send(2, self.autopilot, base, self.mode, 4)
        self.link.mav.sys_status_send(
            0, 0, 0, 0, 16000, -1, max(0, int(self.battery * 100)), 0, 0, 0, 0, 0, 0
        )

    def _place(self) -> None:
        lat, lon = self.place
        height = round(self.xyz[2] * 1000)
        self.link.mav.global_position_int_send(
            0, round(lat * 1e7), round(lon * 1e7), height, height, 0, 0, 0, 0
        )

    def _level(self) -> None:
        if self.xyz[2] > 2.0:
            self.link.mav.named_value_float_send(0, b"rsrp", self.level(*self.place))
            self.sent_s.append(time.time())

    def _hear(self, message: Any) -> None:
        kind = message.get_type()
        source = (message.get_srcSystem(), message.get_srcComponent())
        if kind == "MISSION_COUNT":
            self.coming, self.wanted = [], message.count
            self.link.mav.mission_request_int_send(*source, 0, 0)
        elif kind == "MISSION_ITEM_INT" and self.wanted:
            if message.seq == self.reject:
                self.wanted = 0
                self.link.mav.mission_ack_send(*source, 5, 0)
            elif message.seq == len(self.coming):
                self.coming.append(message)
                if len(self.coming) < self.wanted:
                    self.link.mav.mission_request_int_send(*source, len(self.coming), 0)
                else:
                    self.items, self.wanted, self.current = self.coming, 0, 0
                    self.uploads += 1
                    if self.acknowledges:
                        self.link.mav.mission_ack_send(*source, 0, 0)
        elif kind == "MISSION_REQUEST_LIST":
            self.link.mav.mission_count_send(*source, len(self.items), 0)
        elif kind == "MISSION_REQUEST_INT" and message.seq < len(self.items):
            i = self.items[message.seq]
            params = (i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z)
            about = (i.seq, i.frame, i.command, 0, 1)
            self.link.mav.mission_item_int_send(*source, *about, *params, 0)
        elif kind == "MISSION_SET_CURRENT":
            self.current = message.seq
        elif kind == "COMMAND_LONG":
            if message.command == 400:
                self.armed = message.param1 == 1
            elif message.command == 176:
                self.mode = (4 << 16) | (4 << 24) if self.px4 else int(message.param2)
