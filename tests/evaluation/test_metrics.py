"""Scores agree with scipy, and say what they should on cases with a known answer."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats

from skygain.evaluation.metrics import gaussian_crps, score
from skygain.posterior import Posterior


@pytest.mark.parametrize(("error", "std"), [(0.0, 1.0), (3.0, 2.0), (-5.0, 0.5)])
def test_crps_is_the_integral_of_the_squared_cdf_error(error: float, std: float) -> None:
    below = integrate.quad(lambda x: stats.norm(error, std).cdf(x) ** 2, -60, 0)[0]
    above = integrate.quad(lambda x: (1 - stats.norm(error, std).cdf(x)) ** 2, 0, 60)[0]
    assert gaussian_crps(np.array(error), np.array(std)) == pytest.approx(below + above, abs=1e-6)


def test_scores_of_a_calibrated_posterior(rng: np.random.Generator) -> None:
    std = rng.uniform(1, 6, (200, 200))
    truth = rng.normal(-100, std)
    everywhere = np.ones_like(truth, dtype=bool)
    scores = score(Posterior(np.full_like(truth, -100.0), std**2), truth, everywhere, ~everywhere)
    assert scores["gof"] == pytest.approx(0.0, abs=0.03)
    assert scores["coverage50"] == pytest.approx(0.5, abs=0.01)
    assert scores["coverage90"] == pytest.approx(0.9, abs=0.01)
    assert scores["nll"] == pytest.approx(-stats.norm(-100, std).logpdf(truth).mean())
    assert scores["rmse_db"] == pytest.approx(np.sqrt(np.mean((truth + 100) ** 2)))
    assert scores["expected_rmse_db"] == pytest.approx(scores["rmse_all_db"], rel=0.02)


def test_each_rmse_counts_its_own_cells() -> None:
    truth = np.zeros((1, 4))
    posterior = Posterior(np.array([[1.0, 2.0, 3.0, 50.0]]), np.ones((1, 4)))
    outdoor = np.array([[True, True, True, False]])
    visited = np.array([[True, False, False, False]])
    traced = np.array([[True, True, False, True]])
    scores = score(posterior, truth, outdoor, visited, traced)
    assert scores["rmse_db"] == pytest.approx(math.sqrt((4 + 9) / 2))
    assert scores["rmse_all_db"] == pytest.approx(math.sqrt((1 + 4 + 9) / 3))
    assert scores["rmse_ray_traced_db"] == 2.0
    assert scores["rmse_rest_db"] == 3.0


def test_unknown_truth_does_not_count() -> None:
    truth = np.array([[np.nan, 0.0]])
    everywhere = np.ones((1, 2), dtype=bool)
    scores = score(
        Posterior(np.array([[9.0, 1.0]]), np.ones((1, 2))), truth, everywhere, ~everywhere
    )
    assert scores["rmse_db"] == 1.0


def test_no_cell_left_gives_nan_not_an_error() -> None:
    everywhere = np.ones((1, 2), dtype=bool)
    scores = score(
        Posterior(np.zeros((1, 2)), np.ones((1, 2))), np.zeros((1, 2)), everywhere, everywhere
    )
    assert math.isnan(scores["rmse_db"])
    assert scores["rmse_all_db"] == 0.0
