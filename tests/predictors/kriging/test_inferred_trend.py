"""Kriging around an unknown transmitter against the same thing written out with dense matrices,
candidate by candidate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from skygain.city import City
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging import inferred_trend as kriging_inferred
from skygain.predictors.kriging.inferred_trend import HEIGHT_M, MARGIN_M
from skygain.predictors.kriging.known_source import inferred_kriging
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario
from skygain.testing import check_predictor

GRID = Grid((7, 9), 30.0)  # large cells keep the candidates few
PARAMETERS = KrigingParameters(
    (30.0, 70.0), ((90.0, 20.0), (20.0, 16.0)), sill_db2=60.0, range_m=80.0, nugget_db2=3.0
)


def scenario(**options) -> Scenario:
    height = np.zeros(GRID.shape)
    height[2:4, 3:6] = 20.0
    return Scenario(City(GRID, height), **options)


def gain_from(transmitter, rng, n):
    free = np.argwhere(scenario().flyable)
    cells = free[rng.permutation(len(free))[:n]]
    distance = np.hypot(np.linalg.norm(GRID.xy_m(cells) - transmitter, axis=1), 8.5)
    return Measurements.at(
        cells,
        30 - 70 * np.log10(distance) + 3 * rng.standard_normal(n),
        noise_std_db=rng.uniform(0, 1, n),
    )


def dense_mixture(data, uav_m, predicted_m):
    """Weights, mean, variance and covariance by the definition, with every candidate on its own."""
    margin = int(np.ceil(MARGIN_M / GRID.spacing_m))
    rows, cols = GRID.shape
    candidates = [
        (r, c)
        for r in range(-margin, rows + margin)
        for c in range(-margin, cols + margin)
        if not (0 <= r < rows and 0 <= c < cols and scenario().city.height_m[r, c] >= HEIGHT_M)
    ]
    measured, everywhere = GRID.xy_m(data.cell), GRID.xy_m(GRID.cells)

    def field(a, b, gap):
        d = np.sqrt(((a[:, None] - b[None]) ** 2).sum(-1) + gap**2)
        return PARAMETERS.sill_db2 * np.exp(-d / PARAMETERS.range_m) + PARAMETERS.nugget_db2 * (
            d == 0
        )

    K = field(measured, measured, 0.0) + np.diag(data.noise_std_db**2)
    C, prior = field(measured, everywhere, uav_m - predicted_m), field(everywhere, everywhere, 0.0)
    sigma, theta = np.array(PARAMETERS.trend_covariance), np.array(PARAMETERS.trend)
    weights, means, covariances = [], [], []
    for cell in candidates:
        t = GRID.xy_m(cell)
        H, P = (
            np.column_stack(
                [np.ones(len(q)), -0.5 * np.log10(((q - t) ** 2).sum(1) + (z - HEIGHT_M) ** 2)]
            )
            for q, z in ((measured, uav_m), (everywhere, predicted_m))
        )
        total = K + H @ sigma @ H.T
        weights.append(multivariate_normal(H @ theta, total).logpdf(data.gain_db))
        cross = C + H @ sigma @ P.T
        solved = np.linalg.solve(total, cross)
        means.append(P @ theta + solved.T @ (data.gain_db - H @ theta))
        covariances.append(prior + P @ sigma @ P.T - cross.T @ solved)
    weight = np.exp(np.array(weights) - max(weights))
    weight /= weight.sum()
    mean = weight @ np.array(means)
    deviation = np.array(means) - mean
    return (
        weight,
        mean,
        np.einsum("t,tij->ij", weight, covariances)
        + np.einsum("t,ti,tj->ij", weight, deviation, deviation),
    )


@pytest.mark.parametrize("predicted_m", [10.0, 25.0])
def test_it_is_the_mixture_over_all_candidates(predicted_m, rng, monkeypatch):
    monkeypatch.setattr(
        kriging_inferred, "NODES", 20_000
    )  # so many that the weights are met exactly enough
    data = gain_from([150.0, -40.0], rng, 14)
    setting = scenario(uav_altitude_m=10.0, prediction_altitude_m=predicted_m)
    belief = inferred_kriging(parameters=PARAMETERS, refit=False).begin(setting)
    for part in np.array_split(np.arange(14), 4):
        belief = belief.updated(data.taken(part))
    weight, mean, covariance = dense_mixture(data, 10.0, predicted_m)
    mine = belief.state.trend.weight
    assert mine[belief.state.trend.places.free.reshape(mine.shape)] == pytest.approx(
        weight, abs=1e-9
    )
    posterior = belief.posterior()
    unmeasured = ~data.visited(GRID.shape).ravel()
    np.testing.assert_allclose(posterior.mean_db.ravel()[unmeasured], mean[unmeasured], atol=1e-6)
    np.testing.assert_allclose(
        posterior.variance_db2.ravel()[unmeasured], np.diag(covariance)[unmeasured], rtol=0.01
    )
    cells = GRID.cells[unmeasured][:9]
    np.testing.assert_allclose(
        posterior.covariance(cells),
        covariance[np.ix_(unmeasured, unmeasured)][:9, :9],
        rtol=0.02,
        atol=0.3,
    )


def test_few_nodes_give_about_the_variance_of_all(rng):
    data = gain_from([150.0, -40.0], rng, 14)
    belief = inferred_kriging(parameters=PARAMETERS, refit=False).begin(scenario()).updated(data)
    _, _, covariance = dense_mixture(data, 10.0, 10.0)
    unmeasured = ~data.visited(GRID.shape).ravel()
    ratio = belief.posterior().variance_db2.ravel()[unmeasured] / np.diag(covariance)[unmeasured]
    assert 0.9 < np.mean(ratio) < 1.1
    assert ratio.min() > 0.6


def test_a_transmitter_outside_the_map_is_found(rng):
    grid = Grid((30, 30), 8.0)
    where = np.array([-60.0, 100.0])
    cells = grid.cells[rng.permutation(grid.size)[:150]]
    distance = np.hypot(np.linalg.norm(grid.xy_m(cells) - where, axis=1), 8.5)
    data = Measurements.at(cells, 32 - 73 * np.log10(distance) + 2 * rng.standard_normal(150))
    belief = inferred_kriging().begin(Scenario(City(grid, np.zeros(grid.shape)))).updated(data)
    weight = belief.state.trend.weight
    margin = belief.state.trend.places.margin
    centre = (np.indices(weight.shape).reshape(2, -1) @ weight.ravel())[::-1]
    assert np.linalg.norm((centre - margin) * 8.0 - where) < 25.0


def test_the_transmitter_never_stands_in_a_building():
    trend = inferred_kriging().begin(scenario()).state.trend
    margin = trend.places.margin
    inside = trend.weight[margin : margin + 7, margin : margin + 9]
    np.testing.assert_array_equal(inside[2:4, 3:6], 0.0)
    assert (inside[:2] > 0).all()


def test_it_ignores_a_transmitter_it_is_shown(rng):
    data = gain_from([150.0, -40.0], rng, 10)
    shown, hidden = (
        create_predictor("kriging-inferred")
        .begin(scenario(transmitter_m=place))
        .updated(data)
        .posterior()
        for place in ((10.0, 10.0, 1.5), None)
    )
    np.testing.assert_array_equal(shown.mean_db, hidden.mean_db)


@pytest.mark.parametrize("refit", [True, False])
def test_keeps_the_promises_of_a_predictor(refit):
    check_predictor(create_predictor("kriging-inferred", refit=refit))
