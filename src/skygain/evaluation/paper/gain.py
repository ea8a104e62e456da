"""Error and goodness of fit by true gain, with intervals over cities."""

from __future__ import annotations

__all__ = ["GainCurves", "gain_curves"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.metrics import GAIN_EDGES_DB
from skygain.evaluation.statistics import Interval, city_weights

_LEAST_SHARE = 0.002
"""bins with fewer of the cells say nothing"""


@dataclass(frozen=True, eq=False)
class GainCurves:
    """Scores by bins of true gain; of every array ``[0]`` is the value and the others are those of
    the resamples."""

    gain_db: NDArray[np.float64]
    """``[bin]`` middle of the bin"""
    share: NDArray[np.float64]
    """``[bin]`` of all cells"""
    rmse_db: NDArray[np.float64]
    """``[1 + resample, bin]``"""
    gof: NDArray[np.float64]
    """``[1 + resample, bin]``"""
    gof_all: NDArray[np.float64]
    """``[1 + resample]`` over all cells"""
    cities: int
    """how many cities were drawn from"""

    def interval(self, draws: NDArray[np.float64]) -> Interval:
        """The value with its interval, of ``draws[1 + resample]``."""
        if self.cities < 2:
            return Interval(float(draws[0]), np.nan, np.nan)
        low, high = np.nanquantile(draws[1:], [0.025, 0.975])
        return Interval(float(draws[0]), float(low), float(high))

    def slope(self, scores: NDArray[np.float64]) -> Interval:
        """How much ``scores[1 + resample, bin]`` grow per 10 dB of gain: a least-squares line."""
        known = np.isfinite(scores)
        count = known.sum(axis=1)
        filled = np.where(known, scores, 0.0)
        x = np.where(known, self.gain_db / 10, 0.0)
        dx = np.where(known, x - (x.sum(axis=1) / count)[:, None], 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.interval((dx * filled).sum(axis=1) / (dx**2).sum(axis=1))


def gain_curves(sums: dict[str, NDArray[np.float64]], cities: NDArray[np.int64]) -> GainCurves:
    """The curves of one method.

    Args:
        sums: ``[case, bin]`` by name, see `skygain.evaluation.metrics.by_gain`.
        cities: ``[case]``.
    """
    whole = np.ones((1, len(cities))) / len(cities)
    weights = np.concatenate([whole, city_weights(cities)])
    count, square, ratio = (
        weights @ sums[name][:, 1:-1] for name in ("cells", "square_db2", "ratio")
    )  # [1 + resample, bin]
    kept = count[0] >= _LEAST_SHARE * count[0].sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        rmse = np.sqrt(square[:, kept] / count[:, kept])
        fit = np.log(ratio[:, kept] / count[:, kept])
        fit_all = np.log(ratio.sum(axis=1) / count.sum(axis=1))
    edges = np.array(GAIN_EDGES_DB)
    return GainCurves(
        (edges[:-1] + edges[1:])[kept] / 2,
        count[0, kept] / count[0].sum(),
        rmse,
        np.where(np.isfinite(fit), fit, np.nan),
        fit_all,
        len(np.unique(cities)),
    )
