"""Local Kriging is Kriging while the neighbours are all there are, and close to it beyond."""

from __future__ import annotations

import numpy as np
import pytest

from skygain.city import City
from skygain.fields.planning import planning_field
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.scenario import Scenario
from skygain.testing.predictors import check_predictor, example_scenario


def scenario(shape=(21, 17), **options) -> Scenario:
    return Scenario(City(Grid(shape, 4.0), np.zeros(shape)), **options)


def readings(rng, grid, n) -> Measurements:
    cells = rng.permutation(grid.cells)[:n]
    x, y = grid.xy_m(cells).T
    gain = -105 + 9 * np.sin(x / 25) * np.cos(y / 35) + 3 * rng.standard_normal(n)
    return Measurements.at(cells, gain, noise_std_db=rng.uniform(0, 2, n) * rng.integers(0, 2, n))


def grown(predictor, setting, data, parts):
    belief = predictor.begin(setting)
    for part in np.array_split(np.arange(len(data)), parts):
        belief = belief.updated(data.taken(part))
    return belief.posterior()


@pytest.mark.parametrize("transmitter", [None, (20.0, -30.0, 1.5)])
@pytest.mark.parametrize("predicted_m", [10.0, 20.0])
@pytest.mark.parametrize("refit", [True, False])
def test_with_all_as_neighbours_it_is_kriging(transmitter, predicted_m, refit, rng):
    setting = scenario(transmitter_m=transmitter, prediction_altitude_m=predicted_m)
    data = readings(rng, setting.grid, 90)
    local = grown(create_predictor("local-kriging", neighbours=90, refit=refit), setting, data, 6)
    whole = grown(
        create_predictor("kriging" if transmitter else "kriging-blind", refit=refit),
        setting,
        data,
        6,
    )
    np.testing.assert_allclose(local.mean_db, whole.mean_db, atol=1e-4)
    np.testing.assert_allclose(local.variance_db2, whole.variance_db2, atol=1e-4)


def test_few_neighbours_lose_little(rng):
    setting = scenario((40, 40))
    data = readings(rng, setting.grid, 400)
    local = grown(create_predictor("local-kriging", neighbours=24, refit=False), setting, data, 5)
    whole = grown(create_predictor("kriging-blind", refit=False), setting, data, 1)
    assert np.sqrt(np.mean((local.mean_db - whole.mean_db) ** 2)) < 0.05 * whole.std_db.mean()
    assert (local.variance_db2 >= whole.variance_db2 - 1e-6).all()


def test_growing_equals_starting_over(rng):
    """Only the cells whose neighbourhood changed are predicted again; the others must not need
    it."""
    setting = scenario((30, 30))
    data = readings(rng, setting.grid, 300)
    predictor = create_predictor("local-kriging", neighbours=9, refit=False)
    stepwise, at_once = grown(predictor, setting, data, 25), grown(predictor, setting, data, 1)
    np.testing.assert_allclose(stepwise.mean_db, at_once.mean_db, atol=1e-8)
    np.testing.assert_allclose(stepwise.variance_db2, at_once.variance_db2, atol=1e-8)


def test_a_reading_at_the_floor_acts_as_in_kriging():
    setting = scenario()
    floor = Measurements.at([[3, 3]], [-160.0], censored=True)
    local, whole = (
        create_predictor(name).begin(setting).updated(floor).posterior()
        for name in ("local-kriging", "kriging-blind")
    )
    np.testing.assert_allclose(local.mean_db, whole.mean_db, atol=1e-6)


def test_progress_counts_every_cell():
    seen = []
    predictor = create_predictor(
        "local-kriging", progress=lambda done, total: seen.append((done, total))
    )
    predictor.begin(scenario()).updated(Measurements.at([[3, 3]], [-100.0])).posterior()
    assert seen[-1] == (21 * 17, 21 * 17)


@pytest.mark.parametrize("neighbours", [4, 32])
def test_keeps_the_promises_of_a_predictor(neighbours):
    check_predictor(create_predictor("local-kriging", neighbours=neighbours))


def test_no_neighbours_are_refused():
    with pytest.raises(InputError, match="neighbour"):
        create_predictor("local-kriging", neighbours=0)


def test_planners_get_its_covariance(rng):
    """Few readings: what a planner computes from the prior and the readings is the belief's own
    variance."""
    setting = scenario((21, 17), transmitter_m=(20.0, -30.0, 1.5))
    cells = rng.permutation(setting.grid.cells)[:20]
    belief = create_predictor("local-kriging", refit=False).begin(setting)
    belief = belief.updated(Measurements.at(cells, np.linspace(-120, -100, 20)))
    everywhere = setting.grid.cells
    planned = np.diag(
        planning_field(belief).conditioned().covariance(everywhere, everywhere)
    ).reshape(setting.grid.shape)
    variance = belief.posterior().variance_db2
    assert (planned <= variance + 1e-2).all()  # the planner takes the trend for known
    assert np.corrcoef(planned.ravel(), variance.ravel())[0, 1] > 0.99


@pytest.mark.parametrize("slope_db", [-45.0, 0.0, 45.0])
def test_far_from_the_transmitter_the_slope_may_change(slope_db, rng):
    """Readings near the transmitter say nothing of the slope beyond the trained reach, and the
    interval has to tell."""
    grid = Grid((6, 700), 4.0)
    scenario = Scenario(City(grid, np.zeros(grid.shape)), transmitter_m=(2.0, 10.0, 1.5))
    distance = np.linalg.norm(grid.xy_m(grid.cells) - [2.0, 10.0], axis=1)
    beyond = np.log10(np.maximum(distance / 620.0, 1.0))
    truth = 35.8 - 75.7 * np.log10(np.maximum(distance, 8.5)) + slope_db * beyond
    truth += 4 * rng.standard_normal(grid.size)
    near = np.flatnonzero(distance < 250)
    some = rng.permutation(near)[:80]
    belief = create_predictor("local-kriging").begin(scenario)
    posterior = belief.updated(Measurements.at(grid.cells[some], truth[some])).posterior()
    low, high = posterior.interval(0.9)
    inside = (truth >= low.ravel()) & (truth <= high.ravel())
    assert inside[distance > 620].mean() > 0.85
    assert inside[distance < 620].mean() > 0.85
    assert posterior.std_db.ravel()[near].max() < 20


def test_within_the_trained_reach_nothing_changes():
    scenario = example_scenario()
    assert len(create_predictor("local-kriging").begin(scenario).parameters.trend) == 2


def test_without_a_transmitter_doubt_grows_with_the_distance_to_the_readings(rng):
    setting = scenario((8, 600))
    cells = np.argwhere(np.ones((8, 40), dtype=bool))[rng.permutation(320)[:60]]
    data = Measurements.at(cells, -100 + 5 * rng.standard_normal(60))
    std = grown(create_predictor("local-kriging", refit=False), setting, data, 2).std_db[4]
    assert std[70] + 5 < std[300] < std[599] - 3
