"""Every command with its options: one frozen dataclass each.

The same object is made by Python, by a TOML or JSON file and by the command line. To add an option,
add a field with a docstring here, or to the group in `skygain.survey.requests` that all commands
with such an option share. To add a command, add a class and name it in `COMMANDS`; ``runs`` is
called with the request and a progress display, and what it returns is printed.
"""

from __future__ import annotations

__all__ = [
    "COMMANDS",
    "DatasetBuildRequest",
    "DatasetImportRequest",
    "DatasetInfoRequest",
    "DoctorRequest",
    "EvaluateRequest",
    "ExportOnnxRequest",
    "InspectRequest",
    "LATEST",
    "LATEST_MAP",
    "MapRequest",
    "MethodsRequest",
    "ReproduceRequest",
    "SurveyRequest",
    "TrainKrigingRequest",
    "TrainPolicyRequest",
    "TrainPredictorRequest",
]

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from skygain.evaluation.benchmark.request import BenchmarkExportRequest, BenchmarkScoreRequest
from skygain.evaluation.paper.request import ReproduceRequest
from skygain.evaluation.request import EvaluateRequest
from skygain.ground.declared import Request, named
from skygain.ground.errors import InputError
from skygain.ground.executor import ClusterRequest
from skygain.missions.requests import (
    MissionFlyRequest,
    MissionIngestRequest,
    MissionNewRequest,
    MissionPlanRequest,
    MissionServeRequest,
    MissionStatusRequest,
)
from skygain.survey.requests import (
    CityRequest,
    EnduranceRequest,
    FlightRequest,
    MethodRequest,
    PlaceRequest,
    RecordingRequest,
    ReplayRequest,
    TerritoryRequest,
)

LATEST = Path("surveys/latest")
"""where a survey goes unless told otherwise"""
LATEST_MAP = Path("maps/latest")
"""where a map of a campaign goes unless told otherwise"""


@dataclass(frozen=True, kw_only=True)
class OutputRequest(Request):
    """Output"""

    out: Path = named(LATEST, stored=False)
    """folder for the results; a survey in surveys/latest is replaced by the next"""
    overwrite: bool = named(False, stored=False)
    """replace results that the folder already holds"""
    resume: Path | None = named(None, stored=False)
    """go on with the survey that was cut off in this folder, as it was asked for"""
    record_every: int = 5
    """keep the map for the report every this many steps"""
    threshold_db: float | None = named(None, flag="threshold")
    """level from which there is coverage, in dB or dBm, −100 when left out: the report says the
    share of the area"""

    def check(self) -> None:
        """Something is recorded."""
        if self.record_every < 1:
            raise InputError(f"`record_every` must be 1 or more, got {self.record_every}")


@dataclass(frozen=True, kw_only=True)
class SurveyRequest(
    PlaceRequest,
    TerritoryRequest,
    FlightRequest,
    EnduranceRequest,
    MethodRequest,
    ReplayRequest,
    OutputRequest,
):
    """Fly one survey and write maps, tables, pictures and a report.

    Examples:
        skygain survey --city sample:9
        skygain survey --city buildings.geojson --uavs 5 --noise-db 2 --stop-std 6
        skygain survey --city sample:9 --predictor kriging --planner lawnmower
        skygain survey --replay campaign.csv --where pci=101
        skygain survey --city sample:9 --altitude 20 --map-altitude 10 --predictor kriging
        skygain survey --config surveys/latest/results.json --seed 1 --out surveys/again
        skygain survey --resume surveys/latest
    """

    runs: ClassVar[str] = "skygain.app.fly:run_survey"

    map_altitude_m: float | None = None
    """altitude of the map, metres above the ground; that of flight when left out"""


@dataclass(frozen=True, kw_only=True)
class MapRequest(CityRequest, RecordingRequest):
    """Map a campaign from all its readings, without a flight, with the error on readings left out.

    Examples:
        skygain map campaign.csv --where pci=101 --spacing 10
        skygain map drive.csv walk.gpkg --city buildings.geojson --threshold -105 --next 20
        skygain map scanner.csv --by pci --out maps/cells
        skygain map flight.ulg --columns level=radio_status.rssi
        skygain map campaign.csv --where pci=101 --next 20 --streets streets.geojson
    """

    runs: ClassVar[str] = "skygain.app.chart:run_map"

    readings: tuple[Path, ...] = named(argument=True)
    """logs of the campaign: CSV and its kin, .gpkg, .geojson, .kml, .gpx, .ulg, .bin, .tlog,
    .p2m"""
    predictor: str = named("auto", names="skygain.predictors:PREDICTORS")
    """name, options as name:key=value; auto takes kriging-blind, of many readings local-kriging"""
    by: str | None = None
    """column that tells signals apart, e.g. pci: one map each, and the strongest server"""
    area: Path | None = None
    """polygons of where the map is wanted (.geojson, .kml, .gpkg, .shp)"""
    altitude_m: float = 1.5
    """altitude of the readings and the map, metres above ground"""
    transmitter: str | None = None
    """x,y[,z] in metres or latitude,longitude[,z], if it is known"""
    frequency_hz: float = named(5e9, flag="frequency-ghz", scale=1e9)
    """carrier frequency"""
    threshold_db: float | None = named(None, flag="threshold")
    """level from which there is coverage, in dBm or dB: its polygons and its share"""
    next_places: int = named(0, flag="next")
    """so many places where the next readings would teach the most, or legs of streets if given"""
    streets: Path | None = None
    """lines (.geojson, .gpkg, .shp, .kml), or the highways of .osm or .pbf, to measure along"""
    validate: bool = True
    """predict readings that are left out"""
    seed: int = 0
    """draws the readings that are left out"""
    out: Path = named(LATEST_MAP, stored=False)
    """folder for the results; a map in maps/latest is replaced by the next"""
    overwrite: bool = named(False, stored=False)
    """replace results that the folder already holds"""

    def check(self) -> None:
        """There are readings, and places are counted."""
        if not self.readings:
            raise InputError("`readings` are missing; give one log or several")
        if self.next_places < 0:
            raise InputError(f"`next_places` must be 0 or more, got {self.next_places}")
        if self.streets is not None and not self.next_places:
            raise InputError("`streets` are where to measure next; say how many with `next_places`")
        if self.seed < 0:
            raise InputError(f"`seed` must be 0 or more, got {self.seed}")


@dataclass(frozen=True, kw_only=True)
class InspectRequest(CityRequest, RecordingRequest):
    """Say what a city file or a log holds and how it would be read, without a flight.

    Examples:
        skygain inspect buildings.geojson --height-field heightroof:ft
        skygain inspect surface.tif --terrain ground.tif --picture city.png
        skygain inspect campaign.csv --columns level=RSRP
    """

    runs: ClassVar[str] = "skygain.app.inspection:run_inspect"

    file: str = named(argument=True)
    """the file (or a seed, or the name of a scene)"""
    picture: Path | None = None
    """write the city's map as PNG to this file"""


@dataclass(frozen=True, kw_only=True)
class DoctorRequest(Request):
    """Say what is installed, what is missing and how to get it; trace a small test scene."""

    runs: ClassVar[str] = "skygain.app.doctor:run_doctor"


@dataclass(frozen=True, kw_only=True)
class MethodsRequest(Request):
    """List predictors, planners and propagation models, or explain one of them.

    Examples:
        skygain methods
        skygain methods lookahead
    """

    runs: ClassVar[str] = "skygain.app.explain:run_methods"

    name: str | None = named(None, argument=True)
    """the one to explain: what it is, needs, and its options"""


@dataclass(frozen=True, kw_only=True)
class OwnCitiesRequest(Request):
    """Cities of your own, instead of a preset

    How the files are read is declared as in `skygain.cities.CityOptions`.
    """

    cities: tuple[Path, ...] = ()
    """footprints, height rasters, scenes, seeds; several after one another"""
    transmitters: int = 6
    """transmitters per city, at random places of the open ground"""
    altitudes_m: tuple[float, ...] | None = None
    """altitudes of the maps, separated by commas; the preset's, or 10, when left out"""
    splits: tuple[str, ...] = ("T4",)
    """split of each city, or one for all: T1 trains, T2 validates, T3 trains policies, T4 tests"""
    side: int | None = None
    """cells along a side of every map; the smallest city's when left out"""
    seed: int = 0
    """draws the transmitters"""
    frequency_hz: float = named(5e9, flag="frequency-ghz", scale=1e9)
    """carrier frequency"""
    spacing_m: float | None = None
    """side of a cell in metres; 4 or the raster's own when left out"""
    crs: str | None = None
    """coordinate reference system of files that name none"""
    layer: str | None = None
    """layer with the buildings, of files with several"""
    height_field: str | None = None
    """NAME[:unit] of the column that holds the heights"""
    default_height_m: float | None = None
    """height of a building without one; 9 when left out"""
    terrain: str | None = None
    """raster of the ground beneath a surface model, or none if heights are above ground"""


@dataclass(frozen=True, kw_only=True)
class DatasetBuildRequest(OwnCitiesRequest, ClusterRequest):
    """Generate or read cities and trace their transmitters; goes on where a killed run stopped.

    Examples:
        skygain dataset build --preset small --out cities.zarr.zip --workers 2
        skygain dataset build --preset paper --altitudes 10,14,18,22,26,30 --out six.zarr.zip
        skygain dataset build --cities a.geojson b.tif --transmitters 6 --out mine.zarr.zip
    """

    runs: ClassVar[str] = "skygain.app.data_sets:run_build"

    preset: str | None = None
    """paper, light, small, tiny, sample (what ships), more-cities, more-altitudes, more-kinds,
    more-scenes or large"""
    out: Path
    """the data set to write, PATH.zarr.zip"""
    workers: int = 1
    """cities traced at the same time on this machine"""
    resume: bool = True
    """go on from the cities already traced"""
    propagation: str | None = named(None, names="skygain.propagation:PROPAGATION")
    """propagation model of the truth; union, or the preset's, when left out"""

    def check(self) -> None:
        """A preset or cities, not both."""
        if (self.preset is None) == (not self.cities):
            raise InputError("give a `preset`, or `cities` of your own")


@dataclass(frozen=True, kw_only=True)
class DatasetImportRequest(CityRequest):
    """Make a data set of gain maps that you have: GeoTIFF, NetCDF or NumPy archives.

    Examples:
        skygain dataset import maps.tif --city heights.tif --out mine.zarr.zip
        skygain dataset import a.npz b.npz --splits T1,T4 --altitude 10 --out mine.zarr.zip
    """

    runs: ClassVar[str] = "skygain.app.data_sets:run_import"

    maps: tuple[Path, ...] = named(argument=True)
    """.tif (one map a band), .nc or .npz (gain_db, spacing_m, height_m, transmitter_m); each file
    is a city, or with --city all are of that one"""
    out: Path
    """the data set to write, PATH.zarr.zip"""
    splits: tuple[str, ...] = ("T4",)
    """split of each city, or one for all"""
    gain: str | None = None
    """variable or band that holds the gain; gain_db, truth_db or mean_db when left out"""
    altitude_m: float | None = None
    """altitude of the maps above the ground; what the files say, or 10, when left out"""
    frequency_hz: float | None = named(None, flag="frequency-ghz", scale=1e9)
    """carrier frequency; what the files say, or 5 GHz, when left out"""
    transmitter: str | None = None
    """x,y[,z] in the maps' metres or latitude,longitude[,z]; what the files say, or the strongest
    cell, when left out"""

    def check(self) -> None:
        """There is something to import."""
        if not self.maps:
            raise InputError("`maps` are missing; give one file or several")
        for name in ("altitude_m", "frequency_hz"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"`{name}` must be above 0, got {value:g}")


@dataclass(frozen=True, kw_only=True)
class DatasetInfoRequest(Request):
    """Say what a data set holds."""

    runs: ClassVar[str] = "skygain.app.data_sets:run_info"

    path: Path = named(argument=True)
    """a data set, PATH.zarr.zip"""


@dataclass(frozen=True, kw_only=True)
class TrainKrigingRequest(Request):
    """Fit Kriging: path loss by least squares, covariance by likelihood."""

    runs: ClassVar[str] = "skygain.app.commands:run_kriging"

    data: Path
    """data set whose split T1 is fitted"""
    out: Path
    """JSON file for the parameters"""


@dataclass(frozen=True, kw_only=True)
class TrainRequest(ClusterRequest):
    """Run"""

    recipe: str
    """name of the recipe"""
    out: Path | None = None
    """folder of the run, continued if it exists; in the user's cache when left out"""
    minutes: float | None = None
    """pause after this long; the same command goes on later"""
    start_from: str | None = None
    """name or file of weights to begin from"""


@dataclass(frozen=True, kw_only=True)
class TrainPolicyRequest(TrainRequest):
    """Train a policy (imitation, dqn after it, dqn-rewards-only, dqn-thin-plate, paper-dqn); goes
    on where it stopped.

    Examples:
        skygain train policy --recipe imitation --data cities.zarr.zip
    """

    runs: ClassVar[str] = "skygain.app.commands:run_policy"

    data: Path
    """data set; the recipe says which split is flown in"""


@dataclass(frozen=True, kw_only=True)
class TrainPredictorRequest(TrainRequest):
    """Train a network (operator, path-model, locator, judge, unet, paper-unet); goes on where it
    stopped.

    Examples:
        skygain train predictor --recipe operator --data cities.zarr.zip --minutes 60
    """

    runs: ClassVar[str] = "skygain.app.commands:run_predictor"

    data: tuple[Path, ...]
    """data set: T1 trains (T3 the judge), T2 validates; may be given again to add cities"""
    finish: int | None = None
    """end the run: the learning rate falls to 0 over so many more steps"""
    keep: float | None = None
    """share of the weights begun from in those that the run ends with, 0 to 1; needs `start_from`
    and `finish`"""

    def check(self) -> None:
        """A run ends in at least one step, and keeps what it has."""
        if self.finish is not None and self.finish < 1:
            raise InputError(f"`finish` must be 1 step or more, got {self.finish}")
        if self.keep is None:
            return
        if not 0 <= self.keep <= 1:
            raise InputError(f"`keep` must be from 0 to 1, got {self.keep:g}")
        if self.finish is None or not self.start_from:
            raise InputError("`keep` needs weights to keep, `start_from`, and an end, `finish`")


@dataclass(frozen=True, kw_only=True)
class ExportOnnxRequest(Request):
    """Write a trained network with its weights as one ONNX file, for other programs."""

    runs: ClassVar[str] = "skygain.app.commands:run_export"

    network: str = named(argument=True)
    """operator, locator, unet, paper-unet, paper-unet-mapblind, dqn or imitation"""
    out: Path = named(argument=True)
    """file to write"""
    weights: Path | None = None
    """weight file; the shipped one of that name when left out"""


COMMANDS: dict[str, type[Request]] = {
    "survey": SurveyRequest,
    "map": MapRequest,
    "mission new": MissionNewRequest,
    "mission plan": MissionPlanRequest,
    "mission ingest": MissionIngestRequest,
    "mission status": MissionStatusRequest,
    "mission fly": MissionFlyRequest,
    "mission serve": MissionServeRequest,
    "inspect": InspectRequest,
    "evaluate": EvaluateRequest,
    "reproduce": ReproduceRequest,
    "benchmark export": BenchmarkExportRequest,
    "benchmark score": BenchmarkScoreRequest,
    "methods": MethodsRequest,
    "doctor": DoctorRequest,
    "dataset build": DatasetBuildRequest,
    "dataset import": DatasetImportRequest,
    "dataset info": DatasetInfoRequest,
    "train predictor": TrainPredictorRequest,
    "train policy": TrainPolicyRequest,
    "train kriging": TrainKrigingRequest,
    "export-onnx": ExportOnnxRequest,
}
"""every command; two words are a command in a group"""
