"""Kriging around the propagation model's own map."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.cities.manhattan import ManhattanConfig, manhattan_city
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.propagation.truth import trace_truth
from skygain.scenario import Scenario
from skygain.testing.predictors import check_predictor, example_scenario


@pytest.fixture(scope="module")
def town() -> tuple[Scenario, np.ndarray]:
    city = manhattan_city(3, ManhattanConfig(extent_m=160.0, blocks=2))
    row, col = np.argwhere(city.height_m == 0)[len(city.height_m) // 2]
    x, y = city.grid.xy_m(np.array([[row, col]]))[0].tolist()
    scenario = Scenario(city, transmitter_m=(x, y, 1.5))
    truth = trace_truth(city, scenario.transmitter_m, [scenario.uav_altitude_m])
    return scenario, truth.gain_db[0, 0].astype(float)


def learnt(scenario: Scenario, truth_db: np.ndarray, n: int, rng: np.random.Generator):
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:n]]
    belief = create_predictor("launched").begin(scenario)
    for part in np.array_split(cells, 3):
        belief = belief.updated(Measurements.at(part, truth_db[tuple(part.T)]))
    left = scenario.outdoor.copy()
    left[tuple(cells.T)] = False
    posterior = belief.posterior()
    return (posterior.mean_db - truth_db)[left], posterior.std_db[left]


def test_it_is_a_predictor():
    check_predictor(create_predictor("launched"))


def test_before_the_first_reading_it_is_the_launched_map(town):
    scenario, truth_db = town
    posterior = create_predictor("launched").begin(scenario).posterior()
    np.testing.assert_allclose(posterior.mean_db, truth_db, atol=1e-3)


@pytest.mark.parametrize("offset_db", [0.0, 63.0])
def test_a_right_map_needs_its_level_only(town, offset_db, rng):
    scenario, truth_db = town
    error, std = learnt(scenario, truth_db + offset_db, 9, rng)
    assert np.abs(error).max() < 0.5
    assert (std < 8.0).all()


def test_a_map_that_says_nothing_is_given_up(town, rng):
    """The gain falls from west to east, whatever the launcher says."""
    scenario, truth_db = town
    other = np.broadcast_to(-60.0 - 1.5 * np.arange(truth_db.shape[1]), truth_db.shape)
    error, std = learnt(scenario, other, 150, rng)
    assert np.sqrt(np.mean(error**2)) < 4.0
    assert np.mean(np.abs(error) < 1.645 * std) > 0.85


def test_without_a_transmitter_it_says_what_to_give():
    with pytest.raises(InputError, match="give `transmitter`, or `predictor=operator`"):
        create_predictor("launched").begin(example_scenario(transmitter=False))
