"""What a file holds and how it would be read, as a city or as a log of readings."""

from __future__ import annotations

__all__ = ["run_inspect"]

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skygain.app.progress import SILENT, Progress
from skygain.cities.inspection import holdings, inspected, picture, terminal_map
from skygain.cities.reading import CityOptions
from skygain.ground.declared import part
from skygain.ground.errors import InputError, MissingExtraError
from skygain.survey.requests import CityRequest, RecordingRequest

if TYPE_CHECKING:
    from skygain.app.requests import InspectRequest

_POINTS = (".geojson", ".json", ".gpkg", ".kml", ".kmz", ".parquet")
"""vector files that may hold readings as well as buildings"""


def run_inspect(request: InspectRequest, progress: Progress = SILENT) -> str:
    """The file's holdings, how it is read with the options given, and a map of it.

    Raises:
        InputError: there is no such file, or nothing can be told of it.
    """
    progress.phase("reading")
    path = Path(request.file)
    if _is_city(path):
        options = part(request, CityRequest)
        del options["city"]
        lines, reading = inspected(request.file, CityOptions(**options, skip_bad=_lines(request)))
        if reading is not None:
            lines.append(terminal_map(reading.city))
            if request.picture is not None:
                picture(reading.city, request.picture)
                lines.append(f"picture: {request.picture}")
            return "\n".join(lines)
        if path.suffix.lower() in _POINTS:
            try:
                return "\n".join([*lines[:-1], *_log(path, request)])
            except InputError as error:
                lines.append(f"nor as readings: {error}")
        return "\n".join(lines)
    held = [path.name] if path.is_dir() else holdings(path)
    return "\n".join([*held, *_log(path, request)])


def _is_city(path: Path) -> bool:
    from skygain.cities.raster import SUFFIXES
    from skygain.cities.scenes import SCENES
    from skygain.cities.vector import is_vector

    name = str(path).removeprefix("scene:")
    return (
        path.suffix.lower() in (*SUFFIXES, ".xml")
        or is_vector(path)
        or name in SCENES
        or name.removeprefix("manhattan:").isdigit()
    )


def _lines(request: InspectRequest) -> bool:
    return request.skip_bad and "json" in Path(request.file).suffix.lower()


def _log(path: Path, request: InspectRequest) -> list[str]:
    """What the file holds, and how it is read as a recording or why it is not."""
    from skygain.instruments.contents import column_lines
    from skygain.instruments.reading import read_recording

    held = column_lines(path, request.columns)
    try:
        recording = read_recording(str(path), **part(request, RecordingRequest))
    except MissingExtraError:
        raise  # nothing is wrong with the log
    except InputError as error:
        return [*held, f"it cannot be read as it stands: {error}"]
    unit = "dB of channel gain" if recording.quantity == "gain" else "dBm"
    low, middle, high = np.quantile(recording.level_db, [0.0, 0.5, 1.0])
    lines = [
        f"read as {len(recording)} readings from {low:.1f} to {high:.1f} {unit}, median "
        f"{middle:.1f}"
    ]
    if recording.latlon is not None:
        south, west = recording.latlon.min(axis=0)
        north, east = recording.latlon.max(axis=0)
        lines.append(f"  latitude {south:.5f} to {north:.5f}, longitude {west:.5f} to {east:.5f}")
    elif recording.xy_m is not None:
        west, south = recording.xy_m.min(axis=0)
        east, north = recording.xy_m.max(axis=0)
        frame = recording.crs or "a frame of its own"
        lines.append(f"  x {west:.1f} to {east:.1f} m, y {south:.1f} to {north:.1f} m in {frame}")
    taken = ", ".join(f"{role} from {name!r}" for role, name in recording.columns.items())
    lines += [f"  {taken}"] if taken else []
    return [*held, *lines, *(f"  {note}" for note in recording.notes)]
