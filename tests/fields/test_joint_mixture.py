"""The mixture of beliefs has the moments of draws from them."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.fields.joint_mixture import mixed
from skygain.posterior import GaussianProcessPosterior, Posterior

SHAPE = (2, 3)
CELLS = np.argwhere(np.ones(SHAPE, dtype=bool))


def field(mean_db: float, length: float, rng: np.random.Generator) -> GaussianProcessPosterior:
    gap = np.hypot(*(CELLS[:, None] - CELLS[None]).transpose(2, 0, 1))
    covariance = 9.0 * np.exp(-gap / length)
    flat = {tuple(cell): k for k, cell in enumerate(CELLS.tolist())}

    def covariance_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        first, second = ([flat[tuple(c)] for c in cells.tolist()] for cells in (a, b))
        return covariance[np.ix_(first, second)]

    mean = mean_db + rng.standard_normal(SHAPE)
    return GaussianProcessPosterior(mean, np.full(SHAPE, 9.0), covariance_of)


def test_moments_are_those_of_draws(rng: np.random.Generator) -> None:
    beliefs = [field(-100.0, 1.0, rng), field(-92.0, 4.0, rng)]
    weight, factor = np.array([0.3, 0.7]), np.array([1.0, 2.0])
    found = mixed(beliefs, weight, factor, 4.0)
    draws = np.concatenate(
        [
            b.mean_db.ravel() + np.sqrt(a) * (b.sample_at(CELLS, rng, int(n)) - b.mean_db.ravel())
            for b, a, n in zip(beliefs, factor, 200_000 * weight, strict=True)
        ]
    )
    assert found.mean_db.ravel() == pytest.approx(draws.mean(axis=0), abs=0.05)
    assert found.covariance(CELLS) == pytest.approx(np.cov(draws.T), abs=0.3)
    assert np.diag(found.covariance(CELLS)) == pytest.approx(found.variance_db2.ravel())


def test_one_belief_alone_is_itself(rng: np.random.Generator) -> None:
    belief = field(-100.0, 2.0, rng)
    found = mixed([belief], np.array([5.0]), np.array([1.0]), 4.0)
    assert np.array_equal(found.mean_db, belief.mean_db)
    assert found.covariance(CELLS[:2], CELLS) == pytest.approx(belief.covariance(CELLS[:2], CELLS))


def test_a_belief_of_variances_alone_has_a_covariance_too(rng: np.random.Generator) -> None:
    alone = Posterior(np.zeros(SHAPE), rng.uniform(1, 4, SHAPE))
    found = mixed([alone, field(0.0, 2.0, rng)], np.ones(2), np.ones(2), 4.0).covariance(CELLS)
    assert np.linalg.eigvalsh(found).min() > 0


def test_a_cell_that_all_know_has_no_doubt_left() -> None:
    known = [Posterior(np.full(SHAPE, -90.0), np.zeros(SHAPE)) for _ in range(2)]
    found = mixed(known, np.ones(2), np.array([1.0, 3.0]), 4.0)
    assert not found.variance_db2.any()
    assert not found.covariance(CELLS).any()
