"""Fit the covariance of one survey to its own data, with the trained values as prior.

A variogram fitted to ten samples is worth little, and one fitted to a thousand needs no prior. The maximum a posteriori estimate
goes smoothly from one to the other:

    (φ, δ, ν) = argmax  log N(y | Hθ₀, φE(δ) + νI + N + HΣHᵀ) + log p(φ, δ, ν)

with log-normal priors around the trained φ, δ, ν. The trend's coefficients θ ~ N(θ₀, Σ) are integrated out.
Several priors may be given, each with its odds; the one whose estimate best explains observations that lie well apart is taken.
"""

from __future__ import annotations

__all__ = ["fit_to_survey", "likelihood_loss"]

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize

from skygain.predictors.kriging_parameters import KrigingParameters

Array = NDArray[np.float64]

LOCALITY = 0.25
"""share of the trained spread that the prior allows. Shadowing is not stationary: what a survey has seen of a map so far differs
from the rest of it, and a prior as wide as the maps differ from each other lets the fit take the one for the other. Chosen on
the validation cities"""
SEPARATION_M = 40.0
"""observations that choose between priors are at least this far apart, so that one street does not speak for the whole map"""
BOUND = 3.0
"""the fit stays within this many standard deviations of the trained values"""


def likelihood_loss(
    logs: Array, distance_m: Array, residual_db: Array, noise_db2: Array, trend_part_db2: Array
) -> tuple[float, Array]:
    """−log N(residual | 0, K) up to a constant, and its gradient in (log φ, log δ, log ν).

    Args:
        logs: log φ, log δ, log ν.
        distance_m: ``[v, v]`` between the observations.
        residual_db: ``[v]`` what the trend's prior mean leaves.
        noise_db2: ``[v]`` variance of the measurement noise.
        trend_part_db2: ``[v, v]`` HΣHᵀ.
    """
    phi, delta, nu = np.exp(logs)
    scaled = distance_m / delta
    shadowing = phi * np.exp(-scaled)
    covariance = shadowing + trend_part_db2
    covariance[np.diag_indices_from(covariance)] += nu + noise_db2 + 1e-9 * phi
    root, _ = lapack.dpotrf(covariance.T, lower=1, overwrite_a=1, clean=0)
    lower, _ = lapack.dpotri(root, lower=1)
    inverse = np.tril(lower) + np.tril(lower, -1).T
    alpha = inverse @ residual_db
    loss = 0.5 * residual_db @ alpha + np.log(np.diag(root)).sum()
    slope = 0.5 * (inverse - np.outer(alpha, alpha))
    correlated = slope * shadowing
    return float(loss), np.array([correlated.sum(), np.vdot(correlated, scaled), nu * np.trace(slope)])


def fit_to_survey(
    priors: Sequence[tuple[KrigingParameters, float]], xy_m: Array, gain_db: Array, noise_db2: Array, columns: Array
) -> KrigingParameters:
    """Parameters for the survey that gave ``gain_db[v]`` at ``xy_m[v, (x, y)]``.

    Args:
        priors: what a survey may start from, each with the logarithm of its odds.
        xy_m: distinct positions in metres.
        gain_db: values there.
        noise_db2: ``[v]`` variance of the noise of each.
        columns: ``[v, k]`` the trend's columns h(q) there.
    """
    distance = np.linalg.norm(xy_m[:, None] - xy_m[None], axis=-1)
    prior = priors[0][0]
    if len(priors) > 1:
        far = _apart(distance)
        distant = distance[np.ix_(far, far)]
        losses = [_fit(p, distant, gain_db[far], noise_db2[far], columns[far])[0] - odds for p, odds in priors]
        prior = priors[int(np.argmin(losses))][0]
    return _fit(prior, distance, gain_db, noise_db2, columns)[1]


def _apart(distance_m: Array) -> list[int]:
    """Observations that are at least `SEPARATION_M` from each other, picked in their order."""
    taken: list[int] = []
    free = np.ones(len(distance_m), dtype=bool)
    while free.any():
        taken.append(int(np.argmax(free)))
        free &= distance_m[taken[-1]] >= SEPARATION_M
    return taken


def _fit(
    prior: KrigingParameters, distance: Array, gain_db: Array, noise_db2: Array, columns: Array
) -> tuple[float, KrigingParameters]:
    """The loss and the estimate under one prior."""
    residual = gain_db - columns @ np.asarray(prior.trend)
    trend_part = columns @ np.asarray(prior.trend_covariance) @ columns.T
    # A nugget of zero stays zero: its logarithm is one that does not matter.
    centre = np.log([prior.sill_db2, prior.range_m, prior.nugget_db2 or 1e-9 * prior.sill_db2])
    spread = LOCALITY * np.asarray(prior.log_spread)

    def loss(z: Array) -> tuple[float, Array]:
        value, gradient = likelihood_loss(centre + spread * z, distance, residual, noise_db2, trend_part)
        return value + 0.5 * float(z @ z), gradient * spread + z

    bounds = [(-BOUND, BOUND), (-BOUND, BOUND), (-BOUND, BOUND) if prior.nugget_db2 > 0 else (0.0, 0.0)]
    found = minimize(loss, np.zeros(3), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40})
    phi, delta, nu = np.exp(centre + spread * found.x).tolist()
    fitted = replace(prior, sill_db2=phi, range_m=delta, nugget_db2=nu if prior.nugget_db2 > 0 else 0.0)
    return float(found.fun), fitted
