"""How well each of several beliefs foretold the readings of a survey.

A forecast is what the beliefs said when the survey was less than half as large. Every reading that
comes is held against one, so a belief is judged by what it said of places where nobody had been.
Readings near those that the forecast knew say little about the rest of the map and do not count,
and of neighbours, which say the same thing twice, one counts. Near is what lies within `NEAR_M`, or
within half the mean distance of a cell from the nearest reading where readings are that dense.

With z = (y − m)/√(a v) the score of a belief is log t₅(z) − ½ log(a v), summed with the weight of
older forecasts falling by `MEMORY` each. Its variance is multiplied by

    a = (n₀ + Σ z₀²) / (n₀ + n),   z₀ = (y − m)/√v,   n₀ = `PRIOR_VOTES`.
"""

from __future__ import annotations

__all__ = ["GROWTH", "Forecast", "Votes"]

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from skygain.grid import Grid
from skygain.posterior import Posterior
from skygain.predictors.interpolators.readings import Readings
from skygain.scenario import Scenario

Array = NDArray[np.float64]

GROWTH = 1.3
"""a forecast is made when there are this many times as many readings as at the last one"""
LAG = 2.5
"""readings are held against the newest forecast from when there were this many times fewer"""
NEAR_M = 32.0
"""least distance between a reading that counts and those that the forecast knew, and between two
that count"""
MEMORY = 0.85
"""what a score keeps of its weight when a new forecast is made"""
FREEDOM = 5.0
"""of Student's t"""
PRIOR_VOTES = 8.0
"""n₀: readings that the prior of a variance is worth"""
LARGEST_Z2 = 50.0
"""squared errors over variance count up to this in the scale of a variance"""
SMALLEST_DB2 = 0.25
"""variance that a forecast is judged by at least"""


@dataclass(frozen=True, eq=False)
class Forecast:
    """What the beliefs said at one moment."""

    cells: NDArray[np.int64]
    """raveled cells there were readings of"""
    near_m: float
    """distance up to which another reading is near one of these"""
    mean_db: NDArray[np.float32]
    """``[belief, P]``"""
    variance_db2: NDArray[np.float32]
    """``[belief, P]``"""

    @classmethod
    def of(
        cls, scenario: Scenario, cells: NDArray[np.int64], posteriors: Sequence[Posterior]
    ) -> Forecast:
        """The forecast after readings of raveled ``cells``."""
        unread = np.ones(scenario.grid.size, dtype=bool)
        unread[cells] = False
        away = ndimage.distance_transform_edt(unread.reshape(scenario.grid.shape))
        away_m = float(away[scenario.outdoor].mean()) * scenario.grid.spacing_m
        near_m = min(NEAR_M, away_m / 2)
        mean, variance = (
            np.array([p.ravel() for p in maps], dtype=np.float32)
            for maps in (
                [p.mean_db for p in posteriors],
                [p.variance_db2 for p in posteriors],
            )
        )
        return cls(cells, near_m, mean, variance)


@dataclass(frozen=True, eq=False)
class Votes:
    """The scores so far. Immutable; `counted` and `with_forecast` return new ones."""

    prior: Array
    """``[belief]`` log odds before any reading"""
    score: Array
    """``[belief]`` log score"""
    squares: Array
    """``[belief]`` Σ z₀²"""
    votes: float
    """n"""
    forecasts: tuple[Forecast, ...]
    """coming readings are held against the first, the others are for later"""
    heard: NDArray[np.int64]
    """raveled cells that counted against it"""

    @classmethod
    def none(cls, prior: ArrayLike) -> Votes:
        """Nothing heard yet; ``prior[belief]`` are log odds."""
        odds = np.asarray(prior, dtype=float)
        nothing = np.zeros(len(odds))
        return cls(odds, nothing, nothing, 0.0, (), np.empty(0, dtype=np.int64))

    @property
    def factor(self) -> Array:
        """``[belief]`` a."""
        return (PRIOR_VOTES + self.squares) / (PRIOR_VOTES + self.votes)

    @property
    def weight(self) -> Array:
        """``[belief]`` probability of each, summing to 1."""
        log_weight = self.score + self.prior
        weight = np.exp(log_weight - log_weight.max())
        return weight / weight.sum()

    def due(self, size: int) -> bool:
        """Whether ``size`` readings call for a new forecast."""
        return not self.forecasts or size >= GROWTH * len(self.forecasts[-1].cells)

    def counted(self, grid: Grid, readings: Readings) -> Votes:
        """After readings at distinct cells, held against a forecast."""
        if not self.forecasts or not len(readings):
            return self
        forecast = self.forecasts[0]
        chosen, heard = _telling(grid, readings.cells, forecast, self.heard)
        if not chosen.any():
            return self
        cells, noise = readings.cells[chosen], readings.noise_db2[chosen]
        error = readings.gain_db[chosen] - forecast.mean_db[:, cells]
        variance = np.maximum(forecast.variance_db2[:, cells], SMALLEST_DB2) + noise
        scaled = self.factor[:, None] * variance
        z2 = error**2 / (scaled * (1 - 2 / FREEDOM))
        score = -0.5 * (FREEDOM + 1) * np.log1p(z2 / FREEDOM) - 0.5 * np.log(scaled)
        return replace(
            self,
            score=self.score + score.sum(axis=1),
            squares=self.squares + np.minimum(error**2 / variance, LARGEST_Z2).sum(axis=1),
            votes=self.votes + int(chosen.sum()),
            heard=heard,
        )

    def with_forecast(self, forecast: Forecast) -> Votes:
        """With a new forecast; older scores weigh less."""
        kept = [*self.forecasts, forecast]
        while len(kept) > 1 and len(kept[1].cells) * LAG <= GROWTH * len(forecast.cells):
            kept.pop(0)
        same = bool(self.forecasts) and kept[0] is self.forecasts[0]
        return replace(
            self,
            score=MEMORY * self.score,
            squares=MEMORY * self.squares,
            votes=MEMORY * self.votes,
            forecasts=tuple(kept),
            heard=self.heard if same else np.empty(0, dtype=np.int64),
        )


def _telling(
    grid: Grid,
    cells: NDArray[np.int64],
    forecast: Forecast,
    heard: NDArray[np.int64],
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """``[n]`` which of ``cells[n]`` lie away from those the forecast knew, those heard and each
    other, and all heard now."""
    at, before, listed = (
        np.stack(np.divmod(some, grid.shape[1]), axis=-1) for some in (cells, forecast.cells, heard)
    )
    gap2 = np.sum((at[:, None] - before[None]) ** 2, axis=-1).min(axis=1, initial=np.iinfo(int).max)
    near2 = (forecast.near_m / grid.spacing_m) ** 2
    chosen, taken = gap2 >= near2, listed.tolist()
    for i in np.flatnonzero(chosen):
        row, col = at[i].tolist()
        chosen[i] = all((row - r) ** 2 + (col - c) ** 2 >= near2 for r, c in taken)
        if chosen[i]:
            taken.append([row, col])
    return chosen, np.append(heard, cells[chosen])
