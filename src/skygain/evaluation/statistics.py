"""Intervals for means over surveys, by resampling cities.

Surveys in one city share its buildings, so whole cities are drawn with replacement (a cluster
bootstrap). Comparisons are paired: the difference is taken survey by survey, then averaged.
"""

from __future__ import annotations

__all__ = ["Interval", "bootstrap_mean", "city_weights", "flight_saved"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % bootstrap interval."""

    mean: float
    """over surveys"""
    low: float
    """2.5 % quantile over resampled cities, NaN for a single city"""
    high: float
    """97.5 % quantile"""

    def __str__(self) -> str:
        return self.text()

    def text(self, style: str = ".2f") -> str:
        """As tables print it; a dash stands for bounds that one city cannot give."""
        if np.isnan(self.low):
            return f"{self.mean:{style}} [–]"
        return f"{self.mean:{style}} [{self.low:{style}}, {self.high:{style}}]"


def city_weights(cities: ArrayLike, resamples: int = 4000, seed: int = 0) -> NDArray[np.float64]:
    """``[resample, survey]`` how often each survey counts when its city is drawn with replacement;
    rows sum to 1."""
    names, index = np.unique(np.asarray(cities), return_inverse=True)
    draws = np.random.default_rng(seed).multinomial(
        len(names), np.full(len(names), 1 / len(names)), size=resamples
    )
    weights = draws[:, index].astype(float)
    return weights / weights.sum(axis=1, keepdims=True)


def bootstrap_mean(
    values: ArrayLike, cities: ArrayLike, *, resamples: int = 4000, seed: int = 0
) -> Interval:
    """Mean of ``values[survey]`` with its 95 % interval, drawing ``cities[survey]`` with
    replacement; NaN values are left out. One city says nothing about others: its bounds are NaN.

    >>> bootstrap_mean([1.0, 1.0, 1.0], [0, 1, 1])
    Interval(mean=1.0, low=1.0, high=1.0)
    >>> print(bootstrap_mean([1.0, 2.0], [7, 7]))
    1.50 [–]
    """
    values, cities = np.asarray(values, dtype=float), np.asarray(cities)
    kept = np.isfinite(values)
    if not kept.any():
        return Interval(np.nan, np.nan, np.nan)
    if len(np.unique(cities[kept])) < 2:
        return Interval(float(values[kept].mean()), np.nan, np.nan)
    means = city_weights(cities[kept], resamples, seed) @ values[kept]
    low, high = np.quantile(means, [0.025, 0.975])
    return Interval(float(values[kept].mean()), float(low), float(high))


def flight_saved(steps: ArrayLike, ours: ArrayLike, rival: ArrayLike) -> float:
    """The rival's steps divided by the steps we need for the error the rival ends with.

    Args:
        steps: ``[k]`` increasing steps at which both mean curves are known.
        ours: ``[k]`` our mean RMSE.
        rival: ``[k]`` the rival's.

    Returns:
        ``steps[-1] / s`` with s the first (linearly interpolated) step at which ours is as low as
        the rival's last value; NaN when we never get there.

    >>> flight_saved([0, 100, 200], [20.0, 10.0, 5.0], [20.0, 15.0, 10.0])
    2.0
    """
    steps, ours = np.asarray(steps, dtype=float), np.asarray(ours, dtype=float)
    goal = float(np.asarray(rival, dtype=float)[-1])
    below = np.flatnonzero(ours <= goal)
    if len(below) == 0:
        return float("nan")
    k = int(below[0])
    if k == 0:
        return float(steps[-1] / steps[0]) if steps[0] > 0 else float("inf")
    share = (ours[k - 1] - goal) / (ours[k - 1] - ours[k])
    return float(steps[-1] / (steps[k - 1] + share * (steps[k] - steps[k - 1])))
