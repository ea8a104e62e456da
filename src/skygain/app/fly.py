"""One whole survey, from what the user asked for to the folder of results."""

from __future__ import annotations

__all__ = ["SurveyRequest", "run_survey"]

import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.rollout import Recorder, delays_ms
from skygain.flight.starts import start_cells
from skygain.flight.swarm import FlightRules, Swarm
from skygain.ground.errors import InputError
from skygain.ground.files import writable_folder
from skygain.instruments.base import Instrument
from skygain.reports.outcome import Outcome
from skygain.scenario import Scenario
from skygain.survey.loop import Survey, SurveyConfig, SurveyResult
from skygain.survey.methods import MethodSpec

if TYPE_CHECKING:
    from skygain.predictors.base import Predictor

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class SurveyRequest:
    """What `skygain survey` was asked for."""

    city: str | None = None
    """see `skygain.survey.worlds.open_world`; ``None`` is the packaged sample, or open ground under
    a recording"""
    transmitter: str = "random"
    """``"random"`` or ``"x,y[,z]"`` in metres"""
    predictor: str = "kriging"
    """predictor text, see `skygain.survey.methods`"""
    planner: str = "greedy-variance"
    """planner text"""
    uavs: int = 3
    """how many UAVs"""
    steps: int = 200
    """moves per UAV"""
    start: str = "cluster"
    """``"cluster"`` or ``"spread"``"""
    altitude_m: float = 10.0
    """of flight and prediction"""
    noise_db: float = 0.0
    """standard deviation of Gaussian measurement noise"""
    stop_std_db: float | None = None
    """stop early below this mean predictive standard deviation outdoors"""
    seed: int = 0
    """draws everything random"""
    propagation: str = "union"
    """model of the truth for a city that brings none"""
    frequency_hz: float = 5e9
    """carrier frequency"""
    crop: int | None = 96
    """side in cells of a random window to survey, ``None`` for the whole map"""
    spacing_m: float | None = None
    """cell size for cities from files and scenes, and for recordings; ``None`` takes the source's
    own, or 4 m"""
    crs: str | None = None
    """coordinate reference system of a city file or recording that names none"""
    box: tuple[float, float, float, float] | None = None
    """(west, south, east, north) of the part of a city file, scene or recording to survey, in
    degrees or metres"""
    record_every: int = 5
    """keep the map every this many steps"""
    min_distance_m: float = 0.0
    """least distance between two UAVs"""
    separate: bool = True
    """two UAVs never share or swap cells"""
    return_to_start: bool = False
    """every UAV must be able to fly back"""
    replay: str | None = None
    """CSV of a recorded campaign, mapped instead of a simulated world"""
    columns: str | None = None
    """columns of the recording that cannot be guessed, ``"level=RSRP,latitude=phi"``"""
    where: str | None = None
    """rows of the recording to use, ``"column=value,…"``"""
    eirp_dbm: float | None = None
    """radiated power of a recorded transmitter, which turns dBm into gain"""

    def __post_init__(self) -> None:
        if self.uavs < 1:
            raise InputError(
                f"a swarm needs at least one UAV, got {self.uavs}; give --uavs 1 or more"
            )
        if self.steps < 0:
            raise InputError(
                f"steps must be 0 or more, got {self.steps}; give the number of moves each UAV may "
                "make"
            )
        if self.record_every < 1:
            raise InputError(f"record-every must be 1 or more, got {self.record_every}")
        if not (np.isfinite(self.noise_db) and self.noise_db >= 0):
            raise InputError(f"noise must be 0 dB or more, got {self.noise_db}")
        if self.seed < 0:
            raise InputError(f"a seed is 0 or more, got {self.seed}")


@dataclass(frozen=True, eq=False)
class _Setting:
    """A request made concrete: what is flown in, what measures, and what is known of the truth."""

    scenario: Scenario
    instrument: Instrument
    truth_db: NDArray[np.floating] | None
    ray_traced: NDArray[np.bool_] | None
    transmitter_m: tuple[float, float, float] | None
    title: str
    level_label: str = "channel gain in dB"


def _simulated(request: SurveyRequest, seeds: np.random.SeedSequence) -> _Setting:
    from skygain.instruments.simulated import NoiseConfig, NoisyInstrument, PerfectInstrument
    from skygain.survey.worlds import open_world

    world_seed, noise_seed = seeds.spawn(2)
    world = open_world(
        request.city or "sample",
        transmitter=request.transmitter,
        altitude_m=request.altitude_m,
        propagation=request.propagation,
        frequency_hz=request.frequency_hz,
        crop=request.crop,
        spacing_m=request.spacing_m,
        crs=request.crs,
        box=request.box,
        rng=np.random.default_rng(world_seed),
    )
    scenario = Scenario(
        world.city,
        uav_altitude_m=request.altitude_m,
        prediction_altitude_m=request.altitude_m,
        transmitter_m=world.transmitter_m,
        frequency_hz=request.frequency_hz,
    )
    instrument: Instrument = PerfectInstrument(world.truth_db)
    if request.noise_db > 0:
        instrument = NoisyInstrument(
            world.truth_db, NoiseConfig(std_db=request.noise_db), np.random.default_rng(noise_seed)
        )
    return _Setting(
        scenario,
        instrument,
        world.truth_db,
        world.ray_traced,
        world.transmitter_m,
        f"Survey of {world.city.name}",
    )


def _pairs(text: str | None, option: str) -> dict[str, str]:
    """``"a=1,b=2"`` as a dictionary."""
    pairs = [part.partition("=") for part in text.split(",")] if text else []
    if not all(key.strip() and sign for key, sign, _ in pairs):
        raise InputError(f"cannot read {option} {text!r}; write name=value,name=value")
    return {key.strip(): value.strip() for key, _, value in pairs}


def _replayed(request: SurveyRequest) -> _Setting:
    from skygain.instruments.gridded import grid_for
    from skygain.instruments.recording import read_recording
    from skygain.instruments.replay import ReplayInstrument, replay_scenario, replay_truth
    from skygain.survey.worlds import parse_position

    recording = read_recording(
        str(request.replay),
        columns=_pairs(request.columns, "--columns"),
        where=_pairs(request.where, "--where"),
        eirp_dbm=request.eirp_dbm,
        crs=request.crs,
    )
    city = None
    if request.city is not None:
        from skygain.cities import open_city

        city = open_city(
            request.city, spacing_m=request.spacing_m, crs=request.crs, box=request.box
        )
    grid = city.grid if city else grid_for(recording, request.spacing_m or 4.0, request.box)
    gridded = recording.on(grid)
    transmitter = None
    if request.transmitter != "random":
        x, y, z = parse_position(request.transmitter)
        if (
            grid.crs is not None and abs(x) <= 90 and abs(y) <= 180
        ):  # degrees: no projected position is that near its origin
            x, y = grid.xy_m_at_latlon((x, y)).tolist()
        transmitter = (x, y, z)
    scenario = replay_scenario(
        gridded,
        city,
        uav_altitude_m=request.altitude_m,
        transmitter_m=transmitter,
        frequency_hz=request.frequency_hz,
    )
    title = f"Recorded campaign {Path(str(request.replay)).name}, {len(gridded)} cells"
    label = "channel gain in dB" if gridded.quantity == "gain" else "received power in dBm"
    return _Setting(
        scenario, ReplayInstrument(gridded), replay_truth(gridded), None, transmitter, title, label
    )


def run_survey(
    request: SurveyRequest, out: Path, *, overwrite: bool = False, progress: Progress | None = None
) -> str:
    """Fly the survey and write its folder: results, measurements, maps, pictures and report.

    Everything is checked before the flight; the files appear together at the end. An interrupt ends
    the flight early and still writes what was learnt.

    Args:
        request: what to fly.
        out: folder for the results.
        overwrite: replace results that ``out`` already holds.
        progress: told (steps flown, steps in all, text).

    Returns:
        A few lines for the user: the scores and where everything lies.

    Raises:
        InputError: anything about the request or the folder that the user can put right.
    """
    method = MethodSpec(request.predictor, request.planner)
    predictor, planner = method.build_predictor(), method.build_planner()
    if (out / "results.json").exists() and not overwrite:
        raise InputError(
            f"{out} already holds the results of a survey; give another --out, or --overwrite to "
            "replace them"
        )
    writable_folder(out)
    setting_seed, start_seed, planner_seed = np.random.SeedSequence(request.seed).spawn(3)
    setting = _replayed(request) if request.replay else _simulated(request, setting_seed)
    scenario = method.visible(setting.scenario, predictor)
    _need_transmitter(scenario, predictor, request)
    rules = FlightRules(request.separate, request.min_distance_m, request.return_to_start)
    cells = start_cells(request.start, scenario, request.uavs, np.random.default_rng(start_seed))
    swarm = Swarm.deployed(scenario, cells, request.steps, rules)

    def told(step: int, scores: dict[str, float]) -> None:
        if progress:
            shown = (
                f"RMSE {scores['rmse_db']:.1f} dB"
                if np.isfinite(scores.get("rmse_db", np.nan))
                else ""
            )
            progress(step, request.steps, shown)

    record = frozenset(range(0, request.steps + 1, request.record_every))
    recorder = Recorder(record, setting.truth_db, setting.ray_traced, keep_maps=True, on_step=told)
    survey = Survey(
        scenario,
        predictor,
        planner,
        setting.instrument,
        SurveyConfig(stop_std_db=request.stop_std_db),
    )
    result = survey.fly(swarm, np.random.default_rng(planner_seed), recorder)
    recorder.take(result.swarm.steps_flown, result.swarm, result.belief)
    outcome = Outcome(
        result,
        recorder.frames,
        setting.truth_db,
        title=f"{setting.title}: {method.label}, {request.uavs} UAVs",
        config=_resolved(request),
        true_transmitter_m=setting.transmitter_m,
        level_label=setting.level_label,
    )
    notes = _write(outcome, out)
    return _summary(result, outcome, notes, out)


def _need_transmitter(scenario: Scenario, predictor: Predictor, request: SurveyRequest) -> None:
    if predictor.transmitter == "required" and scenario.transmitter_m is None:
        raise InputError(
            f"predictor {request.predictor!r} must be told where the transmitter is; give "
            "--transmitter, or choose one that does "
            "without, such as kriging-blind"
        )


def _resolved(request: SurveyRequest) -> dict[str, Any]:
    """The request and what produced it: version and, in a checkout, the commit."""
    import subprocess

    import skygain

    here = Path(__file__).parent
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False
    ).stdout.strip()
    return asdict(request) | {"skygain": skygain.__version__, "commit": commit or None}


def _write(outcome: Outcome, out: Path) -> list[str]:
    """All files of the run folder, first side by side in a hidden folder, then moved into place one
    by one."""
    from skygain.reports.export import (
        write_measurements_csv,
        write_radio_map_nc,
        write_radio_map_tif,
        write_results_json,
    )
    from skygain.reports.html import write_report
    from skygain.reports.pictures import paths_picture, rmse_picture, survey_maps

    draft = Path(tempfile.mkdtemp(prefix=".draft-", dir=out))
    try:
        notes = [
            write_measurements_csv(outcome, draft / "measurements.csv"),
            write_radio_map_tif(outcome, draft / "radio_map.tif"),
            write_radio_map_nc(outcome, draft / "radio_map.nc"),
        ]
        survey_maps(outcome, draft / "survey_maps.png")
        paths_picture(outcome, draft / "paths.png")
        rmse_picture(outcome, draft / "rmse_vs_steps.png")
        write_report(outcome, draft / "report.html")
        write_results_json(outcome, draft / "results.json")
        for path in sorted(draft.iterdir(), key=lambda p: p.name == "results.json"):
            os.replace(path, out / path.name)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return [note for note in notes if note]


def _summary(result: SurveyResult, outcome: Outcome, notes: list[str], out: Path) -> str:
    scores = outcome.frames[-1].scores
    ended = {
        "steps": "all steps flown",
        "stop-std": f"stopped early: mean predicted deviation {scores['mean_std_db']:.2f} dB",
        "interrupted": "interrupted; what was measured so far is written",
    }[result.stopped]
    lines = [
        f"{ended}: {result.swarm.steps_flown} steps, {len(result.measurements)} readings in "
        f"{int(result.measurements.visited(outcome.grid.shape).sum())} cells"
    ]
    if np.isfinite(scores.get("rmse_db", np.nan)):
        lines.append(
            f"RMSE {scores['rmse_db']:.2f} dB on unvisited cells ({scores['rmse_all_db']:.2f} dB "
            "on all), "
            f"90 % interval covers {scores['coverage90']:.0%}, goodness of fit {scores['gof']:+.2f}"
        )
    delays = delays_ms(result.journal)
    lines.append(
        f"planning {delays['decision_ms_median']:.1f} ms per decision, belief update "
        f"{delays['update_ms_median']:.1f} ms (median)"
    )
    return "\n".join([*lines, *notes, f"report: {out / 'report.html'}"])
