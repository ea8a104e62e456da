"""IDW and kNN: exact where measured, equal to their definitions elsewhere, and honest about their error."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.errors import InputError
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging_parameters import KrigingParameters
from skygain.scenario import Scenario
from skygain.testing import check_predictor

GRID = Grid((19, 14), 4.0)
SCENARIO = Scenario(City(GRID, np.zeros(GRID.shape)))


def readings(rng, n, **options) -> Measurements:
    return Measurements.at(rng.permutation(GRID.cells)[:n], -100 + 10 * rng.standard_normal(n), **options)


def distances(data):
    return np.linalg.norm(GRID.cells[:, None] - data.cell[None], axis=-1)


@pytest.mark.parametrize("name", ["idw", "knn"])
def test_keeps_the_promises_of_a_predictor(name):
    check_predictor(create_predictor(name))


@pytest.mark.parametrize("power", [1.0, 2.0, 3.5])
def test_idw_is_the_weighted_mean_of_its_definition(power, rng):
    data = readings(rng, 40)
    mean = create_predictor("idw", power=power).begin(SCENARIO).updated(data).posterior().mean_db
    distance = distances(data)
    free = distance.min(axis=1) > 0
    weight = distance[free] ** -power
    np.testing.assert_allclose(mean.ravel()[free], weight @ data.gain_db / weight.sum(axis=1), atol=1e-8)


@pytest.mark.parametrize("k", [1, 5, 99])
def test_knn_is_the_mean_of_the_nearest(k, rng):
    """Where the k-th and the next reading are equally near, the definition leaves the choice open; those cells are left out."""
    data = readings(rng, 40)
    mean = create_predictor("knn", k=k).begin(SCENARIO).updated(data).posterior().mean_db.ravel()
    distance = distances(data)
    order = np.argsort(distance, axis=1)
    near = np.take_along_axis(distance, order, axis=1)
    clear = (near[:, 0] > 0) & ((near[:, k - 1] < near[:, k]) if k < 40 else True)
    np.testing.assert_allclose(mean[clear], data.gain_db[order[:, : min(k, 40)]].mean(axis=1)[clear])


@pytest.mark.parametrize("name", ["idw", "knn"])
def test_the_variance_is_about_the_squared_error(name):
    """On fields of a known covariance the mean squared error over variance is near 1."""
    rng = np.random.default_rng(5)
    grid = Grid((40, 40), 4.0)
    scenario = Scenario(City(grid, np.zeros(grid.shape)))
    xy = grid.xy_m(grid.cells)
    truth = KrigingParameters.known_trend(-100.0, sill_db2=150.0, range_m=30.0)
    distance = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    root = np.linalg.cholesky(truth.sill_db2 * np.exp(-distance / truth.range_m) + 1e-9 * np.eye(len(xy)))
    ratios = []
    for _ in range(6):
        field = -100 + root @ rng.standard_normal(len(xy))
        cells = rng.permutation(len(xy))[:120]
        posterior = create_predictor(name).begin(scenario).updated(Measurements.at(grid.cells[cells], field[cells])).posterior()
        free = np.setdiff1d(np.arange(len(xy)), cells)
        error = posterior.mean_db.ravel()[free] - field[free]
        ratios.append(np.mean(error**2 / posterior.variance_db2.ravel()[free]))
    assert 0.6 < np.mean(ratios) < 1.6


def test_a_noisy_reading_keeps_its_noise_as_variance():
    data = Measurements.at([[3, 4]], [-90.0], noise_std_db=2.0)
    posterior = create_predictor("idw").begin(SCENARIO).updated(data).posterior()
    assert posterior.mean_db[3, 4] == -90.0
    assert posterior.variance_db2[3, 4] == 4.0


@pytest.mark.parametrize(("name", "options"), [("idw", {"power": 0.0}), ("idw", {"power": 9.0}), ("knn", {"k": 0})])
def test_senseless_options_are_refused(name, options):
    with pytest.raises(InputError):
        create_predictor(name, **options)
