"""Fit the covariance of one survey to its own data, with the trained values as prior.

A variogram fitted to ten samples is worth little, and one fitted to a thousand needs no prior. The
maximum a posteriori estimate goes smoothly from one to the other:

    (φ, δ, ν) = argmax  log N(y | Hθ₀, φE(δ) + νI + N + HΣHᵀ) + log p(φ, δ, ν)

with log-normal priors around the trained φ, δ, ν. The trend's coefficients θ ~ N(θ₀, Σ) are
integrated out. A survey fits when it has 3, 5, 8, 12, … observations, half as many again each time.

There are several priors, each with its odds: the trained one, one without a path-loss line, and a
generic one for a place or a quantity unlike all that was trained on. The one is taken whose
estimate best explains observations that lie well apart, as soon as these are scattered over the
map; until then the likeliest. One street does not speak for a map.
"""

from __future__ import annotations

__all__ = [
    "fit_is_due",
    "fit_rows",
    "fit_to_survey",
    "likelihood_loss",
    "map_estimate",
    "survey_priors",
]

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize

from skygain.grid import Grid
from skygain.predictors.interpolators.readings import Readings
from skygain.predictors.kriging.parameters import (
    KrigingParameters,
    Trained,
    generic_parameters,
    trained_parameters,
)
from skygain.scenario import Scenario

Array = NDArray[np.float64]

LOCALITY = 0.25
"""share of the trained spread that the prior allows. Shadowing is not stationary: what a survey has
seen of a map so far differs from the rest of it, and a prior as wide as the maps differ from each
other lets the fit take the one for the other. Chosen on the validation cities"""
SEPARATION_M = 40.0
"""distance between the observations that choose between priors"""
GENERIC_LOG_ODDS = -2.0
"""log odds, before any data, that a place is nothing like the cities of the training"""
GENERIC_FLAT_LOG_ODDS = -3.75
"""the same where both levels are flat, so that a generic level costs nothing by itself"""
FLAT_LOG_ODDS = -3.0
"""log odds, before any data, that the gain does not follow the trained path-loss line at all; the
other way round where the transmitter is no street-level one or the receivers do not fly, since
nothing of that kind was trained on"""
TRAINED_TRANSMITTER_M = 5.0
"""height up to which a transmitter counts as one at street level; the trained ones stand at 1.5
m"""
TRAINED_RECEIVER_M = 5.0
"""altitude from which a receiver counts as flying; the trained ones fly at 10 to 30 m"""
SPREAD_OUT = 0.35
"""how widely the observations must be scattered, in terms of an even spread, before they may choose
between priors"""
FIRST_FIT = 3
"""observations at which the covariance is fitted for the first time"""
FIT_GROWTH = 1.5
"""it is fitted again when there are this many times as many"""
FIT_ROWS = 300
"""observations used for one fit; more of them change the estimate little and cost their cube"""
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
    return float(loss), np.array(
        [correlated.sum(), np.vdot(correlated, scaled), nu * np.trace(slope)]
    )


def survey_priors(
    trend: str, scenario: Scenario, level: str = "any", source: Trained | None = None
) -> list[tuple[KrigingParameters, float]]:
    """What a survey may start from, the likeliest first, with the logarithm of the odds.

    The trained parameters; for the log-distance trend also ones without a path-loss line; and
    generic ones. Without a transmitter the level is flat, since readings may be in dBm, or of any
    transmitter; ``level="gain"`` says that they are gains like the trained ones. ``source`` stands
    in for the parameters that ship.
    """
    trained, generic = (
        trained_parameters(trend, scenario.prediction_altitude_m, source),
        generic_parameters(trend),
    )
    if trend != "log-distance":
        if level == "gain":
            return [(trained, 0.0), (generic, GENERIC_LOG_ODDS)]
        return [
            (trained.with_flat_level, 0.0),
            (generic.with_flat_level, GENERIC_FLAT_LOG_ODDS),
        ]
    flat = trained_parameters("constant", scenario.prediction_altitude_m, source)
    flat = replace(
        flat,
        trend=(*flat.trend, 0.0),
        trend_covariance=((flat.trend_covariance[0][0], 0.0), (0.0, 0.0)),
    )
    transmitter = scenario.transmitter_m
    street_level = transmitter is None or transmitter[2] <= TRAINED_TRANSMITTER_M
    if street_level and scenario.uav_altitude_m >= TRAINED_RECEIVER_M:
        return [(trained, 0.0), (flat, FLAT_LOG_ODDS), (generic, GENERIC_LOG_ODDS)]
    return [(flat, 0.0), (trained, FLAT_LOG_ODDS), (generic, GENERIC_LOG_ODDS)]


def fit_is_due(size: int, fitted_at: int) -> bool:
    """Whether ``size`` observations call for a fit when the last one was made with
    ``fitted_at``."""
    return size >= max(FIRST_FIT, FIT_GROWTH * fitted_at)


def fit_rows(grid: Grid, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which of the readings at raveled ``cells[n]`` enter a fit. It depends on the cells alone, so
    the order of the readings does not matter."""
    return np.argsort(np.random.default_rng(0).permutation(grid.size)[cells])[:FIT_ROWS]


def fit_to_survey(
    grid: Grid,
    priors: Sequence[tuple[KrigingParameters, float]],
    readings: Readings,
    columns: Callable[[NDArray[np.int64]], Array],
) -> KrigingParameters:
    """Parameters for the survey that gave ``readings``.

    Args:
        grid: the map.
        priors: what the survey may start from, the likeliest first, each with the logarithm of its
            odds.
        readings: values at distinct cells.
        columns: gives the trend's columns ``[n, k]`` at raveled ``cells[n]``.
    """
    rows = fit_rows(grid, readings.cells)
    cells, gain, noise = readings.cells[rows], readings.gain_db[rows], readings.noise_db2[rows]
    h, xy = columns(cells), grid.xy_m(grid.cells[cells])
    distance = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    prior = priors[0][0]
    if len(priors) > 1 and _spread(xy, grid) >= SPREAD_OUT:
        far = _apart(distance)
        losses = [
            map_estimate(p, distance[np.ix_(far, far)], gain[far], noise[far], h[far])[0] - odds
            for p, odds in priors
        ]
        prior = priors[int(np.argmin(losses))][0]
    return map_estimate(prior, distance, gain, noise, h)[1]


def _spread(xy_m: Array, grid: Grid) -> float:
    """How widely positions are scattered, 1 when evenly over the whole map."""
    if len(xy_m) < 3:  # a point or a line
        return 0.0
    rows, cols = grid.shape
    even = rows * cols * grid.spacing_m**2 / 12
    return float(np.sqrt(max(np.linalg.det(np.cov(xy_m.T)), 0.0)) / even)


def _apart(distance_m: Array) -> list[int]:
    """Observations that are at least `SEPARATION_M` from each other, picked in their order."""
    taken: list[int] = []
    free = np.ones(len(distance_m), dtype=bool)
    while free.any():
        taken.append(int(np.argmax(free)))
        free &= distance_m[taken[-1]] >= SEPARATION_M
    return taken


def map_estimate(
    prior: KrigingParameters, distance_m: Array, gain_db: Array, noise_db2: Array, columns: Array
) -> tuple[float, KrigingParameters]:
    """The loss and the estimate under one prior.

    Args:
        prior: the trained values and their spread.
        distance_m: ``[v, v]`` between the observations.
        gain_db: ``[v]`` values.
        noise_db2: ``[v]`` variance of the noise of each.
        columns: ``[v, k]`` the trend's columns h(q).
    """
    residual = gain_db - columns @ np.asarray(prior.trend)
    trend_part = columns @ np.asarray(prior.trend_covariance) @ columns.T
    # A nugget of zero stays zero: its logarithm is one that does not matter.
    centre = np.log([prior.sill_db2, prior.range_m, prior.nugget_db2 or 1e-9 * prior.sill_db2])
    spread = LOCALITY * np.asarray(prior.log_spread)

    def loss(z: Array) -> tuple[float, Array]:
        value, gradient = likelihood_loss(
            centre + spread * z, distance_m, residual, noise_db2, trend_part
        )
        return value + 0.5 * float(z @ z), gradient * spread + z

    bounds = [
        (-BOUND, BOUND),
        (-BOUND, BOUND),
        (-BOUND, BOUND) if prior.nugget_db2 > 0 else (0.0, 0.0),
    ]
    found = minimize(
        loss, np.zeros(3), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}
    )
    phi, delta, nu = np.exp(centre + spread * found.x).tolist()
    fitted = replace(
        prior, sill_db2=phi, range_m=delta, nugget_db2=nu if prior.nugget_db2 > 0 else 0.0
    )
    return float(found.fun), fitted
