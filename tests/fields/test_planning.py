from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.fields.planning import FALLBACK_RANGE_M, less_product, planning_field
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.posterior import HasStationaryPrior
from skygain.predictors import create_predictor
from skygain.predictors.kriging.known_source import KrigingPredictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario

CELLS = np.stack(np.indices((10, 10)), axis=-1).reshape(-1, 2)


@pytest.fixture
def scenario():
    return Scenario(
        City(Grid((10, 10), 4.0), np.zeros((10, 10), np.float32)), transmitter_m=(3.0, 5.0, 1.5)
    )


def test_equals_kriging_with_exact_and_noisy_readings(scenario, rng):
    parameters = KrigingParameters.known_trend(
        20.0, 60.0, sill_db2=90.0, range_m=25.0, nugget_db2=4.0
    )
    cells = CELLS[rng.choice(100, 12)]
    readings = Measurements.at(
        cells, rng.normal(-100, 5, 12), noise_std_db=np.where(np.arange(12) % 2, 3.0, 1.0)
    )
    belief = KrigingPredictor(parameters=parameters, refit=False).begin(scenario).updated(readings)
    assert isinstance(belief, HasStationaryPrior)
    ours = planning_field(belief).conditioned().covariance(CELLS, CELLS)
    np.testing.assert_allclose(ours, belief.posterior().covariance(CELLS), atol=1e-2)


def test_fewer_readings_never_understate_a_variance(scenario, rng):
    belief = create_predictor("kriging").begin(scenario)
    belief = belief.updated(
        Measurements.at(CELLS[rng.choice(100, 30, replace=False)], rng.normal(-100, 5, 30))
    )
    field = planning_field(belief)
    near = field.near(np.array([[2, 2]]), 8).conditioned().covariance(CELLS, CELLS)
    assert (np.diag(near) >= np.diag(field.conditioned().covariance(CELLS, CELLS)) - 1e-9).all()


def test_a_belief_of_variances_gets_the_fallback(variance_predictor, scenario):
    belief = variance_predictor.begin(scenario).updated(Measurements.at([[0, 0]], [-90.0]))
    covariance = planning_field(belief).conditioned().covariance(CELLS, CELLS)
    assert covariance[0].max() == 0.0  # measured, so certain
    assert covariance[11, 11] == pytest.approx(100.0)
    assert covariance[11, 12] == pytest.approx(100.0 * np.exp(-4.0 / FALLBACK_RANGE_M))


@pytest.mark.parametrize("sizes", [(3, 4, 5), (0, 4, 5), (3, 0, 5), (3, 4, 0)])
def test_a_product_is_taken_off_in_place(sizes, rng):
    k, n, m = sizes
    matrix = rng.random((n, m), dtype=np.float32)
    left, right = (rng.random((k, size), dtype=np.float32) for size in (n, m))
    expected = matrix - left.T @ right
    found = less_product(matrix, left, np.asfortranarray(right))
    assert found is matrix
    assert np.allclose(found, expected, atol=1e-5)
