from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.propagation.gudmundson import gudmundson_gain_db, shadowing_db


def test_the_field_has_the_covariance_it_promises(rng: np.random.Generator) -> None:
    grid = Grid((8, 11), 5.0)
    draws = np.array(
        [shadowing_db(grid, rng, phi_db2=9.0, delta_m=20.0).ravel() for _ in range(8_000)]
    )
    where = grid.xy_m(grid.cells)
    expected = 9.0 * np.exp(-np.linalg.norm(where[:, None] - where[None], axis=-1) / 20.0)
    empirical = draws.T @ draws / len(draws)
    # Standard error of a covariance estimate: sqrt((c² + φ²) / n); all 7,744 entries stay within
    # 5.5 of them.
    assert (np.abs(empirical - expected) < 5.5 * np.sqrt((expected**2 + 81) / len(draws))).all()
    assert np.abs(draws.mean(axis=0)).max() < 5 * 3 / np.sqrt(len(draws))


def test_whitened_fields_are_standard_normal(rng: np.random.Generator) -> None:
    """scipy's multivariate normal would draw the same law: the Cholesky-whitened field is white."""
    grid = Grid((9, 9), 4.0)
    where = grid.xy_m(grid.cells)
    covariance = 4.0 * np.exp(-np.linalg.norm(where[:, None] - where[None], axis=-1) / 57.0)
    root = np.linalg.cholesky(covariance)
    white = np.concatenate(
        [np.linalg.solve(root, shadowing_db(grid, rng, phi_db2=4.0).ravel()) for _ in range(200)]
    )
    assert stats.kstest(white, "norm").pvalue > 1e-3
    distances = [
        np.sum(
            stats.multivariate_normal(cov=covariance).logpdf(
                shadowing_db(grid, rng, phi_db2=4.0).ravel()
            )
        )
        for _ in range(200)
    ]
    own = stats.multivariate_normal(cov=covariance).logpdf(
        stats.multivariate_normal(cov=covariance).rvs(200, random_state=np.random.default_rng(1))
    )
    assert stats.ks_2samp(distances, own).pvalue > 1e-3


@pytest.mark.parametrize(
    ("shape", "delta"), [((3, 200), 150.0), ((8, 8), 400.0), ((1, 1), 57.0), ((121, 121), 57.0)]
)
def test_any_map_and_distance_that_fit_are_drawn(shape: tuple[int, int], delta: float) -> None:
    field = shadowing_db(Grid(shape, 4.0), np.random.default_rng(0), delta_m=delta)
    assert field.shape == shape
    assert np.isfinite(field).all()


def test_the_mean_falls_with_the_logarithm_of_the_distance() -> None:
    grid = Grid((40, 40), 4.0)
    gain = gudmundson_gain_db(
        grid,
        (0.0, 0.0, 1.5),
        10.0,
        np.random.default_rng(0),
        alpha_db=20.0,
        beta_db_per_decade=60.0,
        phi_db2=0.0,
    )
    assert gain[10, 20] == pytest.approx(20 - 60 * np.log10(np.sqrt(80**2 + 40**2 + 8.5**2)))
    city = City(grid=grid, height_m=np.zeros((40, 40)))
    assert np.array_equal(
        gudmundson_gain_db(city, (0, 0, 1.5), 10.0, np.random.default_rng(3)),
        gudmundson_gain_db(grid, (0, 0, 1.5), 10.0, np.random.default_rng(3)),
    )


def test_unusable_parameters_are_named(rng: np.random.Generator) -> None:
    for wrong in ({"phi_db2": -1.0}, {"delta_m": 0.0}, {"delta_m": np.inf}, {"delta_m": 1e7}):
        with pytest.raises(InputError):
            shadowing_db(Grid((5, 5), 1.0), rng, **wrong)
