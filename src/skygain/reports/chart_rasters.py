"""The maps of campaigns as layers: GeoTIFF with its style, NetCDF, and a table of the cells."""

from __future__ import annotations

__all__ = ["bands", "write_cells", "write_netcdf", "write_rasters"]

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.ground.errors import MissingExtraError, install_command, require
from skygain.reports.chart_words import level_limits, named, quantity_of, unit_of
from skygain.reports.geotiff import write_geotiff, write_style
from skygain.reports.names import table_text
from skygain.survey.mapping import RadioMap

Array = NDArray[np.float64]


def bands(charts: Sequence[RadioMap]) -> dict[str, tuple[Array, str, str]]:
    """Layers of the raster: values, unit, and what they are."""
    layers: dict[str, tuple[Array, str, str]] = {}
    for chart in charts:
        unit, what = unit_of(chart), quantity_of(chart)
        of = f" of {chart.label}" if chart.label else ""
        measured = np.full(chart.grid.shape, np.nan)
        measured[tuple(chart.gridded.cell.T)] = chart.gridded.level_db
        level = unit.lower()
        layers[named(f"mean_{level}", chart)] = chart.mean_db, unit, f"estimated {what}{of}"
        layers[named("std_db", chart)] = chart.std_db, "dB", f"its standard deviation{of}"
        layers[named(f"measured_{level}", chart)] = measured, unit, f"mean of the readings{of}"
    if len(charts) > 1:
        means = np.stack([chart.mean_db for chart in charts])
        level, unit, what = unit_of(charts[0]).lower(), unit_of(charts[0]), quantity_of(charts[0])
        order = np.sort(means, axis=0)[::-1]
        server = np.where(np.isnan(order[0]), np.nan, np.argmax(np.nan_to_num(means, nan=-1e9), 0))
        names = ", ".join(f"{i} is {chart.label}" for i, chart in enumerate(charts))
        layers[f"strongest_{level}"] = order[0], unit, f"{what} of the strongest server"
        layers[f"second_{level}"] = order[1], unit, f"{what} of the second best server"
        layers["server"] = server, "1", f"strongest server: {names}"
    return layers


def write_cells(charts: Sequence[RadioMap], path: Path, notes: list[str]) -> None:
    """One line per measured cell."""
    level = "power_dbm" if unit_of(charts[0]) == "dBm" else "gain_db"
    header = ["x_m", "y_m", "lat", "lon", "row", "col", level, "noise_std_db", "readings"]
    header += ["censored"] + ["series"] * (len(charts) > 1)
    grid, placed = charts[0].grid, charts[0].grid.crs is not None
    if placed:
        try:
            grid.latlon([(0, 0)])
        except MissingExtraError:
            placed = False
            notes.append(f"{path.name} has no lat and lon columns: {install_command('geo')}")
    if not placed:
        header = [h for h in header if h not in ("lat", "lon")]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for chart in charts:
            g = chart.gridded
            columns: list[Any] = [[f"{v:.12g}" for v in axis] for axis in grid.xy_m(g.cell).T]
            if placed:
                columns += [[f"{v:.9f}" for v in axis] for axis in grid.latlon(g.cell).T]
            columns += [*g.cell.T.tolist(), g.level_db.tolist(), g.noise_std_db.tolist()]
            columns += [g.count.tolist(), g.censored.astype(int).tolist()]
            if len(charts) > 1:
                columns.append([table_text(chart.label)] * len(g))
            writer.writerows(zip(*columns, strict=True))


def _facts(chart: RadioMap, title: str) -> dict[str, Any]:
    return {
        "title": title,
        "source": f"Skygain {skygain.__version__}",
        "altitude_m": float(chart.scenario.prediction_altitude_m),
        "predictor": chart.predictor,
    }


def write_rasters(
    charts: Sequence[RadioMap],
    layers: Mapping[str, tuple[Array, str, str]],
    title: str,
    path: Path,
    notes: list[str],
) -> None:
    """The GeoTIFF ``path`` and its style."""
    chart = charts[0]
    written = [(name, values, of) for name, (values, of, _) in layers.items()]
    note = write_geotiff(path, chart.grid, written, _facts(chart, title))
    if note is not None:
        notes.append(note)
        return
    low, high = level_limits(chart)
    write_style(path.with_suffix(".qml"), low, high, unit_of(chart))


def write_netcdf(
    chart: RadioMap, bands: Mapping[str, tuple[Array, str, str]], title: str, path: Path
) -> None:
    import xarray as xr

    grid = chart.grid
    axis = {"units": "m", "axis": "Y", "long_name": "northing of the cell centre"}
    dataset = xr.Dataset(
        {
            _plain(name): (
                ("y", "x"),
                values.astype(np.float32),
                {"units": unit, "long_name": text},
            )
            for name, (values, unit, text) in bands.items()
        },
        coords={
            "y": ("y", grid.y_m, axis),
            "x": ("x", grid.x_m, axis | {"axis": "X", "long_name": "easting of the cell centre"}),
        },
        attrs={"Conventions": "CF-1.11", **_facts(chart, title)},
    )
    if grid.crs is not None:
        west, _, _, north = grid.bounds_m
        side = grid.spacing_m
        mapping = require("pyproj", "geo").CRS.from_user_input(grid.crs).to_cf()
        mapping["GeoTransform"] = f"{west!r} {side!r} 0.0 {north!r} 0.0 {-side!r}"
        dataset = dataset.assign_coords(spatial_ref=((), 0, {"crs": grid.crs, **mapping}))
        for name in dataset.data_vars:
            dataset[name].attrs["grid_mapping"] = "spatial_ref"
    encoding = {name: {"zlib": True, "complevel": 4} for name in dataset.data_vars}
    # HDF5 ends the process when the disk fills while it writes, so it writes to memory.
    path.write_bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding))


def _plain(name: str) -> str:
    """A variable's name without what NetCDF cannot hold."""
    return "".join(c if c.isalnum() or c in "_.-" else "_" for c in name)
