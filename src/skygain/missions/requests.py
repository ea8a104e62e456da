"""What each command of a mission may be asked for."""

from __future__ import annotations

__all__ = [
    "FleetRequest",
    "MissionFlyRequest",
    "MissionIngestRequest",
    "MissionNewRequest",
    "MissionPlanRequest",
    "MissionRequest",
    "MissionServeRequest",
    "MissionStatusRequest",
]

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from skygain.ground.declared import Request, named
from skygain.ground.errors import InputError
from skygain.survey.requests import CityRequest, MethodRequest, RecordingRequest, TerritoryRequest


@dataclass(frozen=True, kw_only=True)
class FleetRequest(Request):
    """Fleet and flight"""

    uavs: int = 3
    """how many UAVs"""
    home: str | None = None
    """LAT,LON of the take-off place; several with a semicolon between, one for each UAV. UAVs that
    share one stand `separation` apart around it"""
    altitude_m: float = 40.0
    """altitude of flight and map, metres above the ground (or the sea, see `above_sea`)"""
    speed_mps: float = named(5.0, flag="speed")
    """speed along the legs, m/s"""
    battery_min: float = named(18.0, flag="battery")
    """minutes that a full battery keeps a UAV in the air"""
    reserve_percent: float = named(20.0, flag="reserve")
    """percent of the battery that a plan never uses"""
    clearance_m: float = 8.0
    """least distance from buildings, terrain, no-fly zones and the edge of the area, metres"""
    separation_m: float = 15.0
    """least distance between two UAVs in the air, metres"""

    def check(self) -> None:
        """Numbers that can be flown."""
        if self.uavs < 1:
            raise InputError(f"a mission needs at least one UAV, got {self.uavs}; give `uavs=1`")
        for name, low, high in (
            ("altitude_m", 1, 500),
            ("speed_mps", 0.5, 30),
            ("battery_min", 1, 600),
            ("clearance_m", 0, 200),
            ("separation_m", 0, 500),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise InputError(f"`{name}` must be {low:g} to {high:g}, got {value:g}")
        if not 0 <= self.reserve_percent < 100:
            raise InputError(
                f"`reserve_percent` must be 0 to below 100, got {self.reserve_percent:g}"
            )

    @property
    def usable_s(self) -> float:
        """Seconds of flight that a plan may use."""
        return self.battery_min * 60.0 * (1.0 - self.reserve_percent / 100.0)


@dataclass(frozen=True, kw_only=True)
class MissionNewRequest(CityRequest, TerritoryRequest, FleetRequest, MethodRequest):
    """Begin a mission: check what is asked for, draw it, and make its folder.

    Examples:
        skygain mission new tonight --city buildings.geojson --area area.kml --home 49.9975,9.0102
        skygain mission new tonight --city dsm.tif --terrain dem.tif --no-fly zones.geojson --uavs 2
    """

    runs: ClassVar[str] = "skygain.missions.commands:run_new"

    folder: Path = named(argument=True, stored=False)
    """the mission's folder; it is made"""
    transmitter: str | None = None
    """x,y[,z] in metres or latitude,longitude[,z], if it is known"""
    frequency_hz: float = named(5e9, flag="frequency-ghz", scale=1e9)
    """carrier frequency"""
    outlook: int = 3
    """so many sorties are simulated to say what they would bring; 0 for none"""
    seed: int = 0
    """draws the planner's choices"""

    def check(self) -> None:
        """There is a city, and a place to take off from."""
        if self.city is None:
            raise InputError(
                "a mission needs a map; give `city`, e.g. buildings.geojson or dsm.tif"
            )
        if not 0 < self.frequency_hz < math.inf:
            raise InputError(f"`frequency_hz` must be above 0, got {self.frequency_hz:g}")
        if self.outlook < 0 or self.seed < 0:
            raise InputError("`outlook` and `seed` must be 0 or more")


@dataclass(frozen=True, kw_only=True)
class MissionRequest(Request):
    """Mission"""

    folder: Path = named(argument=True, stored=False)
    """the mission's folder"""


@dataclass(frozen=True, kw_only=True)
class MissionPlanRequest(MissionRequest):
    """Plan the next sortie and write its files for the vehicles and a page for the crew.

    Without new readings since the last plan, the same sortie is written again.

    Examples:
        skygain mission plan tonight
        skygain mission plan tonight --without 2
    """

    runs: ClassVar[str] = "skygain.missions.commands:run_plan"

    without: tuple[int, ...] = ()
    """numbers of UAVs that stay on the ground; the open sortie is planned anew for the others"""
    ahead: bool = False
    """plan one sortie more although the last was not flown yet, as if it had been"""


@dataclass(frozen=True, kw_only=True)
class MissionIngestRequest(MissionRequest, RecordingRequest):
    """Take the readings of a flight into the mission; the same readings count once.

    Examples:
        skygain mission ingest tonight uav0.csv uav1.tlog
        skygain mission ingest tonight flight.ulg --columns level=cellular_status.rsrp
    """

    runs: ClassVar[str] = "skygain.missions.commands:run_ingest"

    files: tuple[Path, ...] = named(argument=True, stored=False)
    """logs: CSV and its kin, .gpkg, .geojson, .kml, .gpx, .ulg, .bin, .tlog"""
    shift_hours: float = 0.0
    """hours to add to the logs' times, where a clock was off"""

    def check(self) -> None:
        """There are logs."""
        if not self.files:
            raise InputError("`files` are missing; give one log or several")


@dataclass(frozen=True, kw_only=True)
class MissionStatusRequest(MissionRequest):
    """Write the map so far, and say what the next sortie would bring and whether to stop.

    Examples:
        skygain mission status tonight
    """

    runs: ClassVar[str] = "skygain.missions.commands:run_status"

    least_gain_db: float = named(0.1, flag="least-gain")
    """a sortie that lowers the expected error by less than this is not worth flying, dB"""


@dataclass(frozen=True, kw_only=True)
class MissionFlyRequest(MissionRequest):
    """Fly the open sortie over MAVLink: upload, start, take readings in, plan on.

    Nothing is armed without --arm and a typed yes. Given again after a death of this program, it
    takes over the vehicles in the air with what they have on board.

    Examples:
        skygain mission fly tonight --dry-run
        skygain mission fly tonight --link udpin:0.0.0.0:14550 --link udpin:0.0.0.0:14560 --arm
    """

    runs: ClassVar[str] = "skygain.missions.commands:run_fly"

    link: tuple[Path, ...] = ()
    """udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT, tcpout:HOST:PORT or DEVICE,BAUD; one for
    each UAV"""
    dry_run: bool = False
    """show what would be sent, and send nothing"""
    arm: bool = False
    """arm the vehicles and take off, after a typed yes; else their pilots do"""
    level: str = "NAMED_VALUE_FLOAT.rsrp"
    """MESSAGE.field that holds the level, in dBm; for NAMED_VALUE_FLOAT the value's name"""
    wait_s: float = named(20.0, flag="wait")
    """seconds to wait for a vehicle's first heartbeat and position"""
    pace: float = 1.0
    """seconds of the vehicles in one second; above 1 for a simulator that runs fast"""

    def check(self) -> None:
        """A level can be found, and time passes."""
        if not 0.1 <= self.pace <= 100:
            raise InputError(f"`pace` must be 0.1 to 100, got {self.pace:g}")
        if not all(self.level.partition(".")):
            raise InputError(f"`level` is MESSAGE.field, got {self.level!r}")


@dataclass(frozen=True, kw_only=True)
class MissionServeRequest(MissionRequest):
    """Serve the mission's live page: map, uncertainty, readings, plans, upload of readings.

    Examples:
        skygain mission serve tonight
        skygain mission serve tonight --host 0.0.0.0 --port 8800
    """

    runs: ClassVar[str] = "skygain.missions.commands:run_serve"

    host: str = "127.0.0.1"
    """address to listen on; another than this machine's own lets others read the mission"""
    port: int = 8080
    """port to listen on"""

    def check(self) -> None:
        """A port."""
        if not 0 <= self.port < 65536:
            raise InputError(f"`port` must be 0 to 65535, got {self.port}")
