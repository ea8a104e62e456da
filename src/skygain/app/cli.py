"""The command line: parses, calls, prints.

Anything the user can put right ends in one line on standard error and exit code 2; an unexpected
exception is a bug and shows its traceback.
"""

from __future__ import annotations

__all__ = ["app", "main"]

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import skygain
from skygain.ground.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

app = typer.Typer(
    help="Map a radio transmitter's channel gain over a city with a swarm of UAVs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
dataset_app = typer.Typer(
    help="Build and inspect data sets of ray-traced cities.", no_args_is_help=True
)
train_app = typer.Typer(help="Train what the package ships trained.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")
app.add_typer(train_app, name="train")


def main() -> None:
    """Entry point of the ``skygain`` command."""
    try:
        app()
    except InputError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)


def _show_version(value: bool) -> None:
    if value:
        print(f"skygain {skygain.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    pass


@contextmanager
def _progress(label: str) -> Iterator[Callable[[int, int, str], None]]:
    """A progress bar on standard error with time left: call it with (done, total, text)."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=None, text="")

        def tell(done: int, total: int, text: str = "") -> None:
            bar.update(task, completed=done, total=total, text=text)
            if (
                not console.is_terminal
                and total
                and (done == total or done % max(1, total // 20) == 0)
            ):
                print(f"{label}: {done}/{total} {text}", file=sys.stderr, flush=True)

        yield tell


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _box(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"cannot read the box {text!r}; write west,south,east,north") from None
    return west, south, east, north


@app.command()
def survey(
    city: Annotated[
        str | None,
        typer.Option(
            help="What to fly over: 'sample' or 'sample:LINK' (traced links in the package), a "
            "data set PATH.zarr.zip[:LINK], a seed "
            "of a Manhattan city, a height raster (.tif), footprints (.geojson, .gpkg, .shp, "
            ".osm), or a Sionna scene name. "
            "'sample' when left out."
        ),
    ] = None,
    transmitter: Annotated[
        str,
        typer.Option(
            help="'random', or x,y[,z] in the city's metres; for a recording also "
            "latitude,longitude[,z], if known."
        ),
    ] = "random",
    predictor: Annotated[
        str,
        typer.Option(
            help="Predictor, with options as name:key=value; +tx tells it the transmitter."
        ),
    ] = "kriging",
    planner: Annotated[
        str, typer.Option(help="Planner, with options as name:key=value.")
    ] = "greedy-variance",
    uavs: Annotated[int, typer.Option(help="How many UAVs.")] = 3,
    steps: Annotated[int, typer.Option(help="Moves per UAV.")] = 200,
    start: Annotated[
        str, typer.Option(help="cluster (one 40 m square) or spread (anywhere).")
    ] = "cluster",
    altitude: Annotated[
        float, typer.Option(help="Altitude of flight and prediction, metres above the street.")
    ] = 10.0,
    noise_db: Annotated[
        float, typer.Option(help="Standard deviation of Gaussian measurement noise.")
    ] = 0.0,
    stop_std: Annotated[
        float | None,
        typer.Option(
            help="Stop early once the mean predictive standard deviation outdoors is below this "
            "(dB)."
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            help="Draws the crop, the transmitter, the start and the planner's randomness."
        ),
    ] = 0,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("surveys/latest"),
    overwrite: Annotated[
        bool, typer.Option(help="Replace results that are already in --out.")
    ] = False,
    propagation: Annotated[
        str,
        typer.Option(
            help="Truth of a city that brings none: union (ray tracing and over-rooftop), "
            "raytrace, over-rooftop, gudmundson."
        ),
    ] = "union",
    frequency_ghz: Annotated[float, typer.Option(help="Carrier frequency.")] = 5.0,
    crop: Annotated[
        int, typer.Option(help="Side in cells of a random window to survey; 0 for the whole map.")
    ] = 96,
    spacing: Annotated[
        float | None,
        typer.Option(
            help="Cell size in metres for cities from files, scenes and recordings (4 when left "
            "out)."
        ),
    ] = None,
    crs: Annotated[
        str | None,
        typer.Option(
            help="Coordinate reference system of a city file that names none, e.g. EPSG:32617."
        ),
    ] = None,
    record_every: Annotated[
        int, typer.Option(help="Keep the map for the report every this many steps.")
    ] = 5,
    min_distance: Annotated[
        float, typer.Option(help="Least distance between two UAVs, metres.")
    ] = 0.0,
    allow_sharing: Annotated[
        bool, typer.Option(help="Let UAVs share cells (separation is on otherwise).")
    ] = False,
    return_to_start: Annotated[
        bool, typer.Option(help="Every UAV must be able to fly back to its start.")
    ] = False,
    replay: Annotated[
        Path | None,
        typer.Option(help="Map a recorded campaign (CSV) instead of a simulated world."),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            help="Columns of the recording that are not guessed right, e.g. "
            "level=RSRP,latitude=phi."
        ),
    ] = None,
    where: Annotated[
        str | None, typer.Option(help="Rows of the recording to use, e.g. PCI=A,device=Samsung.")
    ] = None,
    eirp_dbm: Annotated[
        float | None,
        typer.Option(help="Radiated power of a recorded transmitter: turns dBm into gain."),
    ] = None,
    box: Annotated[
        str | None,
        typer.Option(
            help="west,south,east,north of the part to survey, in degrees or metres (city files, "
            "recordings)."
        ),
    ] = None,
) -> None:
    """Fly one survey and write maps, tables, pictures and a report."""
    from skygain.app.fly import SurveyRequest, run_survey

    request = SurveyRequest(
        city=city,
        transmitter=transmitter,
        predictor=predictor,
        planner=planner,
        uavs=uavs,
        steps=steps,
        start=start,
        altitude_m=altitude,
        noise_db=noise_db,
        stop_std_db=stop_std,
        seed=seed,
        propagation=propagation,
        frequency_hz=frequency_ghz * 1e9,
        crop=crop or None,
        spacing_m=spacing,
        crs=crs,
        record_every=record_every,
        min_distance_m=min_distance,
        separate=not allow_sharing,
        return_to_start=return_to_start,
        replay=str(replay) if replay else None,
        columns=columns,
        where=where,
        eirp_dbm=eirp_dbm,
        box=_box(box),
    )
    with _progress("survey") as tell:
        summary = run_survey(request, out, overwrite=overwrite, progress=tell)
    print(summary)


@app.command()
def evaluate(
    predictors: Annotated[
        str | None, typer.Option(help="Predictors, separated by commas; kriging when left out.")
    ] = None,
    planners: Annotated[
        str | None,
        typer.Option(
            help="Planners, separated by commas; every predictor flies with every planner. "
            "random-waypoint when left out."
        ),
    ] = None,
    methods: Annotated[
        str,
        typer.Option(
            help="Further methods as in the tables, 'PREDICTOR / PLANNER', separated by commas; "
            "they can stand alone."
        ),
    ] = "",
    data: Annotated[str, typer.Option(help="Data set (PATH.zarr.zip), or 'sample'.")] = "sample",
    split: Annotated[str, typer.Option(help="T1, T2, T3 or T4.")] = "T4",
    uavs: Annotated[int, typer.Option(help="How many UAVs.")] = 3,
    steps: Annotated[int, typer.Option(help="Moves per UAV.")] = 200,
    start: Annotated[str, typer.Option(help="cluster or spread.")] = "cluster",
    altitude: Annotated[
        float, typer.Option(help="Altitude of flight and prediction, metres.")
    ] = 10.0,
    noise_db: Annotated[
        float, typer.Option(help="Standard deviation of Gaussian measurement noise.")
    ] = 0.0,
    max_surveys: Annotated[
        int | None, typer.Option(help="At most this many surveys, spread over the cities.")
    ] = None,
    crop: Annotated[
        int, typer.Option(help="Side in cells of the random window to survey; 0 for whole maps.")
    ] = 96,
    record_every: Annotated[int, typer.Option(help="Score every this many steps.")] = 25,
    min_distance: Annotated[
        float, typer.Option(help="Least distance between two UAVs, metres.")
    ] = 0.0,
    allow_sharing: Annotated[
        bool, typer.Option(help="Let UAVs share cells (separation is on otherwise).")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes; one per core when left out.")
    ] = None,
    seed: Annotated[
        int, typer.Option(help="Draws crops, starts and the planners' randomness.")
    ] = 0,
    out: Annotated[
        Path,
        typer.Option(
            help="Folder for rollouts, results.json, table.md and the figure; resumes what is "
            "there."
        ),
    ] = Path("surveys/evaluation"),
) -> None:
    """Compare methods over many surveys, paired, with intervals; the table is the last thing
    printed."""
    from skygain.app.compare import run_comparison
    from skygain.evaluation.comparison import ComparisonConfig
    from skygain.flight.swarm import FlightRules

    alone = bool(methods) and predictors is None and planners is None
    config = ComparisonConfig(
        predictors=_names("kriging" if predictors is None and not alone else predictors or ""),
        planners=_names("random-waypoint" if planners is None and not alone else planners or ""),
        pairs=_names(methods),
        data=data,
        split=split,
        uavs=uavs,
        steps=steps,
        start=start,
        altitude_m=altitude,
        noise_db=noise_db,
        max_surveys=max_surveys,
        crop=crop,
        record_every=record_every,
        rules=FlightRules(separate=not allow_sharing, min_distance_m=min_distance),
        seed=seed,
    )
    with _progress("evaluate") as tell:
        table = run_comparison(config, out, workers=workers, progress=tell)
    print(table)


@app.command()
def doctor() -> None:
    """Say what is installed, what is missing and how to get it, and trace a two-box scene to prove
    that ray tracing works."""
    from skygain.app.doctor import report

    text, healthy = report()
    print(text)
    if not healthy:
        raise typer.Exit(1)


@app.command()
def methods() -> None:
    """List the predictors, planners and propagation models that can be named."""
    from skygain.planners import PLANNERS
    from skygain.predictors import PREDICTORS
    from skygain.propagation import PROPAGATION

    for registry in (PREDICTORS, PLANNERS, PROPAGATION):
        print(f"{registry.kind}: {', '.join(registry.names())}")


@dataset_app.command("build")
def dataset_build(
    preset: Annotated[
        str,
        typer.Option(
            help="paper, small, tiny, sample (what ships), more-cities, more-altitudes or large."
        ),
    ],
    out: Annotated[Path, typer.Option(help="The data set to write, PATH.zarr.zip.")],
    workers: Annotated[int, typer.Option(help="Cities traced at the same time.")] = 1,
    resume: Annotated[
        bool, typer.Option(help="Go on from the cities already traced; --no-resume starts again.")
    ] = True,
    propagation: Annotated[
        str | None, typer.Option(help="Propagation model of the truth; the preset's when left out.")
    ] = None,
) -> None:
    """Generate cities and trace their transmitters; can be killed at any time and goes on where it
    stopped."""
    from skygain.datasets.builder import build_dataset
    from skygain.datasets.summary import describe_dataset

    with _progress("cities") as tell:
        build_dataset(
            preset,
            out,
            workers=workers,
            resume=resume,
            propagation=propagation,
            progress=lambda done, total, _left: tell(done, total, ""),
        )
    print(describe_dataset(out))


@dataset_app.command("info")
def dataset_info(path: Annotated[Path, typer.Argument(help="A data set, PATH.zarr.zip.")]) -> None:
    """Say what a data set holds."""
    from skygain.datasets.summary import describe_dataset

    print(describe_dataset(path))


@app.command("export-onnx")
def export_onnx_command(
    network: Annotated[
        str, typer.Argument(help="operator, locator, unet, paper-unet or paper-unet-mapblind.")
    ],
    out: Annotated[Path, typer.Argument(help="File to write.")],
    weights: Annotated[
        Path | None, typer.Option(help="Weight file; by default the shipped one of that name.")
    ] = None,
    rows: Annotated[int, typer.Option(help="Rows of the map.")] = 96,
    cols: Annotated[int, typer.Option(help="Columns of the map.")] = 96,
) -> None:
    """Write a trained network as ONNX, for computers on board without PyTorch; checked against
    PyTorch before it is written."""
    from skygain.networks.onnx_export import export_onnx

    worst = export_onnx(network, out, weights=weights, shape=(rows, cols))
    print(f"wrote {out}; largest difference to PyTorch {worst:.1e} dB")


@train_app.command("kriging")
def train_kriging_command(
    data: Annotated[Path, typer.Option(help="Data set whose T1 split to fit.")],
    out: Annotated[Path, typer.Option(help="JSON file for the parameters.")],
) -> None:
    """Fit the Kriging parameters: path loss by least squares, covariance by likelihood."""
    from skygain.training.kriging import train_kriging

    print(train_kriging(data, out))


@train_app.command("policy")
def train_policy_command(
    recipe: Annotated[
        str, typer.Option(help="imitation, dqn (after it), dqn-rewards-only or paper-dqn.")
    ],
    data: Annotated[Path, typer.Option(help="Data set; the recipe says which split is flown in.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the run, continued if it exists; by default in the user's cache."
        ),
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help="Pause after this long; the same command goes on later.")
    ] = None,
    start_from: Annotated[
        str | None, typer.Option(help="Name or file of a policy to begin a DQN from.")
    ] = None,
) -> None:
    """Train a policy by recipe; can be killed at any time and goes on where it stopped. The planner
    of that name finds the weights."""
    from skygain.training import train_policy

    changes: dict[str, object] = {} if minutes is None else {"max_seconds": 60 * minutes}
    if start_from is not None:
        changes["start_from"] = start_from
    result = train_policy(recipe, data, out, report=_say, **changes)
    print(f"{result.step} steps, {result.seconds / 60:.0f} minutes; scores {result.scores}")


def _say(record: dict[str, object]) -> None:
    """A line of a run's log, for people."""
    print("  ".join(f"{key} {value}" for key, value in record.items()), file=sys.stderr, flush=True)


@train_app.command("predictor")
def train_predictor_command(
    recipe: Annotated[
        str,
        typer.Option(
            help="operator, path-model, locator, judge, unet, paper-unet, paper-unet-mapblind, …"
        ),
    ],
    data: Annotated[
        list[Path],
        typer.Option(
            help="Data set; T1 trains (T3 the judge), T2 validates. Give it again to add another "
            "one's cities."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the run, continued if it exists; by default in the user's cache."
        ),
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help="Pause after this long; the same command goes on later.")
    ] = None,
    finish: Annotated[
        int | None,
        typer.Option(
            help="End the run: the learning rate falls to 0 over so many more steps.", min=1
        ),
    ] = None,
    start_from: Annotated[
        str | None, typer.Option(help="Name or file of weights, or a checkpoint, to begin from.")
    ] = None,
) -> None:
    """Train a network by recipe; can be killed at any time and goes on where it stopped. The
    predictor of that name finds the weights."""
    from skygain.training import train_predictor

    changes: dict[str, object] = {} if minutes is None else {"max_seconds": 60 * minutes}
    if finish is not None:
        changes["finish_steps"] = finish
    if start_from is not None:
        changes["start_from"] = start_from
    result = train_predictor(recipe, data, out, report=_say, **changes)
    print(
        f"{result.step} steps, {result.samples} samples, {result.seconds / 60:.0f} minutes; scores "
        f"{result.scores}"
    )
