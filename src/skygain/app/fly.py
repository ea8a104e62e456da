"""One whole survey, from what was asked for to the folder of results."""

from __future__ import annotations

__all__ = ["fly", "run_survey"]

import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.app.progress import SILENT, Progress
from skygain.app.requests import LATEST, SurveyRequest
from skygain.app.signals import told_of_signals
from skygain.evaluation.rollout import Recorder
from skygain.ground.compiling import on_compiling
from skygain.ground.declared import part
from skygain.ground.errors import InputError
from skygain.ground.files import file_digest, writable_folder
from skygain.ground.journal import Journal, locked
from skygain.ground.strict_json import holds, plain
from skygain.instruments.base import Instrument
from skygain.reports.flown import Flown
from skygain.reports.folder import FILES
from skygain.scenario import Scenario
from skygain.survey.deployment import deployed
from skygain.survey.loop import Survey, SurveyConfig
from skygain.survey.memory import demand_memory, in_words
from skygain.survey.methods import MethodSpec, for_quantity, parse_spec
from skygain.survey.origins import method_files
from skygain.survey.requests import EnduranceRequest, RecordingRequest
from skygain.survey.tape import FlightTape
from skygain.survey.territory import above_zero, asked_position, at_sea_level, bounded, city_around
from skygain.survey.worlds import open_world

if TYPE_CHECKING:
    from skygain.predictors.base import Predictor

WORTH_TELLING = 1e9
"""bytes of memory from which they are told before the flight"""
LEVEL_LABELS = {True: "channel gain in dB", False: "received power in dBm"}
"""what a map shows, by whether readings are gains"""
_BEFORE = "stopping: nothing was measured yet, so nothing is written"
JOURNAL = "flight.jsonl"
"""name of the file that keeps a flight while it is under way"""


def run_survey(request: SurveyRequest, progress: Progress = SILENT) -> str:
    """Fly the survey and write its folder: results, measurements, maps, pictures and report.

    Everything is checked before the flight. Every plan and reading is on the disk before the next
    step; after any death ``resume`` goes on to the same end. The files appear together at the end.
    An interrupt ends the flight early and still writes what was learnt.

    Returns:
        A few lines for the user: the scores and where everything lies.

    Raises:
        InputError: anything about the request or the folder that the user can put right.
    """
    if request.resume is not None:
        held = Journal.header(request.resume / JOURNAL)["request"]
        request = SurveyRequest.of({**held, "out": request.resume, "overwrite": True})
        resumed = True
    else:
        _check_folder(request)
        resumed = False
    out = writable_folder(request.out)
    with locked(out):
        if not resumed:
            (out / JOURNAL).unlink(missing_ok=True)
        go_on = f"skygain survey --resume {out}"
        stopping = (
            "stopping: the step under way is finished, then everything measured is written. "
            f"Ctrl-C again ends at once; {go_on}  flies the rest"
        )
        kept = f"ended; every reading is kept, go on with: {go_on}"
        with (
            _journal(request) as journal,
            told_of_signals(lambda: stopping if journal.records else _BEFORE, kept),
        ):
            try:
                outcome = fly(request, progress, journal)
                early = outcome.result.stopped == "interrupted"
                progress.phase("writing what was measured so far" if early else "writing")
                notes = [*_met(request, outcome), *outcome.write(out)]
            except InputError as error:
                if journal.records:
                    raise InputError(f"{error}; the flight is kept, go on with: {go_on}") from error
                (out / JOURNAL).unlink()  # nothing was flown, so there is nothing to go on with
                raise
            except KeyboardInterrupt:
                if not journal.records:
                    (out / JOURNAL).unlink()
                raise
        if outcome.result.stopped == "interrupted":
            notes = [*notes, f"the rest can be flown with: {go_on}"]
        else:
            (out / JOURNAL).unlink()
    return "\n".join([outcome.summary, *notes, f"report: {out / 'report.html'}"])


def _met(request: SurveyRequest, outcome: Flown) -> list[str]:
    """How much of a recording the flight used, where most of it was left."""
    if request.replay is None or outcome.truth_db is None:
        return []
    met = len(np.unique(outcome.result.measurements.cell, axis=0))
    recorded = int(np.isfinite(outcome.truth_db).sum())
    if 2 * met >= recorded:
        return []
    return [
        f"the flight met {met} of {recorded} recorded cells; a map of all of them: skygain map "
        f"{request.replay}"
    ]


def _check_folder(request: SurveyRequest) -> None:
    """Nothing of anybody is overwritten unasked."""
    out = request.out
    if request.overwrite:
        return
    if (out / "results.json").exists() and not (
        out == LATEST and holds(out / "results.json", "config", "scores_over_steps")
    ):
        raise InputError(
            f"{out} already holds the results of a survey; give another `out`, or "
            "`overwrite=True` to replace them"
        )
    if (out / JOURNAL).exists():
        raise InputError(
            f"{out} holds a survey that was cut off; `resume={out}` goes on with it, "
            "`overwrite=True` begins anew"
        )
    for name in FILES:
        if (out / name).exists() and not (out / "results.json").exists():
            raise InputError(
                f"{out / name} is there already and no survey wrote it; give another `out`, or "
                "`overwrite=True` to replace it"
            )


def _journal(request: SurveyRequest) -> Journal:
    """The journal of the flight; it belongs to the request, the files it reads and the release."""
    files = {
        str(value): file_digest(value)
        for value in plain(request.stored()).values()
        for value in _paths(value)
    } | method_files(_method(request))
    belongs_to = {"request": request.stored(), "files": files, "skygain": skygain.__version__}
    anew = "give `overwrite=True`"
    return Journal(request.out / JOURNAL, belongs_to, anew=anew)


def _paths(value: Any) -> list[str]:
    """Files that a value of a request names, alone, in a list or as an option of a method."""
    if isinstance(value, list):
        return [path for item in value for path in _paths(item)]
    if not isinstance(value, str):
        return []
    parts = [value, *(part.partition("=")[2] for part in value.split(":"))]
    return [part for part in parts if part and Path(part).is_file()]


def fly(
    request: SurveyRequest, progress: Progress = SILENT, journal: Journal | None = None
) -> Flown:
    """Fly the survey that was asked for. Nothing is written but ``journal``, where there is one:
    what it holds of this flight is not flown again.

    Raises:
        InputError: anything about the request that the user can put right.
    """
    progress.phase("loading the method")
    method = _method(request)
    predictor, planner = method.build_predictor(), method.build_planner()
    setting_seed, start_seed, planner_seed = np.random.SeedSequence(request.seed).spawn(3)
    setting = (
        _recorded(request, progress)
        if request.replay
        else _simulated(request, setting_seed, progress)
    )
    heard = replace(method, predictor=for_quantity(method.predictor, setting.quantity))
    if heard != method:
        method, predictor = heard, heard.build_predictor()
    whole, told_of_areas = bounded(setting.scenario, request)
    scenario = method.visible(whole, predictor)
    rng = np.random.default_rng(start_seed)
    swarm, told_of_flight = deployed(request, request, scenario, rng, setting.recorded)
    steps = int(swarm.steps_left.max())
    notes = (*setting.notes, *told_of_areas, *told_of_flight)
    if setting.source and (notes or setting.source["crs"]):
        progress.note(f"{setting.source['name']}: {setting.source['place']}")
    for line in notes:
        progress.note(f"  {line}")
    _need_transmitter(scenario, predictor, method)
    name, _ = parse_spec(method.predictor.removesuffix("+tx"))
    swarm_size, quantity = request.uavs, setting.quantity
    for unlike in (
        predictor.outside_training(scenario, uavs=swarm_size, quantity=quantity),
        planner.outside_training(name, uavs=swarm_size, quantity=quantity),
    ):
        if unlike:
            progress.note(unlike)
            notes = (*notes, unlike)

    def told(step: int, scores: dict[str, float]) -> None:
        known = np.isfinite(scores.get("rmse_db", np.nan))
        progress(step, steps, f"RMSE {scores['rmse_db']:.1f} dB" if known else "")

    def compiling(now: bool) -> None:
        progress.phase("compiling a kernel, once" if now else "flying")

    record = frozenset(range(0, steps + 1, request.record_every))
    recorder = Recorder(record, setting.truth_db, setting.ray_traced, keep_maps=True, on_step=told)
    config = SurveyConfig(stop_std_db=request.stop_std_db, step_duration_s=_step_s(request, whole))
    survey = Survey(scenario, predictor, planner, setting.instrument, config)
    needed = demand_memory(predictor, scenario, request.uavs * (steps + 1))
    if needed > WORTH_TELLING:
        progress.note(f"memory: up to {in_words(needed)}")
    rng = np.random.default_rng(planner_seed)
    tape = None if journal is None else FlightTape(journal, [rng, *setting.generators])
    progress.phase("flying")
    with on_compiling(compiling):
        result = survey.fly(swarm, rng, recorder, tape)
    recorder.take(result.swarm.steps_flown, result.swarm, result.belief)
    uavs = "1 UAV" if request.uavs == 1 else f"{request.uavs} UAVs"
    return Flown(
        result,
        recorder.frames,
        setting.truth_db,
        title=f"{setting.title}: {method.label}, {uavs}",
        config=_resolved(request, method),
        true_transmitter_m=setting.transmitter_m,
        level_label=LEVEL_LABELS[setting.quantity == "gain"],
        notes=notes,
        source=setting.source,
    )


def _step_s(request: SurveyRequest, scenario: Scenario) -> float:
    """Seconds that a move takes; a second where neither speed nor battery is given."""
    asked = request.battery_min is not None or request.speed_mps != EnduranceRequest.speed_mps
    return scenario.grid.spacing_m / request.speed_mps if asked else 1.0


def _method(request: SurveyRequest) -> MethodSpec:
    """What is asked for. The operator learned the gain of simulated cities; Kriging assumes least
    of a recording."""
    best = "kriging-blind" if request.replay else "operator"
    return MethodSpec(best if request.predictor == "auto" else request.predictor, request.planner)


@dataclass(frozen=True, eq=False)
class _Setting:
    """A request made concrete: what is flown in, what measures, and what is known of the truth."""

    scenario: Scenario
    instrument: Instrument
    truth_db: NDArray[np.floating] | None
    ray_traced: NDArray[np.bool_] | None
    transmitter_m: tuple[float, float, float] | None
    title: str
    quantity: str = "gain"
    notes: tuple[str, ...] = ()
    source: dict[str, Any] | None = None
    generators: tuple[np.random.Generator, ...] = ()
    recorded: NDArray[np.bool_] | None = None


def _simulated(
    request: SurveyRequest, seeds: np.random.SeedSequence, progress: Progress
) -> _Setting:
    world_seed, noise_seed = seeds.spawn(2)
    world = open_world(
        request,
        altitude_m=request.altitude_m,
        map_altitude_m=request.map_altitude_m,
        rng=np.random.default_rng(world_seed),
        told=progress.phase,
    )
    noise = np.random.default_rng(noise_seed)
    return _Setting(
        world.scenario(),
        world.instrument(request.noise_db, noise),
        world.truth_db,
        world.ray_traced,
        world.transmitter_m,
        f"Survey of {world.city.name}",
        notes=world.source.notes if world.source else (),
        source=world.source.as_data() if world.source else None,
        generators=(noise,),
    )


def _recorded(request: SurveyRequest, progress: Progress) -> _Setting:
    from skygain.instruments.gridded import grid_for, on_grid
    from skygain.instruments.reading import read_recording
    from skygain.instruments.replay import ReplayInstrument, replay_scenario, replay_truth

    progress.phase("reading the recording")
    options = part(request, RecordingRequest)
    recording = read_recording(str(request.replay), **options)
    if request.city is not None:
        progress.phase("reading the city")
    reading = None if request.city is None else city_around(request, recording)
    city = reading.city if reading else None
    grid = city.grid if city else grid_for(recording, request.spacing_m, request.box)
    gridded = on_grid(recording, grid)
    transmitter = None
    if request.transmitter != "random":
        transmitter = asked_position(request.transmitter, grid)
    altitude_m, datum_m = request.altitude_m, None
    map_altitude_m = request.map_altitude_m
    if request.above_sea:
        if city is None:
            raise InputError("`above_sea` needs to know the ground; give `city` and its `terrain`")
        city, altitude_m, transmitter, datum_m = at_sea_level(city, altitude_m, transmitter)
        if map_altitude_m is not None:
            map_altitude_m = above_zero(map_altitude_m, datum_m)
    scenario = replay_scenario(
        gridded,
        city,
        uav_altitude_m=altitude_m,
        prediction_altitude_m=map_altitude_m,
        transmitter_m=transmitter,
        frequency_hz=request.carrier_hz,
    )
    scenario = replace(scenario, datum_m=datum_m)
    notes = (*(reading.notes if reading else ()), *gridded.notes)
    within = int((gridded.recorded & scenario.city.obstructed(altitude_m)).sum())
    if within:
        notes = (
            *notes,
            f"{within} of {len(gridded)} recorded cells lie inside buildings at "
            f"{scenario.altitude_text}",
        )
    title = f"Recorded campaign {Path(str(request.replay)).name}, {len(gridded)} cells"
    return _Setting(
        scenario,
        ReplayInstrument(gridded),
        replay_truth(gridded) if scenario.one_altitude else None,
        None,
        transmitter,
        title,
        gridded.quantity,
        notes,
        reading.as_data() if reading else None,
        recorded=gridded.recorded,
    )


def _need_transmitter(scenario: Scenario, predictor: Predictor, method: MethodSpec) -> None:
    if predictor.transmitter == "required" and scenario.transmitter_m is None:
        raise InputError(
            f"predictor {method.predictor!r} must be told where the transmitter is; give "
            "`transmitter`, or choose one that does without, such as kriging-blind"
        )


def _resolved(request: SurveyRequest, method: MethodSpec) -> dict[str, Any]:
    """The request and what produced it: version and, in a checkout, the commit."""
    here = Path(__file__).parent
    commit = ""
    if shutil.which("git"):
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=False
        ).stdout.strip()
    made_by = {"skygain": skygain.__version__, "commit": commit or None}
    return request.stored() | {"predictor": method.predictor} | made_by
