"""The folder that a survey leaves behind."""

from __future__ import annotations

__all__ = ["write_folder"]

import os
import shutil
import tempfile
from pathlib import Path

from skygain.reports.export import (
    write_measurements_csv,
    write_radio_map_nc,
    write_radio_map_tif,
    write_results_json,
)
from skygain.reports.html import write_report
from skygain.reports.outcome import Outcome
from skygain.reports.pictures import paths_picture, rmse_picture, survey_maps


def write_folder(outcome: Outcome, out: Path) -> list[str]:
    """Write every file to the folder ``out``: first side by side in a hidden folder, then moved
    into place one by one, ``results.json`` last.

    Returns:
        What could not be written in full, and why.
    """
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
