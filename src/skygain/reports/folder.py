"""The folder that a survey leaves behind."""

from __future__ import annotations

__all__ = ["FILES", "write_folder"]

import os
import shutil
import tempfile
from pathlib import Path

from skygain.reports.curves import rmse_picture
from skygain.reports.export import (
    write_measurements_csv,
    write_radio_map_nc,
    write_radio_map_tif,
    write_results_json,
)
from skygain.reports.html import write_report
from skygain.reports.outcome import Outcome
from skygain.reports.pictures import paths_picture, survey_maps

FILES = (
    "measurements.csv",
    "radio_map.tif",
    "radio_map.qml",
    "radio_map.nc",
    "survey_maps.png",
    "paths.png",
    "rmse_vs_steps.png",
    "report.html",
    "results.json",
)
"""what is written; the last one is there only when all the others are of the same survey"""
DRAFT = ".draft-"


def write_folder(outcome: Outcome, out: Path) -> list[str]:
    """Write every file to the folder ``out``: first side by side in a hidden folder, then moved
    into place one by one.

    ``results.json`` goes first and comes last, so that a folder which has it is whole. What a
    killed run left of its drafts is cleared away.

    Returns:
        What could not be written in full, and why.
    """
    for old in out.glob(f"{DRAFT}*"):
        shutil.rmtree(old, ignore_errors=True)
    draft = Path(tempfile.mkdtemp(prefix=DRAFT, dir=out))
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
        (out / "results.json").unlink(missing_ok=True)
        for name in FILES:
            if (draft / name).exists():
                os.replace(draft / name, out / name)
            else:
                (out / name).unlink(missing_ok=True)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return [note for note in notes if note]
