"""Predictors of the papers that the first one cites."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging.malmirchegini import estimated
from skygain.testing.predictors import check_predictor, example_scenario

NAMES = ("malmirchegini", "fixed-rank-kriging", "random-forest")


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    if request.param == "random-forest":
        pytest.importorskip("sklearn", reason="needs the extra 'rivals'")
    return request.param


def predictor(name):
    return create_predictor(name, **({"trees": 20} if name == "random-forest" else {}))


def test_they_keep_the_promises_of_a_predictor(name):
    check_predictor(predictor(name))


def test_they_beat_the_mean_of_the_readings_and_know_their_error(name, rng):
    scenario = example_scenario((30, 30))
    xy = scenario.grid.xy_m(scenario.grid.cells)
    x, y = xy.T
    away = np.hypot(*(xy - np.array(scenario.transmitter_m[:2])).T)
    truth = -40 - 25 * np.log10(np.maximum(away, 3)) + 8 * np.sin(x / 20) * np.cos(y / 25)
    flat = rng.permutation(scenario.grid.size)[:120]
    data = Measurements.at(scenario.grid.cells[flat], truth[flat])
    posterior = predictor(name).begin(scenario).updated(data).posterior()
    error = np.delete(posterior.mean_db.ravel() - truth, flat)
    std = np.delete(posterior.std_db.ravel(), flat)
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.delete(truth, flat).std()
    assert 0.8 < np.mean(np.abs(error) < 1.645 * std) <= 1.0


def test_least_squares_find_the_shadowing_of_many_readings(rng):
    xy = rng.uniform(0.0, 600.0, (900, 2))
    distance = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    covariance = 60.0 * np.exp(-distance / 30.0) + 12.0 * np.eye(len(xy))
    residual = np.linalg.cholesky(covariance) @ rng.standard_normal(len(xy))
    sill, range_m, nugget = estimated(xy, residual)
    assert 35 < sill < 85
    assert 12 < range_m < 60
    assert sill + nugget == pytest.approx(np.mean(residual**2))


@pytest.mark.parametrize(
    ("name", "option"),
    [("fixed-rank-kriging", "coarse"), ("random-forest", "trees"), ("random-forest", "in_leaf")],
)
def test_impossible_options_are_told(name, option):
    with pytest.raises(InputError, match=f"`{option}`"):
        create_predictor(name, **{option: 0})
