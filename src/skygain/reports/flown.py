"""The outcome of a survey that shows itself in a notebook and writes its own files."""

from __future__ import annotations

__all__ = ["Flown"]

from pathlib import Path
from typing import TYPE_CHECKING

from skygain.ground.files import writable_folder
from skygain.ground.shown import Shown
from skygain.reports.export import outcome_dataset
from skygain.reports.folder import write_folder
from skygain.reports.outcome import Outcome
from skygain.reports.pictures import survey_figure

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


class Flown(Outcome, Shown):
    """What `skygain.app.fly.fly` returns."""

    def to_xarray(self) -> xr.Dataset:
        """Everything of ``radio_map.nc``: estimate, uncertainty, readings, truth, buildings."""
        return outcome_dataset(self)

    def plot(self) -> Figure:
        """Truth, estimate, error and uncertainty."""
        return survey_figure(self)

    def write(self, folder: str | Path) -> list[str]:
        """Write all files of a survey to ``folder``, see docs/outputs.md; returns what had to be
        left out, and why."""
        return write_folder(self, writable_folder(folder))
