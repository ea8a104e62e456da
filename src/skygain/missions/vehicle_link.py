"""One vehicle at the other end of a MAVLink connection: what it says, and what it is told.

A thread listens. Missions are sent by the mission protocol: the count first, then each item as the
vehicle asks for it, until it acknowledges; what is lost on the way is sent again. They are read
back the other way round, so that nobody has to guess what a vehicle has on board.
"""

from __future__ import annotations

__all__ = ["Heard", "VehicleLink", "connection_text", "same_mission"]

import contextlib
import os
import re
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from skygain.ground.errors import InputError, require
from skygain.missions.qgroundcontrol import WAYPOINT, Item

_TRIES = 6
_WAIT_S = 1.5
"""without a sign of the vehicle for so long, the last message was lost"""
_SAME_E7, _SAME_M = 2, 0.02
"""places on board are rounded by so many 1e-7 degrees, heights by so many metres"""
_PX4, _ARDUPILOT = 12, 3
_PX4_MISSION = (4 << 16) | (4 << 24)
"""custom mode: main mode AUTO, sub mode MISSION"""
_ARDUPILOT_AUTO = 3
_ARMED = 128
_CUSTOM = 1
_DO_SET_MODE, _MISSION_START, _ARM_DISARM = 176, 300, 400
_MOST_LEVELS = 100_000


@dataclass
class Heard:
    """The newest of what a vehicle said; times are those of the listener's monotonic clock."""

    beat_s: float = -1e9
    """last heartbeat"""
    autopilot: int = 0
    """MAV_AUTOPILOT of its firmware"""
    armed: bool = False
    """its motors may turn"""
    custom_mode: int = 0
    """flight mode in the firmware's own numbers"""
    place_s: float = -1e9
    """last position"""
    latitude: float = 0.0
    """degrees"""
    longitude: float = 0.0
    """degrees"""
    height_m: float = 0.0
    """above its home"""
    battery: float = 1.0
    """share that is left; 1 where it does not say"""
    item: int = 0
    """item of the mission it flies to"""
    levels: deque[tuple[float, float, float, float]] = field(
        default_factory=lambda: deque(maxlen=_MOST_LEVELS)
    )
    """(seconds since 1970, latitude, longitude, level) of readings not taken yet"""

    @property
    def in_mission(self) -> bool:
        """Whether it follows its mission."""
        wanted = _PX4_MISSION if self.autopilot == _PX4 else _ARDUPILOT_AUTO
        return self.custom_mode == wanted


def connection_text(link: str) -> tuple[str, int]:
    """What pymavlink calls a link, and the baud rate of a serial one.

    >>> connection_text("udpin://0.0.0.0:14550"), connection_text("/dev/ttyUSB0,57600")
    (('udpin:0.0.0.0:14550', 0), ('/dev/ttyUSB0', 57600))
    """
    found = re.fullmatch(r"(udpin|udpout|tcpin|tcpout|tcp|udp):/*([^/:]+):(\d+)", link)
    if found:
        kind = {"tcpout": "tcp", "udp": "udpin"}.get(found[1], found[1])
        return f"{kind}:{found[2]}:{found[3]}", 0
    found = re.fullmatch(r"(?:serial:/*)?(/?[\w/.-]+)[,:](\d+)", link)
    if found:
        device = found[1] if found[1].startswith(("/", "COM")) else f"/{found[1]}"
        return device, int(found[2])
    raise InputError(
        f"`link` {link!r} is no address; write udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, "
        "tcpout:HOST:PORT or DEVICE,BAUD"
    )


def same_mission(one: Sequence[Item], other: Sequence[Item]) -> bool:
    """Whether two missions lead along the same way; firmwares change parameters they do not use.

    >>> there = Item(WAYPOINT, 3, (1.0, 0.0, 0.0, 0.0), 50.0, 9.0, 30.0)
    >>> same_mission([there], [there]), same_mission([there], [])
    (True, False)
    """
    return len(one) == len(other) and all(
        a.command == b.command
        and abs(a.latitude - b.latitude) <= _SAME_E7 * 1e-7
        and abs(a.longitude - b.longitude) <= _SAME_E7 * 1e-7
        and abs(a.height_m - b.height_m) <= _SAME_M
        for a, b in zip(one, other, strict=True)
    )


class VehicleLink:
    """The connection to one vehicle; use it as a context manager.

    Args:
        uav: its number in the mission.
        link: its address, see `connection_text`.
        level: ``MESSAGE.field`` that holds the level, for NAMED_VALUE_FLOAT its name.
    """

    def __init__(self, uav: int, link: str, level: str) -> None:
        self.uav, self.link = uav, link
        self.heard = Heard()
        self._level = level.partition(".")[::2]
        os.environ.setdefault("MAVLINK20", "1")
        mavutil = require("pymavlink.mavutil", "logs")
        text, baud = connection_text(link)
        if baud:
            require("serial", "logs")
        try:
            self._port = mavutil.mavlink_connection(
                text, baud=baud or 57600, source_system=255, source_component=190
            )
        except (OSError, ValueError) as error:
            raise InputError(f"cannot open `link` {link}: {error}") from error
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._items: list[Item] = []
        self._aboard: dict[int, Item] = {}
        self._answer = -1
        self._count: int | None = None
        self._sign_s = self._read_s = 0.0
        self._answered, self._counted, self._came = (threading.Event() for _ in range(3))
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> VehicleLink:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join(timeout=2.0)
        self._port.close()

    def silent_s(self) -> float:
        """Seconds since its last heartbeat."""
        return time.monotonic() - self.heard.beat_s

    def wait(self, timeout_s: float) -> bool:
        """Whether it was heard, with a position, within the time."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if self.heard.beat_s > 0 and self.heard.place_s > 0:
                return True
            time.sleep(0.02)
        return False

    def upload(
        self, items: Sequence[Item], home: tuple[float, float], most_s: float = 120.0
    ) -> bool | None:
        """Send a mission; whether the vehicle took it, ``None`` where it did not answer within
        ``most_s`` and may have either."""
        full = list(items)
        if self.heard.autopilot == _ARDUPILOT:  # its first item is the home
            full.insert(0, Item(WAYPOINT, 0, (0.0, 0.0, 0.0, 0.0), *home, 0.0))
        with self._lock:
            self._items = full
            self._answered.clear()
        self._asked(most_s, self._answered, "mission_count_send", len(full), 0)
        with self._lock:
            self._items = []
            return self._answer == 0 if self._answered.is_set() else None

    def download(self, most_s: float = 5.0) -> list[Item] | None:
        """The mission that the vehicle has on board, without ArduPilot's home; ``None`` where it
        does not answer."""
        until = time.monotonic() + most_s
        with self._lock:
            self._aboard, self._count = {}, None
            self._counted.clear()
        if not self._asked(most_s, self._counted, "mission_request_list_send", 0):
            return None
        count = self._count or 0
        for number in range(count):
            self._came.clear()
            if number not in self._aboard:
                left = until - time.monotonic()
                self._asked(left, self._came, "mission_request_int_send", number, 0)
            if number not in self._aboard:
                return None
        self._say("mission_ack_send", 0, 0)
        first = int(self.heard.autopilot == _ARDUPILOT)
        return [self._aboard[number] for number in range(first, count)]

    def _asked(self, most_s: float, answer: threading.Event, message: str, *values: Any) -> bool:
        """Say it, and again when nothing comes back, until the answer is there."""
        until = time.monotonic() + most_s
        for _ in range(_TRIES):
            self._sign_s = time.monotonic()
            self._say(message, *values)
            while (now := time.monotonic()) - self._sign_s < _WAIT_S and now < until:
                if answer.wait(0.05):
                    return True
            if now >= until:
                break
        return answer.is_set()

    def fly_from(self, item: int) -> None:
        """Go on with this item of the mission."""
        self._say("mission_set_current_send", item)

    def start(self) -> None:
        """Follow the mission."""
        px4 = self.heard.autopilot == _PX4
        mode = (_CUSTOM, 4, 4) if px4 else (_CUSTOM, _ARDUPILOT_AUTO, 0)
        self._command(_DO_SET_MODE, *mode)
        self._command(_MISSION_START)

    def arm(self) -> None:
        """Let its motors turn."""
        self._command(_ARM_DISARM, 1)

    def _command(self, number: int, *params: float) -> None:
        values = [float(v) for v in (*params, *[0] * (7 - len(params)))]
        self._say("command_long_send", number, 0, *values)

    def _say(self, message: str, *values: Any) -> None:
        target = (self._port.target_system or 1, self._port.target_component or 1)
        with self._lock, contextlib.suppress(OSError):
            getattr(self._port.mav, message)(*target, *values)

    def _listen(self) -> None:
        beat_s = 0.0
        while not self._over.is_set():
            now = time.monotonic()
            if now - beat_s > 1.0:
                beat_s = now
                with self._lock, contextlib.suppress(OSError):
                    self._port.mav.heartbeat_send(6, 8, 0, 0, 4)
            try:
                message = self._port.recv_match(blocking=True, timeout=0.1)
            except (OSError, ValueError):
                continue
            if message is not None:
                self._hear(message)

    def _hear(self, message: Any) -> None:
        heard, kind = self.heard, message.get_type()
        if kind == "HEARTBEAT" and message.type not in (6, 18):  # no ground station, no gimbal
            heard.autopilot = message.autopilot
            heard.armed = bool(message.base_mode & _ARMED)
            heard.custom_mode = message.custom_mode
            heard.beat_s = time.monotonic()
            self._port.target_system = message.get_srcSystem()
            self._port.target_component = message.get_srcComponent()
        elif kind == "GLOBAL_POSITION_INT":
            heard.latitude, heard.longitude = message.lat / 1e7, message.lon / 1e7
            heard.height_m = message.relative_alt / 1000.0
            heard.place_s = time.monotonic()
        elif kind == "SYS_STATUS" and message.battery_remaining >= 0:
            heard.battery = message.battery_remaining / 100.0
        elif kind == "MISSION_CURRENT":
            heard.item = message.seq
        elif kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            self._sign_s = time.monotonic()
            self._send_item(message.seq)
        elif kind == "MISSION_ACK":
            self._answer = message.type
            self._answered.set()
        elif kind == "MISSION_COUNT":
            self._count = message.count
            self._counted.set()
        elif kind == "MISSION_ITEM_INT":
            params = (message.param1, message.param2, message.param3, message.param4)
            place = (message.x / 1e7, message.y / 1e7, message.z)
            self._aboard[message.seq] = Item(message.command, message.frame, params, *place)
            self._came.set()
        level = self._level_of(kind, message)
        if level is not None and time.monotonic() - heard.place_s < 1.0:
            # two readings of a hovering vehicle that are heard at once are two readings
            self._read_s = max(time.time(), self._read_s + 0.001)
            heard.levels.append((self._read_s, heard.latitude, heard.longitude, level))

    def _level_of(self, kind: str, message: Any) -> float | None:
        wanted, name = self._level
        if kind != wanted:
            return None
        if kind == "NAMED_VALUE_FLOAT":
            given = message.name
            given = given.decode() if isinstance(given, bytes) else str(given)
            return float(message.value) if given.strip("\0 ") == name else None
        value = getattr(message, name, None)
        return None if value is None else float(value)

    def _send_item(self, number: int) -> None:
        with self._lock:
            if not 0 <= number < len(self._items):
                return
            item = self._items[number]
        self._say(
            "mission_item_int_send",
            number,
            item.frame,
            item.command,
            int(number == 0),
            1,
            *item.params,
            round(item.latitude * 1e7),
            round(item.longitude * 1e7),
            float(item.height_m),
            0,
        )
