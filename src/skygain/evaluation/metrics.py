"""How good a posterior is, once the truth is known.

Every score is taken over cells that are outdoors at the prediction altitude; the headline RMSE
leaves out visited cells, which are exact when the measurements are. See docs/evaluation.md for the
equations.
"""

from __future__ import annotations

__all__ = ["GAIN_EDGES_DB", "VARIANCE_FLOOR_DB2", "by_gain", "gaussian_crps", "gof", "score"]

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from skygain.posterior import Posterior

VARIANCE_FLOOR_DB2 = 1e-4
"""a predicted variance below this counts as this, so that one overconfident cell cannot make a
score infinite"""

GAIN_EDGES_DB = tuple(float(edge) for edge in range(-240, -39, 10))
"""edges of the bins of true gain; a first and a last bin hold what lies beyond"""


def gaussian_crps(error: NDArray[np.float64], std: NDArray[np.float64]) -> NDArray[np.float64]:
    """Continuous ranked probability score of normal predictions, elementwise, in the unit of
    ``error``.

    CRPS = σ (z (2Φ(z) − 1) + 2φ(z) − 1/√π), z = error/σ (Gneiting and Raftery 2007, eq. 21).
    """
    z = error / std
    return std * (
        z * (2 * ndtr(z) - 1) + np.sqrt(2 / np.pi) * np.exp(-0.5 * z * z) - 1 / np.sqrt(np.pi)
    )


def gof(mean_ratio: float) -> float:
    """Goodness of fit: natural log of the mean of squared error over predicted variance; 0 is
    ideal, above 0 is overconfident."""
    return math.log(mean_ratio) if mean_ratio > 0 else -math.inf


def by_gain(
    posterior: Posterior, truth_db: NDArray[np.floating], cells: NDArray[np.bool_]
) -> dict[str, list[float]]:
    """Over the known ``cells[row, col]`` in each bin of true gain (`GAIN_EDGES_DB`): how many, the
    sum of squared errors in dB², and the sum of squared error over predicted variance."""
    cells = cells & np.isfinite(truth_db)
    truth = truth_db[cells].astype(float)
    square = (posterior.mean_db[cells] - truth) ** 2
    ratio = square / np.maximum(posterior.variance_db2[cells], VARIANCE_FLOOR_DB2)
    which = np.digitize(truth, GAIN_EDGES_DB)
    sums = {"cells": np.ones_like(truth), "square_db2": square, "ratio": ratio}
    return {
        name: np.bincount(which, values, minlength=len(GAIN_EDGES_DB) + 1).tolist()
        for name, values in sums.items()
    }


def score(
    posterior: Posterior,
    truth_db: NDArray[np.floating],
    outdoor: NDArray[np.bool_],
    visited: NDArray[np.bool_],
    ray_traced: NDArray[np.bool_] | None = None,
) -> dict[str, float]:
    """All scores of a posterior against ``truth_db[row, col]``; cells where the truth is NaN do not
    count.

    Returns a dictionary (a score over no cells at all is NaN):

    - ``rmse_db``: root mean squared error over unvisited outdoor cells
    - ``rmse_all_db``: the same over all outdoor cells
    - ``rmse_ray_traced_db``, ``rmse_rest_db``: over unvisited outdoor cells that a ray reached, and
      over the others
    - ``error_ratio``: mean of squared error over predicted variance (its log is the goodness of fit
      ``gof``)
    - ``nll``: mean negative log likelihood in nats per cell; ``crps_db``: mean continuous ranked
      probability score
    - ``coverage50``, ``coverage90``: share of cells inside the 50 % and 90 % interval
    - ``expected_rmse_db``: root mean square of the predicted standard deviation over all outdoor
      cells
    """
    known = np.isfinite(truth_db)
    error = np.where(known, posterior.mean_db - np.where(known, truth_db, 0.0), np.nan)
    everywhere = outdoor & known
    unseen = everywhere & ~visited

    def rmse(cells: NDArray[np.bool_]) -> float:
        return float(np.sqrt(np.mean(error[cells] ** 2))) if cells.any() else math.nan

    scores = {"rmse_db": rmse(unseen), "rmse_all_db": rmse(everywhere)}
    if ray_traced is not None:
        scores |= {
            "rmse_ray_traced_db": rmse(unseen & ray_traced),
            "rmse_rest_db": rmse(unseen & ~ray_traced),
        }
    if unseen.any():
        e, variance = error[unseen], np.maximum(posterior.variance_db2[unseen], VARIANCE_FLOOR_DB2)
        std = np.sqrt(variance)
        ratio = float(np.mean(e**2 / variance))
        scores |= {
            "error_ratio": ratio,
            "gof": gof(ratio),
            "nll": float(np.mean(0.5 * (np.log(2 * np.pi * variance) + e**2 / variance))),
            "crps_db": float(np.mean(gaussian_crps(e, std))),
            "coverage50": float(np.mean(np.abs(e) <= 0.6744897501960817 * std)),
            "coverage90": float(np.mean(np.abs(e) <= 1.6448536269514722 * std)),
        }
    else:
        scores |= dict.fromkeys(
            ("error_ratio", "gof", "nll", "crps_db", "coverage50", "coverage90"), math.nan
        )
    scores["expected_rmse_db"] = posterior.expected_rmse_db(outdoor)
    return scores
