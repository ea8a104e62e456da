"""The folder of `skygain map`: rasters, readings, contours, coverage and places to measure next, a
picture and a page.

Power stays power: columns, variables and units say dBm where the readings did.
"""

from __future__ import annotations

__all__ = ["write_charts"]

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.ground.files import full_disk, unwritable
from skygain.ground.strict_json import json_text
from skygain.reports.chart_page import chart_page, chart_picture
from skygain.reports.chart_rasters import bands, write_cells, write_netcdf, write_rasters
from skygain.reports.chart_shapes import contours, coverage, write_json, write_places
from skygain.reports.chart_words import unit_of
from skygain.reports.folder import DRAFT
from skygain.survey.mapping import RadioMap

FILES = (
    "measurements.csv",
    "radio_map.tif",
    "radio_map.qml",
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
    legs: Mapping[str, Sequence[NDArray[np.float64]]] | None = None,
    config: Mapping[str, Any] | None = None,
    title: str = "Map",
) -> list[str]:
    """Write every file to the folder ``out``, ``results.json`` last.

    Args:
        charts: the maps, all on one grid.
        out: the folder.
        threshold: level from which there is coverage.
        places: per label, ``[n, (row, col)]`` where to measure next.
        legs: per label, ``[leg][point, (x, y)]`` along which to measure next, in metres.
        config: the settings of the run.
        title: headline of picture and page.

    Returns:
        What could not be written in full, and why.
    """
    for old in out.glob(f"{DRAFT}*"):  # of a run that was killed
        shutil.rmtree(old, ignore_errors=True)
    draft, places, legs = out / f"{DRAFT}{uuid4().hex[:8]}", places or {}, legs or {}
    notes: list[str] = []
    try:
        draft.mkdir()
        write_cells(charts, draft / "measurements.csv", notes)
        layers = bands(charts)
        write_rasters(charts, layers, title, draft / "radio_map.tif", notes)
        write_netcdf(charts[0], layers, title, draft / "radio_map.nc")
        write_json(contours(charts), draft / "contours.geojson")
        if threshold is not None:
            write_json(coverage(charts, threshold), draft / "coverage.geojson")
        if any(len(cells) for cells in (*places.values(), *legs.values())):
            write_places(charts[0].grid, places, legs, draft)
        picture = chart_picture(charts, places, legs, title)
        (draft / "map.png").write_bytes(picture)
        results = _results(charts, threshold, config, title)
        page = chart_page(charts, results, picture, title)
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
        "unit": unit_of(first),
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
