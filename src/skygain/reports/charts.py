"""The folder of `skygain map`: rasters, readings, contours, coverage and places to measure next, a
picture and a page.

Power stays power: columns, variables and units say dBm where the readings did.
"""

from __future__ import annotations

__all__ = ["write_charts"]

import base64
import csv
import html
import io
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.grid import Grid
from skygain.ground.errors import MissingExtraError, install_command, require
from skygain.ground.files import full_disk, unwritable
from skygain.ground.strict_json import json_text
from skygain.reports.axes import INK, colour_bar, extent_m, frame_axes, scale_and_north
from skygain.reports.folder import DRAFT
from skygain.reports.names import table_text, xml_text
from skygain.survey.mapping import RadioMap

Array = NDArray[np.float64]

_CONTOUR_STEP_DB = 10.0
FILES = (
    "measurements.csv",
    "radio_map.tif",
    "radio_map.nc",
    "contours.geojson",
    "coverage.geojson",
    "next.geojson",
    "next.kml",
    "next.gpx",
    "map.png",
    "report.html",
    "results.json",
)
"""what is written; the last one is there only when all the others are of the same maps"""


def write_charts(
    charts: Sequence[RadioMap],
    out: Path,
    *,
    threshold: float | None = None,
    places: Mapping[str, NDArray[np.int64]] | None = None,
    config: Mapping[str, Any] | None = None,
    title: str = "Map",
) -> list[str]:
    """Write every file to the folder ``out``, ``results.json`` last.

    Args:
        charts: the maps, all on one grid.
        out: the folder.
        threshold: level from which there is coverage.
        places: per label, ``[n, (row, col)]`` where to measure next.
        config: the settings of the run.
        title: headline of picture and page.

    Returns:
        What could not be written in full, and why.
    """
    for old in out.glob(f"{DRAFT}*"):  # of a run that was killed
        shutil.rmtree(old, ignore_errors=True)
    draft, places = out / f"{DRAFT}{uuid4().hex[:8]}", places or {}
    notes: list[str] = []
    try:
        draft.mkdir()
        _write_csv(charts, draft / "measurements.csv", notes)
        bands = _bands(charts)
        _write_tif(charts[0], bands, title, draft / "radio_map.tif", notes)
        _write_nc(charts[0], bands, title, draft / "radio_map.nc")
        _write_json(_contours(charts), draft / "contours.geojson")
        if threshold is not None:
            _write_json(_coverage(charts, threshold), draft / "coverage.geojson")
        if any(len(cells) for cells in places.values()):
            _write_places(charts[0].grid, places, draft)
        picture = _picture(charts, places, title)
        (draft / "map.png").write_bytes(picture)
        results = _results(charts, threshold, config, title)
        page = _page(charts, results, picture, title)
        (draft / "report.html").write_text(page, encoding="utf-8", errors="replace")
        (draft / "results.json").write_text(json_text(results), encoding="utf-8")
        (out / "results.json").unlink(missing_ok=True)
        for name in FILES:
            if (draft / name).exists():
                os.replace(draft / name, out / name)
            else:
                (out / name).unlink(missing_ok=True)
    except OSError as error:
        if full_disk(error):
            raise unwritable(out, error) from error
        raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return notes


def _unit(chart: RadioMap) -> str:
    return "dBm" if chart.gridded.quantity == "power" else "dB"


def _quantity(chart: RadioMap) -> str:
    return "received power" if chart.gridded.quantity == "power" else "channel gain"


def _named(name: str, chart: RadioMap) -> str:
    return f"{name}_{chart.label}" if chart.label else name


def _bands(charts: Sequence[RadioMap]) -> dict[str, tuple[Array, str, str]]:
    """Layers of the raster: values, unit, and what they are."""
    bands: dict[str, tuple[Array, str, str]] = {}
    for chart in charts:
        unit, what = _unit(chart), _quantity(chart)
        of = f" of {chart.label}" if chart.label else ""
        measured = np.full(chart.grid.shape, np.nan)
        measured[tuple(chart.gridded.cell.T)] = chart.gridded.level_db
        level = unit.lower()
        bands[_named(f"mean_{level}", chart)] = chart.mean_db, unit, f"estimated {what}{of}"
        bands[_named("std_db", chart)] = chart.std_db, "dB", f"its standard deviation{of}"
        bands[_named(f"measured_{level}", chart)] = measured, unit, f"mean of the readings{of}"
    if len(charts) > 1:
        means = np.stack([chart.mean_db for chart in charts])
        level, unit, what = _unit(charts[0]).lower(), _unit(charts[0]), _quantity(charts[0])
        order = np.sort(means, axis=0)[::-1]
        server = np.where(np.isnan(order[0]), np.nan, np.argmax(np.nan_to_num(means, nan=-1e9), 0))
        names = ", ".join(f"{i} is {chart.label}" for i, chart in enumerate(charts))
        bands[f"strongest_{level}"] = order[0], unit, f"{what} of the strongest server"
        bands[f"second_{level}"] = order[1], unit, f"{what} of the second best server"
        bands["server"] = server, "1", f"strongest server: {names}"
    return bands


def _write_csv(charts: Sequence[RadioMap], path: Path, notes: list[str]) -> None:
    """One line per measured cell."""
    level = "power_dbm" if _unit(charts[0]) == "dBm" else "gain_db"
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


def _write_tif(
    chart: RadioMap,
    bands: Mapping[str, tuple[Array, str, str]],
    title: str,
    path: Path,
    notes: list[str],
) -> None:
    try:
        rasterio = require("rasterio", "geo")
    except MissingExtraError:
        notes.append(f"{path.name} skipped: {install_command('geo')}")
        return
    from rasterio.io import MemoryFile

    grid = chart.grid
    west, _, _, north = grid.bounds_m
    side = grid.spacing_m
    profile = {
        "driver": "GTiff",
        "height": grid.shape[0],
        "width": grid.shape[1],
        "count": len(bands),
        "dtype": "float32",
        "nodata": np.nan,
        "crs": grid.crs,
        "transform": rasterio.Affine(side, 0.0, west, 0.0, -side, north),
        "compress": "deflate",
        "predictor": 3,
    }
    with MemoryFile() as memory:  # GDAL would put a side file next to the temporary name
        with memory.open(**profile) as raster:
            for number, (name, (values, unit, _)) in enumerate(bands.items(), start=1):
                raster.write(np.flipud(values).astype(np.float32), number)
                raster.set_band_description(number, name)
                raster.set_band_unit(number, unit)
            raster.update_tags(**{k: str(v) for k, v in _facts(chart, title).items()})
        path.write_bytes(memory.read())


def _write_nc(
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


def _lines(grid: Grid, xy: Array) -> list[list[float]]:
    """Points in metres as GeoJSON writes them: longitude and latitude where there are any."""
    if grid.crs is None:
        return [[round(float(x), 2), round(float(y), 2)] for x, y in xy]
    cells = (xy - np.asarray(grid.origin_m))[:, ::-1] / grid.spacing_m
    return [[round(float(lon), 7), round(float(lat), 7)] for lat, lon in grid.latlon(cells)]


def _generator(chart: RadioMap) -> Any:
    import contourpy

    grid = chart.grid
    if min(grid.shape) < 2:
        return None
    return contourpy.contour_generator(
        grid.x_m,
        grid.y_m,
        np.ma.masked_invalid(chart.mean_db),
        fill_type=contourpy.FillType.OuterOffset,
    )


def _contours(charts: Sequence[RadioMap]) -> dict[str, Any]:
    """Lines of equal level, every 10 dB."""
    features = []
    for chart in charts:
        generator = _generator(chart)
        if generator is None:
            continue
        low, high = np.nanmin(chart.mean_db), np.nanmax(chart.mean_db)
        first = np.ceil(low / _CONTOUR_STEP_DB) * _CONTOUR_STEP_DB
        for level in np.arange(first, high, _CONTOUR_STEP_DB):
            for line in generator.lines(level):
                shape = {"type": "LineString", "coordinates": _lines(chart.grid, line)}
                features.append(_feature(shape, chart, float(level)))
    return {"type": "FeatureCollection", "features": features}


def _coverage(charts: Sequence[RadioMap], threshold: float) -> dict[str, Any]:
    """Polygons where the estimate is at or above ``threshold``."""
    features = []
    for chart in charts:
        generator = _generator(chart)
        if generator is None:
            continue
        high = float(np.nanmax(chart.mean_db)) + 1.0
        if high <= threshold:
            continue
        for points, offsets in zip(*generator.filled(threshold, high), strict=True):
            rings = [points[a:b] for a, b in pairwise(offsets)]
            coordinates = [_lines(chart.grid, ring) for ring in rings]
            shape = {"type": "Polygon", "coordinates": coordinates}
            features.append(_feature(shape, chart, threshold))
    return {"type": "FeatureCollection", "features": features}


def _feature(shape: dict[str, Any], chart: RadioMap, level: float) -> dict[str, Any]:
    properties: dict[str, Any] = {"level": level, "unit": _unit(chart)}
    if chart.label:
        properties["series"] = chart.label
    return {"type": "Feature", "properties": properties, "geometry": shape}


def _write_json(content: Mapping[str, Any], path: Path) -> None:
    path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")


def _write_places(grid: Grid, places: Mapping[str, NDArray[np.int64]], folder: Path) -> None:
    """Where to measure next: GeoJSON, and on a map with a place on Earth KML and GPX."""
    marks: list[tuple[str, str, list[float]]] = []
    for label, cells in places.items():
        points = _lines(grid, grid.xy_m(cells)) if len(cells) else []
        marks += [(label, str(i), point) for i, point in enumerate(points, start=1)]
    features = [
        {
            "type": "Feature",
            "properties": {"order": int(order)} | ({"series": label} if label else {}),
            "geometry": {"type": "Point", "coordinates": point},
        }
        for label, order, point in marks
    ]
    _write_json({"type": "FeatureCollection", "features": features}, folder / "next.geojson")
    if grid.crs is None:
        return
    kml = "".join(
        f"<Placemark><name>{xml_text(f'{label} {order}'.strip())}</name><Point><coordinates>"
        f"{lon},{lat}</coordinates></Point></Placemark>\n"
        for label, order, (lon, lat) in marks
    )
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    (folder / "next.kml").write_text(
        f'{head}<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n{kml}</Document></kml>\n',
        encoding="utf-8",
    )
    gpx = "".join(
        f'<wpt lat="{lat}" lon="{lon}"><name>{xml_text(f"{label} {order}".strip())}</name></wpt>\n'
        for label, order, (lon, lat) in marks
    )
    (folder / "next.gpx").write_text(
        f'{head}<gpx version="1.1" creator="Skygain" xmlns="http://www.topografix.com/GPX/1/1">\n'
        f"{gpx}</gpx>\n",
        encoding="utf-8",
    )


def _picture(
    charts: Sequence[RadioMap], places: Mapping[str, NDArray[np.int64]], title: str
) -> bytes:
    """Readings, map and uncertainty of each series, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = list(charts[:6])
    figure = Figure(figsize=(15.5, 4.9 * len(shown)), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    bold = {"fontsize": 14, "fontweight": "bold", "color": INK, "parse_math": False}
    figure.suptitle(title, x=0.01, ha="left", **bold)
    grid = shown[0].grid
    rows = figure.subplots(len(shown), 3, squeeze=False, sharex=True, sharey=True)
    for axes, chart in zip(rows, shown, strict=True):
        known = chart.gridded.level_db
        low, high = np.percentile(known, (1, 99))
        high = max(high, low + 1.0)
        levels = {"vmin": low, "vmax": high, "cmap": "viridis"}
        x, y = grid.xy_m(chart.gridded.cell).T
        dots = axes[0].scatter(x, y, c=known, s=4, linewidths=0, rasterized=True, **levels)
        common = {"origin": "lower", "extent": extent_m(grid)}
        mean = axes[1].imshow(chart.mean_db, **common, **levels)
        std = axes[2].imshow(chart.std_db, **common, cmap="magma", vmin=0)
        cells = places.get(chart.label, np.empty((0, 2), dtype=int))
        if len(cells):
            nx, ny = grid.xy_m(cells).T
            axes[2].plot(nx, ny, "o", mfc="none", mec="#56B4E9", ms=6, label="measure next")
            axes[2].legend(loc="upper right", fontsize=8)
        prefix = f"{chart.label}: " if chart.label else ""
        unit = f"{_quantity(chart)} in {_unit(chart)}"
        for panel, image, name, label in zip(
            axes,
            (dots, mean, std),
            (f"{prefix}readings", f"{prefix}map", f"{prefix}uncertainty"),
            (unit, unit, "standard deviation in dB"),
            strict=True,
        ):
            panel.set_title(name, loc="left", color=INK, parse_math=False)
            beyond = "neither" if image is std else "both"
            colour_bar(figure, image, panel, label, extend=beyond)
            frame_axes(panel, grid)
            panel.label_outer()
        scale_and_north(axes[0], grid)
    memory = io.BytesIO()
    figure.savefig(memory, format="png")
    return memory.getvalue()


def _results(
    charts: Sequence[RadioMap],
    threshold: float | None,
    config: Mapping[str, Any] | None,
    title: str,
) -> dict[str, Any]:
    first, grid = charts[0], charts[0].grid
    return {
        "title": title,
        "skygain": skygain.__version__,
        "config": dict(config or {}),
        "unit": _unit(first),
        "map": {
            "shape": grid.shape,
            "spacing_m": grid.spacing_m,
            "origin_m": grid.origin_m,
            "crs": grid.crs,
            "altitude_m": first.scenario.prediction_altitude_m,
            "wanted_cells": int(first.wanted.sum()),
        },
        "series": [
            {
                "label": chart.label,
                "source": chart.gridded.source,
                "predictor": chart.predictor,
                "readings": int(chart.gridded.count.sum()),
                "measured_cells": len(chart.gridded),
                "expected_rmse_db": float(np.sqrt(np.nanmean(chart.std_db**2))),
                "covered": None
                if threshold is None
                else float((chart.mean_db[chart.wanted] >= threshold).mean()),
                "cross_validation": {
                    how: {name: asdict(score) for name, score in found.items()}
                    for how, found in chart.scores.items()
                },
                "notes": list(chart.notes),
            }
            for chart in charts
        ],
        "threshold": threshold,
    }


def _page(
    charts: Sequence[RadioMap], results: Mapping[str, Any], picture: bytes, title: str
) -> str:
    """One page with the picture, the errors and what was assumed."""
    image = base64.b64encode(picture).decode("ascii")
    parts = list(_sections(charts, results))
    style = (
        "body{font:16px/1.5 system-ui,sans-serif;max-width:1200px;margin:2rem auto;padding:0 1rem;"
        "color:#1f2933}img{max-width:100%}table{border-collapse:collapse}td,th{padding:.2rem .8rem;"
        "text-align:left;border-bottom:1px solid #d8dde3}td+td{text-align:right}"
        "@page{size:A4 landscape;margin:12mm}@media print{body{margin:0;max-width:none}"
        "img,table{break-inside:avoid}}"
    )
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}'
        f"</title><style>{style}</style></head><body>\n"
        f'<img alt="Readings, map and uncertainty" src="data:image/png;base64,{image}">\n'
        + "\n".join(parts)
        + f"\n<p>Skygain {html.escape(skygain.__version__)}</p></body></html>\n"
    )


def _sections(charts: Sequence[RadioMap], results: Mapping[str, Any]) -> Iterator[str]:
    for chart, told in zip(charts, results["series"], strict=True):
        if chart.label:
            yield f"<h2>{html.escape(chart.label)}</h2>"
        yield (
            f"<p>{told['readings']} readings in {told['measured_cells']} cells, predictor "
            f"{html.escape(chart.predictor)}."
            + (
                ""
                if told["covered"] is None
                else f" {told['covered']:.1%} of the map at or above {results['threshold']:g} "
                f"{_unit(chart)}."
            )
            + "</p>"
        )
        rows = [
            f"<tr><td>{html.escape(name)}, {how}</td><td>{score.rmse_db:.2f} dB</td><td>"
            f"{score.low_db:.2f} … {score.high_db:.2f}</td><td>{score.coverage90:.0%}</td></tr>"
            for how, found in chart.scores.items()
            for name, score in found.items()
        ]
        if rows:
            yield (
                "<table><tr><th>left out</th><th>RMSE</th><th>90 % interval</th>"
                "<th>within the 90 % band</th></tr>" + "".join(rows) + "</table>"
            )
        if chart.notes:
            items = "".join(f"<li>{html.escape(note)}</li>" for note in chart.notes)
            yield f"<ul>{items}</ul>"
