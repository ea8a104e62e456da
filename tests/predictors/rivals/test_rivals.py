from __future__ import annotations

import sys

import numpy as np
import pytest

from skygain.ground.errors import InputError, MissingExtraError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.testing.predictors import check_predictor, example_scenario

MODULES = {"sklearn-gp": "sklearn", "pykrige": "pykrige", "gstools": "gstools"}
MODULES |= {"gpytorch": "gpytorch"}
FIXED = KrigingParameters.known_trend(-110.0, sill_db2=380.0, range_m=57.0, nugget_db2=3.0)


@pytest.fixture(params=MODULES)
def name(request):
    pytest.importorskip(MODULES[request.param], reason="needs the extra 'rivals'")
    return request.param


def _readings(rng, n=60):
    scenario = example_scenario()
    cells = rng.permutation(scenario.grid.cells)[:n]
    return scenario, Measurements.at(cells, -110 + 15 * rng.standard_normal(n))


def _answer(predictor, scenario, data):
    posterior = predictor.begin(scenario).updated(data).posterior()
    return posterior.mean_db, posterior.variance_db2


def test_rivals_keep_the_promises_of_a_predictor(name):
    check_predictor(create_predictor(name))


def test_told_the_covariance_they_agree_with_ours(name, rng):
    scenario, data = _readings(rng)
    # PyKrige estimates the mean: ours does too if its prior is flat.
    width = 1e7 if name == "pykrige" else 0.0
    ours = KrigingParameters((-110.0,), ((width,),), FIXED.sill_db2, FIXED.range_m, 3.0)
    expected = _answer(
        create_predictor("kriging-blind", parameters=ours, refit=False), scenario, data
    )
    mean, variance = _answer(create_predictor(name, parameters=FIXED), scenario, data)
    assert np.abs(mean - expected[0]).max() < 1e-3
    assert np.abs(variance - expected[1]).max() < 1e-2


def test_a_fit_beats_the_mean_of_the_readings(name, rng):
    scenario = example_scenario((30, 30))
    x, y = scenario.grid.xy_m(scenario.grid.cells).T
    truth = -100 + 10 * np.sin(x / 20) + 10 * np.cos(y / 25)
    flat = rng.permutation(scenario.grid.size)[:80]
    data = Measurements.at(scenario.grid.cells[flat], truth[flat])
    mean, variance = _answer(create_predictor(name), scenario, data)
    error = np.delete(mean.ravel() - truth, flat)
    assert np.sqrt(np.mean(error**2)) < 0.5 * truth.std()
    assert 0.02 < np.mean(error**2) / np.delete(variance.ravel(), flat).mean() < 3


def test_a_missing_library_is_one_line_with_its_command(monkeypatch):
    for name, module in MODULES.items():
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(MissingExtraError, match=r"pip install .*\[rivals\]'") as error:
            create_predictor(name).begin(example_scenario())
        assert "\n" not in str(error.value)


def test_a_trend_of_two_coefficients_is_refused():
    line = KrigingParameters.known_trend(27.0, 72.0, sill_db2=380.0, range_m=57.0)
    for name in MODULES:
        with pytest.raises(InputError, match="1 coefficient"):
            create_predictor(name, parameters=line)


def test_without_a_nugget_exact_readings_are_reproduced(name, rng):
    scenario, data = _readings(rng, 30)
    smooth = KrigingParameters.known_trend(-110.0, sill_db2=380.0, range_m=57.0)
    mean, _ = _answer(create_predictor(name, parameters=smooth), scenario, data)
    assert np.abs(mean[tuple(data.cell.T)] - data.gain_db).max() < 1e-2
