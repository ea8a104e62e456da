"""The groups of options that commands share: city, place, flight, method, recording.

A command's request (`skygain.app.requests`) inherits the groups it needs, so an option is declared
once for all of them. The first line of a group's docstring is its heading in the help.
"""

from __future__ import annotations

__all__ = [
    "CityRequest",
    "EnduranceRequest",
    "FlightRequest",
    "MethodRequest",
    "PlaceRequest",
    "RecordingRequest",
    "ReplayRequest",
    "TerritoryRequest",
]

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from skygain.ground.declared import Request, named
from skygain.ground.errors import InputError

if TYPE_CHECKING:
    from skygain.flight.swarm import FlightRules


@dataclass(frozen=True, kw_only=True)
class CityRequest(Request):
    """City

    All but ``city`` are fields of `skygain.cities.CityOptions`, under the same names.
    """

    city: str | None = None
    """a seed (7), a height raster (.tif), footprints (.geojson, .gpkg, .shp, .osm, .parquet, …),
    CityJSON, a scene of Sionna RT (munich, scene.xml), traced links: sample or PATH.zarr.zip, one
    of them with :LINK"""
    spacing_m: float | None = None
    """side of a cell in metres, for files, scenes and recordings; 4 or the raster's own when left
    out"""
    crs: str | None = None
    """coordinate reference system of a file that names none, e.g. EPSG:32617"""
    box: tuple[float, float, float, float] | None = None
    """west,south,east,north of the part wanted, in degrees or metres"""
    layer: str | None = None
    """layer with the buildings, of a file with several"""
    height_field: str | None = None
    """NAME[:unit] of the column (or number of the band) that holds the heights, in m, ft, cm or
    dm, e.g. heightroof:ft; z for the polygons' third coordinate"""
    default_height_m: float | None = None
    """height of a building without one in metres; 9 when left out"""
    terrain: str | None = None
    """the ground beneath: a raster of its height, its height where it is level, band:2 of the city
    file, or none if its heights are above ground already"""


@dataclass(frozen=True, kw_only=True)
class PlaceRequest(CityRequest):
    """Transmitter and truth"""

    transmitter: str = "random"
    """random, or latitude,longitude[,z], or x,y[,z] in the city's metres; z above the ground"""
    truth: Path | None = None
    """map of the gain that is measured (.tif, .nc, .npz), instead of one that is computed; with or
    without a city"""
    propagation: str = named("union", names="skygain.propagation:PROPAGATION")
    """how the truth of a city without one is computed: union (rays and over the rooftops),
    over-rooftop or gudmundson"""
    frequency_hz: float | None = named(None, flag="frequency-ghz", scale=1e9)
    """carrier frequency; left out, that of the traced links, 5 GHz for any other city"""
    crop: int | None = None
    """side in cells of a random window to survey, 0 for the whole map; left out, 96 cells, but
    files are whole"""

    def check(self) -> None:
        """The window has cells, the frequency is one."""
        if self.crop is not None and (self.crop < 0 or self.crop == 1):
            raise InputError(
                f"`crop` must be 2 cells or more, or 0 for whole maps, got {self.crop}; 96 is the "
                "paper's"
            )
        if self.frequency_hz is not None and not 0 < self.frequency_hz < math.inf:
            raise InputError(f"`frequency_hz` must be above 0, got {self.frequency_hz:g}")

    @property
    def carrier_hz(self) -> float:
        """The carrier of a world that does not bring one."""
        from skygain.scenario import FREQUENCY_HZ

        return FREQUENCY_HZ if self.frequency_hz is None else self.frequency_hz


@dataclass(frozen=True, kw_only=True)
class TerritoryRequest(Request):
    """Areas and heights"""

    area: Path | None = None
    """polygons where the map is wanted (.geojson, .kml, .gpkg, .shp, …)"""
    no_fly: Path | None = None
    """polygons where no UAV may be, between their floor and their ceiling where they have them"""
    above_sea: bool = False
    """the altitude is above sea level: the flight keeps a level, instead of following the
    ground"""


@dataclass(frozen=True, kw_only=True)
class FlightRequest(Request):
    """Swarm and flight"""

    uavs: int = 3
    """how many UAVs"""
    steps: int = 200
    """moves per UAV"""
    start: str = "cluster"
    """cluster (all in one square of 40 m) or spread (anywhere)"""
    altitude_m: float = 10.0
    """altitude of flight, and of the map where nothing else is said, metres above the ground"""
    min_distance_m: float = 0.0
    """least distance between two UAVs in metres"""
    allow_sharing: bool = False
    """UAVs may share a cell"""
    return_to_start: bool = False
    """every UAV can always fly back to its start"""
    noise_db: float = 0.0
    """standard deviation of the receivers' noise"""
    seed: int = 0
    """draws the window, the transmitter, the start, the noise and the planner's choices"""

    def check(self) -> None:
        """Numbers that can be flown."""
        if self.uavs < 1:
            raise InputError(
                f"a swarm needs at least one UAV, got {self.uavs}; give `uavs=1` or more"
            )
        if self.steps < 0:
            raise InputError(
                f"`steps` must be 0 or more, got {self.steps}; give the moves that each UAV may "
                "make"
            )
        if not (math.isfinite(self.noise_db) and self.noise_db >= 0):
            raise InputError(f"`noise_db` must be 0 dB or more, got {self.noise_db}")
        if not (math.isfinite(self.min_distance_m) and self.min_distance_m >= 0):
            raise InputError(f"`min_distance_m` must be 0 m or more, got {self.min_distance_m}")
        if self.seed < 0:
            raise InputError(f"`seed` must be 0 or more, got {self.seed}")

    @property
    def rules(self) -> FlightRules:
        """What is forbidden besides obstacles."""
        from skygain.flight.swarm import FlightRules

        return FlightRules(not self.allow_sharing, self.min_distance_m, self.return_to_start)


@dataclass(frozen=True, kw_only=True)
class EnduranceRequest(Request):
    """Home and battery"""

    home: str | None = None
    """where the UAVs take off: latitude,longitude or x,y in metres; one for all, or one for each
    with semicolons between"""
    battery_min: float | None = named(None, flag="battery")
    """minutes that a battery lasts: no flight is longer, and every UAV ends it at its home"""
    speed_mps: float = named(5.0, flag="speed")
    """speed of flight in m/s: how long a battery lasts, and the minutes flown in the report"""

    def check(self) -> None:
        """A battery and a speed that can be flown with."""
        for name, value in (("battery_min", self.battery_min), ("speed_mps", self.speed_mps)):
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"`{name}` must be above 0, got {value:g}")


@dataclass(frozen=True, kw_only=True)
class MethodRequest(Request):
    """Method (see: skygain methods)"""

    predictor: str = named("auto", names="skygain.predictors:PREDICTORS")
    """name, options as name:key=value, +tx to tell it the transmitter; module:Class for one's own;
    auto takes operator, for a recording and in a mission kriging-blind"""
    planner: str = named("sequential-greedy", names="skygain.planners:PLANNERS")
    """the same for the planner"""
    stop_std_db: float | None = named(None, flag="stop-std")
    """stop once the error expected outdoors is below this, dB: the root mean square of the
    predicted standard deviation"""


@dataclass(frozen=True, kw_only=True)
class RecordingRequest(Request):
    """Recording

    All are arguments of `skygain.instruments.read_recording`, under the same names.
    """

    columns: dict[str, str] = field(default_factory=dict)
    """columns that are not guessed right, e.g. level=RSRP,latitude=phi; names with a comma in
    quotation marks; level=MESSAGE.field of a flight log"""
    where: dict[str, str] = field(default_factory=dict)
    """lines to use, e.g. pci=101,device=Samsung,altitude=25..35; * for any"""
    quantity: str | None = None
    """what the level is: power, gain or loss; told from the column's name when left out"""
    eirp_dbm: float | None = None
    """radiated power of the transmitter: turns dBm into gain"""
    recording_crs: str | None = None
    """coordinate reference system of the recording's x and y, e.g. EPSG:32633; local for metres
    of their own"""
    level_min_db: float | None = named(None, flag="level-min")
    """leave out lower levels, in dB or dBm, in place of what the quantity allows"""
    level_max_db: float | None = named(None, flag="level-max")
    """leave out higher levels"""
    skip_bad: bool = False
    """leave out lines that cannot be understood, and count them"""


@dataclass(frozen=True, kw_only=True)
class ReplayRequest(RecordingRequest):
    """Recording, instead of a simulated world"""

    replay: Path | None = None
    """log of a campaign: CSV and its kin, .gpkg, .geojson, .kml, .gpx, .ulg, .bin, .tlog, .p2m"""
