"""`skygain map`: from logs to a folder of maps, with every reading used."""

from __future__ import annotations

__all__ = ["chart", "run_map"]

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skygain.app.progress import Progress
from skygain.app.requests import LATEST_MAP, MapRequest
from skygain.ground.declared import part
from skygain.ground.errors import InputError
from skygain.ground.files import writable_folder
from skygain.ground.journal import locked
from skygain.ground.strict_json import holds
from skygain.instruments import grid_for, joined, on_grid, read_recording, read_series
from skygain.instruments.recording import Recording
from skygain.survey.mapping import RadioMap, next_legs, next_places, radio_map
from skygain.survey.requests import RecordingRequest
from skygain.survey.territory import asked_position, city_around

if TYPE_CHECKING:
    from skygain.grid import Grid

_MOST_SERIES = 24
"""so many maps at once; of more signals those with most readings are mapped"""
_FEWEST = 3
_MOST_CELLS = 1_200_000


def run_map(request: MapRequest, progress: Progress | None = None) -> str:
    """Make the maps and write their folder.

    Returns:
        A few lines for the user: what was assumed, the errors, and where everything lies.

    Raises:
        InputError: anything about the request, the logs or the folder that the user can put right.
    """
    from skygain.reports.charts import FILES

    out = request.out
    replaced = request.overwrite or (
        out == LATEST_MAP and holds(out / "results.json", "config", "series")
    )
    if (out / "results.json").exists() and not replaced:
        raise InputError(
            f"{out} already holds results; give another `out`, or `overwrite=True` to replace them"
        )
    for name in FILES:
        if (out / name).exists() and not replaced:
            raise InputError(
                f"{out / name} is there already and no map wrote it; give another `out`, or "
                "`overwrite=True` to replace it"
            )
    with locked(writable_folder(out)):
        return _written(request, progress)


def _written(request: MapRequest, progress: Progress | None) -> str:
    from skygain.reports.charts import write_charts

    out = request.out
    charts = chart(request, progress)
    places, legs = _next(request, charts)
    title = f"Map of {', '.join(path.name for path in request.readings)}"
    left = write_charts(
        charts,
        out,
        threshold=request.threshold_db,
        places=places,
        legs=legs,
        config=request.stored(),
        title=title,
    )
    return "\n".join(
        [*_told(charts, request.threshold_db), *left, f"report: {out / 'report.html'}"]
    )


def _next(
    request: MapRequest, charts: list[RadioMap]
) -> tuple[dict[str, NDArray[np.int64]], dict[str, list[NDArray[np.float64]]]]:
    """Per label, the places or the legs of streets to measure next."""
    if not request.next_places:
        return {}, {}
    if request.streets is None:
        return {c.label: next_places(c, request.next_places) for c in charts}, {}
    from skygain.cities.streets import read_streets, street_legs

    legs = street_legs(read_streets(request.streets, charts[0].grid))
    return {}, {c.label: next_legs(c, legs, request.next_places) for c in charts}


def chart(request: MapRequest, progress: Progress | None = None) -> list[RadioMap]:
    """The maps that were asked for, one for each signal; nothing is written.

    Raises:
        InputError: anything about the request or the logs that the user can put right.
    """
    series, notes = _series(request)
    first = joined([_placed_only(r) for r in series.values()])
    city = None
    if request.city is not None:
        reading = city_around(request, first)
        city, notes = reading.city, [*notes, *reading.notes]
    grid = city.grid if city else _grid(first, request)
    area = None
    if request.area is not None:
        from skygain.cities.areas import read_areas

        area = read_areas(request.area, grid).mask()
    transmitter = None if request.transmitter is None else asked_position(request.transmitter, grid)
    charts = []
    for number, (label, recording) in enumerate(series.items()):
        if progress:
            progress(number, len(series), label)
        charts.append(
            radio_map(
                on_grid(recording, grid),
                city,
                predictor=request.predictor,
                label=label,
                altitude_m=request.altitude_m,
                area=area,
                transmitter_m=transmitter,
                frequency_hz=request.frequency_hz,
                validate=request.validate,
                seed=request.seed,
                notes=notes if number == 0 else (),
            )
        )
    if progress:
        progress(len(series), len(series), "")
    return charts


def _series(request: MapRequest) -> tuple[dict[str, Recording], list[str]]:
    """The readings of each signal, those with most first, and what to tell."""
    options = part(request, RecordingRequest)
    if request.by is None:
        logs = [read_recording(path, **options) for path in request.readings]
        return {"": joined(logs)}, []
    found: dict[str, list[Recording]] = {}
    for path in request.readings:
        for label, recording in read_series(path, request.by, **options).items():
            found.setdefault(label, []).append(recording)
    series = {label: joined(logs) for label, logs in found.items()}
    order = sorted(series, key=lambda label: -len(series[label]))
    kept = [label for label in order if len(series[label]) >= _FEWEST][:_MOST_SERIES]
    if not kept:
        raise InputError(
            f"no value of {request.by!r} has {_FEWEST} readings; choose another column for `by`"
        )
    left = [f"{label} ({len(series[label])} readings)" for label in order if label not in kept]
    notes = (
        [f"{len(left)} values of {request.by!r} not mapped: {', '.join(left[:8])}"] if left else []
    )
    return {label: series[label] for label in kept}, notes


def _placed_only(recording: Recording) -> Recording:
    """Where the readings are, for the map's extent."""
    return Recording(
        recording.level_db,
        recording.quantity,
        recording.source,
        recording.latlon,
        recording.xy_m,
        recording.crs,
    )


def _grid(recording: Recording, request: MapRequest) -> Grid:
    """The map's grid: cells as asked for, those of a simulator's receivers, or coarse enough that
    there are about 10⁶ at most."""
    if request.spacing_m is not None:
        return grid_for(recording, request.spacing_m, request.box)
    for spacing in (None, 5.0, 10.0, 20.0, 25.0, 50.0, 100.0, 200.0):
        try:
            grid = grid_for(recording, spacing, request.box)
        except InputError as error:
            if "cells" not in str(error):  # of another cause than a map with too many of them
                raise
            continue
        if grid.size <= _MOST_CELLS:
            return grid
    return grid_for(recording, 500.0, request.box)


def _told(charts: list[RadioMap], threshold: float | None) -> list[str]:
    """What was assumed, and how good the maps are."""
    shared = [note for note in charts[0].notes if all(note in c.notes for c in charts)]
    lines = [f"note: {note}" for note in shared]
    for c in charts:
        name = f"{c.label}: " if c.label else ""
        lines += [f"note: {name}{note}" for note in c.notes if note not in shared]
    for c in charts:
        name = f"{c.label}: " if c.label else ""
        unit = "dBm" if c.gridded.quantity == "power" else "dB"
        lines.append(
            f"{name}{int(c.gridded.count.sum())} readings in {len(c.gridded)} cells, map of "
            f"{c.grid.shape[0]} x {c.grid.shape[1]} cells of {c.grid.spacing_m:g} m by "
            f"{c.predictor}"
        )
        for how, what in (("random", "cells left out at random"), ("blocks", "blocks left out")):
            found = c.scores.get(how, {})
            shown = ", ".join(
                f"{n} {s.rmse_db:.2f} dB ({s.low_db:.2f} … {s.high_db:.2f})"
                for n, s in found.items()
            )
            if shown:
                lines.append(f"{name}RMSE, {what}: {shown}")
        if threshold is not None:
            share = float((c.mean_db[c.wanted] >= threshold).mean())
            lines.append(f"{name}{share:.1%} of the map at or above {threshold:g} {unit}")
    return lines
