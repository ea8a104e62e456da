"""The level of the readings, found by the operator's candidate maps.

A network that learned gains in dB needs readings at that level. With an unknown radiated power they
are gains plus a constant o. Each candidate transmitter c says what the gain is at the readings, so
the constant is judged together with the place: with independent errors of heavy tails at readings
that lie apart, any candidate and any constant equally likely before,

    p(c, o | y) ∝ Π_i t₅((y_i − o − m_ci)/s_ci)/s_ci,

and the level is its mean over c and o.
"""

from __future__ import annotations

__all__ = ["found_level_db", "raw_map"]

import numpy as np
from numpy.typing import NDArray

from skygain.predictors.networks.operator import OperatorBelief

Array = NDArray[np.float64]

APART_CELLS = 8
"""readings that count lie in different squares of so many cells a side"""
REACH_DB, STEP_DB = 90.0, 2.0
"""constants looked at: so far from the middle, so far apart"""
FREEDOM = 5.0
"""of Student's t"""


def raw_map(belief: OperatorBelief, altitude_m: float) -> tuple[Array, Array]:
    """Mean and standard deviation, ``[P]`` each, of the candidates' maps mixed by their
    probability, before any reading is put right."""
    weights = belief.weights()
    order = np.argsort(-weights, kind="stable")
    kept = order[: int(np.searchsorted(np.cumsum(weights[order]), 0.99)) + 1]
    weight = (weights[kept] / weights[kept].sum()).astype(np.float32)
    mean, std = belief.maps.whole(belief.candidates[kept], altitude_m)
    mixed = weight @ mean
    variance = weight @ (std**2 + (mean - mixed) ** 2)
    return mixed.astype(float), np.sqrt(variance.astype(float))


def found_level_db(
    belief: OperatorBelief, cells: NDArray[np.int64], gain_db: Array, middle_db: float
) -> float:
    """The constant o in readings ``gain_db[n]`` at raveled ``cells[n]``, looked for about
    ``middle_db``."""
    rows, cols = np.divmod(cells, belief.scenario.grid.shape[1])
    square = (rows // APART_CELLS) * 10_000 + cols // APART_CELLS
    _, first = np.unique(square, return_index=True)
    mean, std = belief.maps.at(belief.candidates, cells[first], belief.scenario.uav_altitude_m)
    error = (gain_db[first][:, None] - middle_db - mean).astype(np.float32)
    steps = np.arange(-REACH_DB, REACH_DB + STEP_DB, STEP_DB, dtype=np.float32)
    score = np.empty((len(steps), error.shape[1]))
    log_std = np.log(std).sum(axis=0)
    for k, step in enumerate(steps):
        z2 = ((error - step) / std) ** 2
        score[k] = -0.5 * (FREEDOM + 1) * np.log1p(z2 / FREEDOM).sum(axis=0) - log_std
    weight = np.exp(score - score.max()).sum(axis=1)
    return middle_db + float(steps @ weight / weight.sum())
