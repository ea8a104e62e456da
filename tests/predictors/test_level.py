"""Adding a constant to every reading adds it to the map and changes nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.ground.errors import InputError, MissingExtraError
from skygain.measurements import Measurements
from skygain.predictors import PREDICTORS, create_predictor
from skygain.predictors.interpolators.idw import IdwPredictor
from skygain.predictors.kriging.residual import ResidualKrigingPredictor
from skygain.testing.predictors import example_scenario


class Smooth(IdwPredictor):
    """A mean that residual Kriging may correct."""

    interpolates = False


GAIN_IN_DB = "trained on channel gain in dB, so the level of a reading tells it something"
NEEDS_GAIN = dict.fromkeys(["operator", "unet", "paper-unet", "paper-unet-mapblind"], GAIN_IN_DB)
NEEDS_GAIN |= {"residual-kriging": "its mean is a network's unless told another: " + GAIN_IN_DB}
NEEDS_GAIN |= {"kriging": "told the transmitter, it knows the gain in dB along the path-loss line"}
NEEDS_GAIN |= {"kriging-inferred": "finds the transmitter by the trained gain; see level='any'"}
OURS = {
    "residual": lambda: ResidualKrigingPredictor(Smooth()),
    "inferred at any level": lambda: create_predictor("kriging-inferred", level="any"),
}
"""predictors that no single name builds"""
SCENARIO = example_scenario((26, 26), transmitter=False)
"""one city, so that networks compute their maps of it once"""
TOLD = example_scenario((26, 26))
"""the same for those that must be told the transmitter"""
TOLERANCE_DB = {"gstools": 1e-2}
"""its least squares stop early"""


def _maps(predictor, shift_db, n, noise_std_db, floor):
    scenario = TOLD if predictor.transmitter == "required" else SCENARIO
    rng = np.random.default_rng(5)
    x, y = scenario.grid.xy_m(scenario.grid.cells).T
    gain = -100 + 12 * np.sin(x / 20) + 10 * np.cos(y / 25) + 2 * rng.standard_normal(len(x))
    cells = rng.permutation(scenario.grid.size)[:n]
    belief = predictor.begin(scenario)
    for part in np.array_split(np.arange(n), min(n, 4)):
        censored = (part % 3 == 0) & floor
        belief = belief.updated(
            Measurements.at(
                scenario.grid.cells[cells[part]],
                gain[cells[part]] + shift_db,
                noise_std_db=noise_std_db,
                censored=censored,
            )
        )
    posterior = belief.posterior()
    return posterior.mean_db - shift_db, posterior.std_db


@pytest.mark.parametrize("name", [*PREDICTORS, *OURS])
def test_a_constant_added_to_the_readings_is_added_to_the_map(name):
    if name in NEEDS_GAIN:
        pytest.skip(NEEDS_GAIN[name])
    predictor = OURS[name]() if name in OURS else create_predictor(name)
    tolerance = TOLERANCE_DB.get(name, 1e-3)
    for n in (1, 5, 60):
        for noise_std_db, floor in ((0.0, False), (1.0, False), (1.0, True)):
            try:
                plain = _maps(predictor, 0.0, n, noise_std_db, floor)
            except MissingExtraError as error:
                pytest.skip(str(error))
            for shift_db in (-60.0, 80.0):
                moved = _maps(predictor, shift_db, n, noise_std_db, floor)
                for what, a, b in zip(("mean", "std"), plain, moved, strict=True):
                    worst = float(np.abs(a - b).max())
                    assert worst < tolerance, f"{what} moved by {worst:g} dB with {n} readings"


@pytest.mark.parametrize("name", ["kriging-blind", "kriging-inferred", "kriging-quadratic"])
def test_told_gains_the_trained_level_counts(name):
    predictor = create_predictor(name, level="gain")
    plain, moved = (_maps(predictor, shift, 1, 0.0, False)[0] for shift in (0.0, 80.0))
    assert np.abs(plain - moved).max() > 10.0
    with pytest.raises(InputError, match="level 'dBm'"):
        create_predictor(name, level="dBm")


@pytest.mark.parametrize("name", ["kriging-blind", "kriging-inferred", "local-kriging"])
def test_before_any_reading_the_training_speaks(name):
    scenario = example_scenario(transmitter=False)
    posterior = create_predictor(name).begin(scenario).posterior()
    assert 15 < posterior.std_db.mean() < 60
    assert -160 < posterior.mean_db.mean() < -80


@pytest.mark.parametrize("name", ["kriging-blind", "local-kriging", "inferred at any level"])
def test_readings_at_the_floor_alone_give_a_sober_map(name):
    scenario = example_scenario(transmitter=False)
    cells = scenario.grid.cells[::37]
    floor = Measurements.at(cells, np.full(len(cells), -120.0), noise_std_db=1.0, censored=True)
    predictor = OURS[name]() if name in OURS else create_predictor(name)
    posterior = predictor.begin(scenario).updated(floor).posterior()
    assert posterior.mean_db.min() > -200
    assert posterior.mean_db.max() < -115
