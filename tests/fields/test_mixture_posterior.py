from __future__ import annotations

import numpy as np
import pytest

from skygain.fields.mixture_posterior import MixturePosterior
from skygain.fields.residual_field import CorrelationModel, ResidualField

SHAPE, SPACING = (5, 6), 4.0


@pytest.fixture
def posterior(rng):
    """Three models on 30 cells with four readings taken in."""
    residual = ResidualField.empty(CorrelationModel(), SHAPE, SPACING)
    residual, _ = residual.grown(np.array([0, 15, 16, 25]), np.zeros(4))
    weight = np.array([0.5, 0.3, 0.2], dtype=np.float32)
    means = rng.normal(-100, 10, (3, 30)).astype(np.float32)
    stds = rng.uniform(5, 12, (3, 30)).astype(np.float32)
    mean = weight @ means
    variance = 1.3 * (weight @ (stds**2 * residual.left + (means - mean) ** 2))
    known = np.zeros(30, dtype=bool)
    known[7] = True
    variance[7] = 0.0
    return MixturePosterior(
        mean.reshape(SHAPE),
        variance.reshape(SHAPE),
        weight,
        means,
        stds,
        residual.table,
        residual.W,
        1.0,
        known,
        1.3,
    )


def test_diagonal_is_the_variance(posterior):
    cells = np.argwhere(np.ones(SHAPE, dtype=bool))
    assert np.allclose(
        np.diag(posterior.covariance(cells)), posterior.variance_db2.ravel(), rtol=1e-3, atol=1e-3
    )


def test_covariance_is_that_of_draws_from_the_mixture(posterior, rng):
    cells = np.array([(0, 1), (2, 2), (3, 3), (4, 5)])
    flat = cells @ (SHAPE[1], 1)
    gap = np.abs(cells[:, None] - cells[None])
    correlation = (
        posterior.correlation[gap[..., 0], gap[..., 1]]
        - posterior.whitened[:, flat].T @ posterior.whitened[:, flat]
    )
    field = rng.multivariate_normal(np.zeros(4), correlation, size=400_000)
    model = rng.choice(3, p=[0.5, 0.3, 0.2], size=len(field))
    draws = posterior.means_db[model][:, flat] + posterior.stds_db[model][:, flat] * field
    assert np.allclose(1.3 * np.cov(draws.T), posterior.covariance(cells), atol=2.0)


def test_it_is_a_covariance(posterior):
    cells = np.argwhere(np.ones(SHAPE, dtype=bool))
    whole = posterior.covariance(cells)
    assert np.allclose(whole, whole.T, atol=1e-3)
    assert np.linalg.eigvalsh(whole).min() > -1e-2
    assert np.allclose(posterior.covariance(cells[:7], cells[20:]), whole[:7, 20:], atol=1e-4)
    assert not whole[7].any()
