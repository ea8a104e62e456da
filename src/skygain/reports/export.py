"""A survey's result as files that other programs read: JSON, CSV, GeoTIFF and NetCDF.

Each writer takes an `Outcome` and a path and writes the file atomically. A writer that can do less
than all because an optional package is missing says so in the note it returns, so that a survey
never ends without its results.
"""

from __future__ import annotations

__all__ = [
    "outcome_dataset",
    "write_measurements_csv",
    "write_radio_map_nc",
    "write_radio_map_tif",
    "write_results_json",
]

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import skygain
from skygain.ground.errors import MissingExtraError, install_command, require
from skygain.ground.files import atomic_write
from skygain.ground.strict_json import json_text
from skygain.reports.geotiff import write_geotiff, write_style
from skygain.reports.outcome import Outcome
from skygain.reports.scales import gain_limits

if TYPE_CHECKING:
    import xarray as xr


def write_measurements_csv(outcome: Outcome, path: Path) -> str | None:
    """Every reading as a line, in the order taken.

    Columns: ``x_m, y_m`` (cell centre), ``lat, lon`` (degrees WGS 84, only on a georeferenced map),
    ``row, col``, ``gain_db`` (or ``power_dbm``, as the map), ``noise_std_db``, ``time_s``, ``uav``
    (from 0), ``censored`` (1 where the receiver was at its floor, else 0).

    Returns:
        A note when latitudes had to be left out because the geo extra is missing, else ``None``.
    """
    readings, grid, note = outcome.result.measurements, outcome.grid, None
    x_m, y_m = grid.xy_m(readings.cell).T
    columns = {"x_m": [f"{x:.12g}" for x in x_m], "y_m": [f"{y:.12g}" for y in y_m]}
    if grid.crs is not None:
        try:
            latlon = grid.latlon(readings.cell)
            columns |= {
                "lat": [f"{v:.9f}" for v in latlon[:, 0]],
                "lon": [f"{v:.9f}" for v in latlon[:, 1]],
            }
        except MissingExtraError:
            note = f"{path.name} has no lat and lon columns; for these: {install_command('geo')}"
    columns |= {
        "row": readings.cell[:, 0].tolist(),
        "col": readings.cell[:, 1].tolist(),
        # written in full, so that a replay reads the same bits
        "gain_db" if outcome.unit == "dB" else "power_dbm": readings.gain_db.tolist(),
        "noise_std_db": readings.noise_std_db.tolist(),
        "time_s": readings.time_s.tolist(),
        "uav": readings.uav.tolist(),
        "censored": readings.censored.astype(int).tolist(),
    }
    with atomic_write(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return note


def write_radio_map_tif(outcome: Outcome, path: Path) -> str | None:
    """The map as a cloud-optimised GeoTIFF with three or four float32 bands, north up, named in
    their descriptions, and beside it the style ``.qml`` that QGIS draws it in.

    ``mean_db`` and ``std_db`` hold the final estimate, no-data inside buildings; ``measured`` holds
    the mean of the readings of a cell, no-data where there is none; ``ground_m`` is the height of
    the ground, where one is known. No-data is NaN. Without a CRS the transform is in the metres of
    the city's own frame.

    Returns:
        A note when the geo extra is missing and nothing was written, else ``None``.
    """
    level = outcome.unit.lower()
    bands = [
        (f"mean_{level}", outcome.mean_db, outcome.unit),
        ("std_db", outcome.std_db, "dB"),
        ("measured", outcome.measured_db, outcome.unit),
    ]
    if outcome.scenario.city.ground_m.any():
        bands.append(("ground_m", np.asarray(outcome.scenario.city.ground_m), "m"))
    note = write_geotiff(path, outcome.grid, bands, _facts(outcome))
    if note is None:
        write_style(path.with_suffix(".qml"), *gain_limits(outcome), outcome.unit)
    return note


def write_radio_map_nc(outcome: Outcome, path: Path) -> str | None:
    """The map as NetCDF 4 after the CF conventions, readable with xarray, GDAL and Panoply.

    Coordinates ``y`` (ascending: row 0 is the south) and ``x`` in metres; variables ``mean_db``,
    ``std_db`` (NaN indoors), ``measured_db`` (NaN where there is no reading), ``truth_db`` (where
    known), ``outdoor`` and ``height_m``. A georeferenced map also has the grid mapping
    ``spatial_ref``.

    Returns:
        A note when the CRS could only be named because the geo extra is missing, else ``None``.
    """
    content, note = _netcdf(outcome)
    if note:
        note = f"{path.name} {note}"
    with atomic_write(path) as tmp:
        tmp.write_bytes(content)
    return note


def outcome_dataset(outcome: Outcome) -> xr.Dataset:
    """What `write_radio_map_nc` writes, read back."""
    import xarray as xr

    return xr.load_dataset(io.BytesIO(_netcdf(outcome)[0]), engine="h5netcdf")


def _netcdf(outcome: Outcome) -> tuple[bytes, str | None]:
    """The NetCDF's content, and what could not be said about the CRS.

    HDF5 ends the process when the disk fills while it writes, so it writes to memory. It is written
    without xarray, whose import would take longer than all the rest.
    """
    import h5netcdf

    grid = outcome.grid
    what, unit, level = outcome.quantity, outcome.unit, outcome.unit.lower()
    layers: dict[str, tuple[np.ndarray, str, str]] = {
        f"mean_{level}": (outcome.mean_db.astype(np.float32), unit, f"estimated {what}"),
        "std_db": (
            outcome.std_db.astype(np.float32),
            "dB",
            f"predicted standard deviation of the {what}",
        ),
        f"measured_{level}": (
            outcome.measured_db.astype(np.float32),
            unit,
            f"mean of the {what} measured in the cell",
        ),
        "height_m": (outcome.scenario.city.height_m, "m", "building height above the ground"),
        "outdoor": (
            outcome.scenario.outdoor.astype(np.int8),
            "1",
            "1 where the cell is outdoors at the prediction altitude",
        ),
    }
    if outcome.scenario.city.ground_m.any():
        above = _printable(outcome.scenario.city.ground_datum or "its zero")
        ground = np.ascontiguousarray(outcome.scenario.city.ground_m)
        layers["ground_m"] = (ground, "m", f"height of the ground above {above}")
    if outcome.outdoor_truth_db is not None:
        layers[f"truth_{level}"] = (
            outcome.outdoor_truth_db.astype(np.float32),
            unit,
            f"true {what}",
        )
    axes = {
        "y": (grid.y_m, {"axis": "Y", "long_name": "northing of the cell centre"}),
        "x": (grid.x_m, {"axis": "X", "long_name": "easting of the cell centre"}),
    }
    mapping, note = {}, None
    if grid.crs is not None:
        try:
            mapping = require("pyproj", "geo").CRS.from_user_input(grid.crs).to_cf()
            axes["y"][1]["standard_name"] = "projection_y_coordinate"
            axes["x"][1]["standard_name"] = "projection_x_coordinate"
        except MissingExtraError:
            note = f"names the CRS {grid.crs} without its definition: {install_command('geo')}"
        west, _, _, north = grid.bounds_m
        transform = f"{west!r} {grid.spacing_m!r} 0.0 {north!r} 0.0 {-grid.spacing_m!r}"
        mapping = {"crs": grid.crs, **mapping, "GeoTransform": transform}
    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        file.attrs.update({"Conventions": "CF-1.11", **_facts(outcome)})
        file.dimensions = {"y": grid.shape[0], "x": grid.shape[1]}
        for name, (positions_m, told) in axes.items():
            one = file.create_variable(name, (name,), data=positions_m, fillvalue=np.nan)
            one.attrs.update({"units": "m", **told})
        if mapping:
            file.create_variable("spatial_ref", data=0).attrs.update(mapping)
        for name, (values, unit, text) in layers.items():
            one = file.create_variable(
                name,
                ("y", "x"),
                data=values,
                fillvalue=np.nan if values.dtype.kind == "f" else None,
                compression="gzip",
                compression_opts=4,
            )
            one.attrs.update({"units": unit, "long_name": text})
            if mapping:
                one.attrs.update({"grid_mapping": "spatial_ref", "coordinates": "spatial_ref"})
    return content.getvalue(), note


def write_results_json(outcome: Outcome, path: Path) -> None:
    """Settings, scores over steps, planning and update times as strict JSON: sorted keys, ``null``
    for what is not a number.

    Raises:
        TypeError: the configuration holds something JSON cannot say.
    """
    result, grid, scenario = outcome.result, outcome.grid, outcome.scenario
    readings = result.measurements
    certificates = [
        record.certificate for record in result.journal if record.certificate is not None
    ]
    content = {
        "title": outcome.title,
        "skygain": skygain.__version__,
        "config": outcome.config or {},
        "city": {
            "name": scenario.city.name,
            "shape": grid.shape,
            "spacing_m": grid.spacing_m,
            "origin_m": grid.origin_m,
            "crs": grid.crs,
            "ground_m": [float(scenario.city.ground_m.min()), float(scenario.city.ground_m.max())],
            "ground_datum": scenario.city.ground_datum,
            "source": outcome.source,
        },
        "notes": list(outcome.notes),
        "scenario": {
            "uav_altitude_m": scenario.uav_altitude_m,
            "prediction_altitude_m": scenario.prediction_altitude_m,
            "altitude": scenario.altitude_text,
            "altitude_zero_m": scenario.datum_m,
            "no_fly_cells": 0 if scenario.no_fly is None else int(scenario.no_fly.sum()),
            "frequency_hz": scenario.frequency_hz,
            "transmitter_m": outcome.transmitter_m,
            "transmitter_known": scenario.transmitter_m is not None,
            "outdoor_cells": int(scenario.outdoor.sum()),
        },
        "survey": {
            "stopped": result.stopped,
            "uavs": result.swarm.n_uavs,
            "steps_flown": result.swarm.steps_flown,
            "start_cells": result.swarm.history[:, 0],
            "readings": len(readings),
            "censored_readings": int(readings.censored.sum()),
            "measured_cells": int(readings.visited(grid.shape).sum()),
        },
        "scores": {name: values[-1] for name, values in outcome.scores.items()},
        "scores_over_steps": {"step": outcome.steps, **outcome.scores},
        "timings": result.timings,
        "certificates": certificates,
    }
    text = json_text(content)
    with atomic_write(path) as tmp:
        tmp.write_text(text, encoding="utf-8", errors="replace")


def _facts(outcome: Outcome) -> dict[str, str | float]:
    """What a reader of a map has to know beside its numbers."""
    scenario = outcome.scenario
    facts: dict[str, str | float] = {
        "title": _printable(outcome.title),
        "source": f"Skygain {skygain.__version__}",
        "city": _printable(scenario.city.name),
        "prediction_altitude_m": float(scenario.prediction_altitude_m),
        "uav_altitude_m": float(scenario.uav_altitude_m),
        "altitude": _printable(scenario.altitude_text),
        "frequency_hz": float(scenario.frequency_hz),
    }
    if outcome.transmitter_m is not None:
        facts |= dict(
            zip(
                ("transmitter_x_m", "transmitter_y_m", "transmitter_z_m"),
                map(float, outcome.transmitter_m),
                strict=True,
            )
        )
    return facts


def _printable(text: str) -> str:
    """``text`` without what an HDF5 or TIFF attribute cannot hold: NUL and halves of surrogate
    pairs."""
    return text.encode("utf-8", "replace").decode("utf-8").replace("\0", "")
