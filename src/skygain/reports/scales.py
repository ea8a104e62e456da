"""The colour scales of a survey: pictures and page show the same value in the same colour.

Scales are those of the end of the survey. What lies beyond an end is drawn in the end's colour, and
the colour bar has an arrow there.
"""

from __future__ import annotations

__all__ = ["error_reach", "gain_limits", "std_high"]

import numpy as np
from numpy.typing import NDArray

from skygain.reports.outcome import Outcome


def gain_limits(outcome: Outcome) -> tuple[float, float]:
    """Ends of the scale that truth and estimate share, whole dB; without a truth, readings and
    estimate."""
    truth = outcome.outdoor_truth_db
    shown = [outcome.measured_db if truth is None else truth, outcome.mean_db]
    return _whole(np.concatenate([m[np.isfinite(m)] for m in shown]), (1.0, 99.5))


def std_high(outcome: Outcome) -> float:
    """Upper end of the uncertainty's scale; the lower one is 0."""
    return _whole(outcome.std_db, (0.0, 99.5), low=0.0)[1]


def error_reach(outcome: Outcome) -> float:
    """The error's scale runs from minus this to this. 0 where there is no truth."""
    truth = outcome.outdoor_truth_db
    if truth is None:
        return 0.0
    return _whole(np.abs(outcome.mean_db - truth), (0.0, 98.0), low=0.0)[1]


def _whole(
    values: NDArray[np.floating], percent: tuple[float, float], low: float | None = None
) -> tuple[float, float]:
    """The percentiles of the finite values, widened to whole numbers at least 1 apart."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    ends = np.percentile(finite, percent)
    start = float(np.floor(ends[0])) if low is None else low
    return start, max(float(np.ceil(ends[1])), start + 1.0)
