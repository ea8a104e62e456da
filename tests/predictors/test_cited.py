"""Predictors of the papers that the first one cites."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from skygain.ground.errors import InputError, MissingExtraError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging.malmirchegini import estimated
from skygain.testing.predictors import check_predictor, example_scenario

NAMES = ("malmirchegini", "fixed-rank-kriging", "random-forest", "tensor")
EXTRAS = {"random-forest": ("sklearn", "rivals"), "tensor": ("tensorly", "tensor")}


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    if request.param in EXTRAS:
        module, extra = EXTRAS[request.param]
        pytest.importorskip(module, reason=f"needs the extra '{extra}'")
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
    [
        ("fixed-rank-kriging", "coarse"),
        ("random-forest", "trees"),
        ("random-forest", "in_leaf"),
        ("tensor", "rank"),
    ],
)
def test_impossible_options_are_told(name, option):
    with pytest.raises(InputError, match=f"`{option}`"):
        create_predictor(name, **{option: 0})


@pytest.mark.parametrize("name", EXTRAS)
def test_a_missing_library_is_one_line_with_its_command(name, monkeypatch):
    module, extra = EXTRAS[name]
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"pip install .*\[{extra}\]'") as error:
        create_predictor(name).begin(example_scenario())
    assert "\n" not in str(error.value)


def test_a_block_without_readings_follows_its_rows_and_columns(rng):
    """What a map of rank one allows and no interpolation of neighbours knows."""
    pytest.importorskip("tensorly", reason="needs the extra 'tensor'")
    scenario = example_scenario((30, 30))
    truth = -100 + 12 * np.outer(rng.choice([-1.0, 1.0], 30), rng.choice([-1.0, 1.0], 30))
    block = np.zeros((30, 30), dtype=bool)
    block[18:25, 9:17] = True
    cells = np.argwhere(~block)
    data = Measurements.at(cells, truth[~block])
    error = {
        name: create_predictor(name).begin(scenario).updated(data).posterior().mean_db - truth
        for name in ("tensor", "idw", "thin-plate")
    }
    rmse_db = {name: np.sqrt(np.mean(e[block] ** 2)) for name, e in error.items()}
    assert rmse_db["tensor"] < 0.5 * min(rmse_db["idw"], rmse_db["thin-plate"])


def test_few_readings_and_readings_on_a_line_give_a_sober_map():
    pytest.importorskip("tensorly", reason="needs the extra 'tensor'")
    scenario = example_scenario()
    for cells in ([(3, 4)], [(3, 4), (9, 4)], [(row, 10) for row in range(20)]):
        gain = -100.0 - np.arange(len(cells))
        belief = create_predictor("tensor").begin(scenario)
        posterior = belief.updated(Measurements.at(np.array(cells), gain)).posterior()
        assert posterior.mean_db.min() >= gain.min() - 1e-6
        assert posterior.mean_db.max() <= gain.max() + 1e-6
        assert posterior.std_db.max() > 5
