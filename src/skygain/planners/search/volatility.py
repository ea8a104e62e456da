"""Where the gain is rougher than Kriging believes.

A stationary kernel gives every unvisited cell the same doubt. Real gain does not: near line of
sight and far out in deep shadow it is smooth, and in between, where streets light up and go dark,
it jumps. `volatility` is the squared error of Kriging over its variance by the gain it predicts;
as a weight per cell it turns the sum of variances into the expected squared error. Beliefs whose
variances differ from place to place by themselves need no such weight.

The weights were measured on the training cities with an earlier fit of Kriging. The fit of today
gives a flatter curve, with which planned flights end worse: see docs/planners.md.
"""

from __future__ import annotations

__all__ = ["volatility"]

import numpy as np
from numpy.typing import ArrayLike, NDArray

GAIN_DB = np.array(
    [-165.0, -160.0, -156.9, -153.6, -149.9, -145.5, -139.2, -129.7, -114.7, -95.0, -65.0]
)
RATIO = np.array([0.17, 0.18, 0.22, 0.30, 0.45, 0.69, 1.11, 1.69, 1.86, 1.40, 1.06])


def volatility(mean_db: ArrayLike) -> NDArray[np.float64]:
    """Expected squared error of Kriging over its variance where it predicts the gain ``mean_db``,
    in that shape."""
    return np.interp(np.asarray(mean_db, dtype=float), GAIN_DB, RATIO)
