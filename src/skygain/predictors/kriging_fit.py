"""Fit the covariance of one survey to its own data, with the trained values as prior.

A variogram fitted to ten samples is worth little, and one fitted to a thousand needs no prior. The maximum a posteriori estimate
goes smoothly from one to the other:

    (φ, δ, ν, s) = argmax  log N(y | Hθ₀, φE(δ) + νI + N + s²HΣHᵀ) + log p(φ, δ, ν, s)

with log-normal priors around the trained φ, δ, ν. The trend's coefficients θ ~ N(θ₀, s²Σ) are integrated out. The factor s ≥ 1
widens their prior where the data contradict it, as they do when levels are not calibrated gains or the place is not a city.
"""

from __future__ import annotations

__all__ = ["fit_to_survey"]

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from skygain.predictors.kriging_parameters import KrigingParameters

Array = NDArray[np.float64]

WIDENING_SPREAD = 1.0
"""scale of the prior of log s, exponential"""
BOUND = 3.0
"""the fit stays within this many standard deviations of the trained values"""


def fit_to_survey(
    prior: KrigingParameters, start: KrigingParameters, xy_m: Array, gain_db: Array, noise_db2: Array, columns: Array
) -> KrigingParameters:
    """Parameters for the survey that gave ``gain_db[v]`` at ``xy_m[v, (x, y)]``.

    Args:
        prior: the trained values.
        start: where the search starts, for example the last fit.
        xy_m: distinct positions in metres.
        gain_db: values there.
        noise_db2: ``[v]`` variance of the noise of each.
        columns: ``[v, k]`` the trend's columns h(q) there.
    """
    distance = np.linalg.norm(xy_m[:, None] - xy_m[None], axis=-1)
    residual = gain_db - columns @ np.asarray(prior.trend)
    sigma = np.asarray(prior.trend_covariance)
    trend_part = columns @ sigma @ columns.T
    fits_nugget = prior.nugget_db2 > 0
    widens = bool(sigma.any())

    centre = np.log([prior.sill_db2, prior.range_m, prior.nugget_db2 if fits_nugget else 1.0])
    spread = np.asarray(prior.log_spread)

    def loss(z: Array) -> tuple[float, Array]:
        phi, delta, nu = np.exp(centre + spread * z[:3])
        nu = nu if fits_nugget else 0.0
        widening = np.exp(2 * z[3])
        shadowing = phi * np.exp(-distance / delta)
        trend = widening * trend_part
        covariance = shadowing + trend
        covariance[np.diag_indices_from(covariance)] += nu + noise_db2 + 1e-9 * phi
        factor = cho_factor(covariance, lower=True, overwrite_a=True, check_finite=False)
        inverse = cho_solve(factor, np.eye(len(residual)), check_finite=False)
        alpha = inverse @ residual
        value = 0.5 * residual @ alpha + np.log(np.diag(factor[0])).sum()
        slope = 0.5 * (inverse - np.outer(alpha, alpha))
        gradient = np.array(
            [
                np.vdot(slope, shadowing) * spread[0],
                np.vdot(slope, shadowing * (distance / delta)) * spread[1],
                np.trace(slope) * nu * spread[2],
                2 * np.vdot(slope, trend),
            ]
        )
        gradient[:3] += z[:3]
        gradient[3] += 1 / WIDENING_SPREAD
        return value + 0.5 * z[:3] @ z[:3] + z[3] / WIDENING_SPREAD, gradient

    first = (np.log([start.sill_db2, start.range_m, start.nugget_db2 if fits_nugget else 1.0]) - centre) / spread
    bounds = [(-BOUND, BOUND)] * 2 + [(-BOUND, BOUND) if fits_nugget else (0.0, 0.0), (0.0, 4.0) if widens else (0.0, 0.0)]
    found = minimize(
        loss, np.append(np.clip(first, -BOUND, BOUND), 0.0), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}
    )
    phi, delta, nu = np.exp(centre + spread * found.x[:3]).tolist()
    covariance = np.exp(2 * found.x[3]) * sigma
    return replace(
        prior,
        trend_covariance=tuple(tuple(row) for row in covariance.tolist()),
        sill_db2=phi,
        range_m=delta,
        nugget_db2=nu if fits_nugget else 0.0,
    )
