"""A finished survey together with what is needed to write about it.

Every file of a run folder (tables, rasters, pictures, report) tells of the same thing, so all
writers take this one object. What several of them need, such as the final posterior or the map of
readings, is worked out once here.
"""

from __future__ import annotations

__all__ = ["SCORE_LABELS", "Outcome", "score_label"]

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.posterior import Posterior
from skygain.scenario import Scenario

if TYPE_CHECKING:
    from skygain.evaluation.rollout import Frame
    from skygain.survey.loop import SurveyResult

Array = NDArray[np.float64]

_THRESHOLD, _SPEED_MPS = -100.0, 5.0
SCORE_LABELS: dict[str, str] = {
    "rmse_db": "RMSE, unvisited cells",
    "rmse_all_db": "RMSE, all outdoor cells",
    "rmse_ray_traced_db": "RMSE, cells a ray reached",
    "rmse_rest_db": "RMSE, cells no ray reached",
    "expected_rmse_db": "RMSE, as predicted",
    "crps_db": "CRPS",
    "gof": "goodness of fit",
    "error_ratio": "squared error over variance",
    "nll": "negative log likelihood",
    "coverage50": "coverage of the 50 % interval",
    "coverage90": "coverage of the 90 % interval",
}
"""what each score is called in pictures and reports"""


def score_label(name: str) -> str:
    """What the score called ``name`` is called in pictures and reports; an unknown one keeps its
    name."""
    return SCORE_LABELS.get(name, name.replace("_", " "))


@dataclass(frozen=True, eq=False, repr=False)
class Outcome:
    """One survey, told from its end."""

    result: SurveyResult
    """what the loop returned"""
    frames: Sequence[Frame] = ()
    """the survey at some of its steps, in order, with maps"""
    truth_db: NDArray[np.floating] | None = None
    """``[row, col]`` true gain, NaN where unknown; ``None`` when none is known"""
    title: str = "Survey"
    """headline of the report"""
    config: Mapping[str, Any] | None = None
    """the settings of the run, nested mappings of plain values"""
    true_transmitter_m: tuple[float, float, float] | None = None
    """(x, y, z) of the transmitter where it was withheld from the predictor but is known to the
    truth"""

    level_label: str = "channel gain in dB"
    """what is mapped, with its unit; a recording may hold received power instead"""
    notes: tuple[str, ...] = ()
    """what the readers of the city, the areas and the recording mended, assumed or left out"""
    source: Mapping[str, Any] | None = None
    """the city as it was read (`skygain.cities.Reading.as_data`); ``None`` where it was not"""

    def __repr__(self) -> str:
        return f"{self.title}\n{self.summary}"

    @property
    def quantity(self) -> str:
        """What is mapped: "channel gain" or "received power"."""
        return self.level_label.rpartition(" in ")[0]

    @property
    def unit(self) -> str:
        """Of what is mapped: "dB" or "dBm"."""
        return self.level_label.rpartition(" in ")[2]

    @property
    def summary(self) -> str:
        """How it ended, what the predictor was told, how good the map is and how long deciding
        took: a line each."""
        ended, *took = repr(self.result).splitlines()
        scores = {name: values[-1] for name, values in self.scores.items()}
        lines = [ended, self.told]
        if np.isfinite(scores.get("rmse_db", np.nan)):
            lines.append(
                f"RMSE {scores['rmse_db']:.2f} dB on unvisited cells "
                f"({scores['rmse_all_db']:.2f} dB on all), 90 % interval covers "
                f"{scores['coverage90']:.0%}, goodness of fit {scores['gof']:+.2f}"
            )
        elif "expected_rmse_db" in scores:
            lines.append(f"RMSE as predicted {scores['expected_rmse_db']:.2f} dB")
        return "\n".join([*lines, *took])

    @property
    def told(self) -> str:
        """What the predictor knew before the first reading."""
        buildings = bool((self.scenario.city.height_m > 0).any())
        if self.scenario.transmitter_m is not None:
            knew = "the buildings and the transmitter" if buildings else "the transmitter"
        elif buildings:
            knew = "the buildings, not where the transmitter is"
        else:
            knew = "neither buildings nor where the transmitter is"
        return f"the predictor was told {knew}"

    @property
    def scenario(self) -> Scenario:
        """What was known before the survey."""
        return self.result.scenario

    @property
    def grid(self) -> Grid:
        """The map's raster."""
        return self.result.scenario.grid

    @property
    def speed_mps(self) -> float:
        """Speed of the UAVs that minutes are told for."""
        return float((self.config or {}).get("speed_mps") or _SPEED_MPS)

    @property
    def threshold(self) -> float:
        """Level from which there is coverage, −100 unless another was asked for."""
        asked = (self.config or {}).get("threshold_db")
        return _THRESHOLD if asked is None else float(asked)

    @property
    def covered(self) -> float:
        """Share of the outdoor cells whose estimate is at or above `threshold`."""
        return float((self.mean_db[self.scenario.outdoor] >= self.threshold).mean())

    @cached_property
    def flown_m(self) -> NDArray[np.float64]:
        """``[step]`` way of the UAV that has flown farthest by then, in metres."""
        moves = np.abs(np.diff(self.result.swarm.history, axis=1)).sum(axis=2)
        way = np.cumsum(moves, axis=1).max(axis=0) * self.grid.spacing_m
        return np.concatenate([[0.0], way])

    @property
    def low_roofs(self) -> NDArray[np.bool_]:
        """``[row, col]`` built up, but below the flight."""
        city = self.scenario.city
        return np.asarray((city.height_m > 0) & ~city.obstructed(self.scenario.uav_altitude_m))

    @property
    def transmitter_m(self) -> tuple[float, float, float] | None:
        """(x, y, z) of the transmitter, as far as anyone knows."""
        return self.true_transmitter_m or self.scenario.transmitter_m

    @cached_property
    def posterior(self) -> Posterior:
        """What is believed at the end."""
        return self.result.posterior

    @cached_property
    def mean_db(self) -> Array:
        """``[row, col]`` estimate, NaN where the prediction does not count (indoors)."""
        return np.where(self.scenario.outdoor, self.posterior.mean_db, np.nan)

    @cached_property
    def std_db(self) -> Array:
        """``[row, col]`` predicted standard deviation, NaN indoors."""
        return np.where(self.scenario.outdoor, self.posterior.std_db, np.nan)

    @cached_property
    def outdoor_truth_db(self) -> Array | None:
        """``[row, col]`` truth, NaN indoors and where unknown; ``None`` when it is known nowhere
        outdoors."""
        if self.truth_db is None:
            return None
        truth = np.where(self.scenario.outdoor, np.asarray(self.truth_db, dtype=float), np.nan)
        return truth if np.isfinite(truth).any() else None

    @property
    def truth_is_complete(self) -> bool:
        """Whether the truth is known in every outdoor cell; it is not where it was recorded."""
        truth = self.outdoor_truth_db
        return truth is not None and bool(np.isfinite(truth[self.scenario.outdoor]).all())

    @cached_property
    def measured_db(self) -> Array:
        """``[row, col]`` mean of the readings taken in each cell, NaN where there is none."""
        readings = self.result.measurements
        index = self.grid.flat(readings.cell)
        count = np.bincount(index, minlength=self.grid.size)
        total = np.bincount(index, weights=readings.gain_db, minlength=self.grid.size)
        with np.errstate(invalid="ignore"):
            return (total / count).reshape(self.grid.shape)

    @cached_property
    def steps(self) -> list[int]:
        """Steps flown at each frame."""
        return [int(frame.step) for frame in self.frames]

    @cached_property
    def scores(self) -> dict[str, list[float]]:
        """Each score at each frame; NaN where a frame lacks one."""
        names = dict.fromkeys(name for frame in self.frames for name in frame.scores)
        return {
            name: [float(frame.scores.get(name, np.nan)) for frame in self.frames] for name in names
        }
