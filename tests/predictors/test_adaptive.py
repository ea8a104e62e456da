"""A belief that weighs methods by what they foretold."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from skygain.city import City
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.posterior import JointPosterior, Posterior
from skygain.predictors import create_predictor
from skygain.predictors.adaptive import AdaptivePredictor
from skygain.predictors.adaptive_votes import PRIOR_VOTES, Forecast, Votes
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import Readings
from skygain.predictors.kriging.drift import DriftKriging
from skygain.scenario import Scenario
from skygain.survey.methods import planner
from skygain.testing.predictors import check_predictor, example_scenario

GRID = Grid((40, 40), 4.0)
OPEN = Scenario(City(GRID, np.zeros(GRID.shape)))
X, Y = GRID.xy_m(GRID.cells).T
SHAPE_DB = -100 + 14 * np.sin(X / 30) + 9 * np.cos(Y / 22)
"""what the gain looks like"""


@dataclass(frozen=True, eq=False)
class Told(Predictor):
    """Has a map already, and learns nothing."""

    mean_db: np.ndarray
    std_db: float = 3.0
    interpolates = False

    def begin(self, scenario: Scenario) -> Belief:
        return ToldBelief(scenario, Measurements.none(), self)


@dataclass(frozen=True, eq=False)
class ToldBelief(Belief):
    scenario: Scenario
    measurements: Measurements
    told: Told

    def updated(self, measurements: Measurements) -> ToldBelief:
        return replace(self, measurements=self.measurements.extended(measurements))

    def posterior(self) -> Posterior:
        mean = self.told.mean_db.reshape(GRID.shape)
        return Posterior(mean, np.full(GRID.shape, self.told.std_db**2))


def taken(belief: Belief, gain_db: np.ndarray, rng: np.random.Generator, steps: int = 60) -> Belief:
    """The belief after a flight of three UAVs by random waypoints."""
    swarm = Swarm.deployed(OPEN, [(5, 5), (20, 20), (33, 8)], steps)
    paths = create_planner("random-waypoint").plan(swarm, belief, steps, rng).paths
    for cells in paths.transpose(1, 0, 2):
        belief = belief.updated(Measurements.at(cells, gain_db[GRID.flat(cells)]))
    return belief


def test_the_method_that_foretells_best_is_listened_to(rng: np.random.Generator) -> None:
    right = Told(SHAPE_DB + rng.normal(0, 3.0, GRID.size))
    wrong = Told(SHAPE_DB[::-1].copy())
    belief = taken(AdaptivePredictor((wrong, right)).begin(OPEN), SHAPE_DB, rng)
    assert belief.weight[1] > 0.99
    error = belief.posterior().mean_db.ravel() - SHAPE_DB
    assert np.sqrt(np.mean(error**2)) < 3.3


def test_a_method_too_sure_or_too_unsure_of_itself_is_put_right(rng: np.random.Generator) -> None:
    noise = rng.normal(0, 4.0, GRID.size)
    for claimed_db in (1.5, 12.0):
        told = Told(SHAPE_DB + noise, std_db=claimed_db)
        belief = taken(AdaptivePredictor((told,)).begin(OPEN), SHAPE_DB, rng, steps=120)
        assert abs(np.log(4.0 / claimed_db)) > abs(
            np.log(4.0 / belief.posterior().std_db.mean())
        ), "no nearer to the true error"


def test_a_foreign_map_costs_little(rng: np.random.Generator) -> None:
    alone = taken(create_predictor("kriging-blind").begin(OPEN), SHAPE_DB, np.random.default_rng(3))
    wrong = Told(SHAPE_DB[::-1].copy())
    both = taken(
        AdaptivePredictor((wrong, create_predictor("kriging-blind"))).begin(OPEN),
        SHAPE_DB,
        np.random.default_rng(3),
    )
    errors = [
        np.sqrt(np.mean((b.posterior().mean_db.ravel() - SHAPE_DB) ** 2)) for b in (alone, both)
    ]
    assert errors[1] < 1.05 * errors[0]


def test_neighbouring_readings_count_once() -> None:
    votes = Votes.none([0.0]).with_forecast(
        Forecast.of(
            OPEN,
            np.array([40 * 20 + 20]),
            [Posterior(np.full(GRID.shape, -100.0), np.full(GRID.shape, 4.0))],
        )
    )
    row = np.arange(7)  # 28 m of cells side by side
    readings = Readings(row, np.full(7, -98.0), np.zeros(7))
    counted = votes.counted(GRID, readings)
    assert counted.votes == 1
    assert counted.squares == pytest.approx(1.0)
    assert counted.factor == pytest.approx(1.0)
    near = Readings(np.array([40 * 20 + 24]), np.array([-90.0]), np.zeros(1))
    assert counted.counted(GRID, near) is counted
    far = Readings(np.array([40 * 39]), np.array([-90.0]), np.zeros(1))
    assert counted.counted(GRID, far).factor == pytest.approx(
        (PRIOR_VOTES + 26.0) / (PRIOR_VOTES + 2)
    )


def test_kriging_around_a_map_finds_its_level_and_slope(rng: np.random.Generator) -> None:
    truth = 30.0 + 1.3 * SHAPE_DB
    std = np.full(GRID.size, 6.0)
    cells = rng.permutation(GRID.size)[:25]
    readings = Readings(cells, truth[cells], np.zeros(25))
    found = DriftKriging.around(OPEN, (SHAPE_DB, std), (SHAPE_DB, std), readings)
    posterior = found.posterior()
    assert np.sqrt(np.mean((posterior.mean_db.ravel() - truth) ** 2)) < 1.5
    assert posterior.mean_db.ravel()[cells] == pytest.approx(truth[cells], abs=1e-8)
    assert not posterior.variance_db2.ravel()[cells].any()
    some = GRID.cells[rng.permutation(GRID.size)[:9]]
    own = posterior.covariance(some)
    assert np.diag(own) == pytest.approx(posterior.variance_db2[tuple(some.T)], abs=1e-8)
    kept = found.readings()
    assert np.array_equal(kept.cells, cells)
    assert kept.gain_db == pytest.approx(truth[cells])


def test_it_conforms() -> None:
    check_predictor(AdaptivePredictor("idw,kriging-blind"))


def test_with_the_operator_it_conforms_and_is_joint() -> None:
    scenario = example_scenario((14, 12), transmitter=False)
    predictor = AdaptivePredictor()
    check_predictor(predictor, scenario)
    cells = scenario.grid.cells[::5]
    gain = -110 + 8 * np.sin(scenario.grid.xy_m(cells)[:, 0] / 9)
    belief = predictor.begin(scenario).updated(Measurements.at(cells, gain))
    assert len(belief.weight) == 3
    posterior = belief.posterior()
    assert isinstance(posterior, JointPosterior)
    swarm = Swarm.deployed(scenario, [(0, 0), (13, 11)], 4)
    for text in ("sequential-greedy", "lookahead:horizon=4:paths=8"):
        plan = planner(text).plan(swarm, belief, 4, np.random.default_rng(0))
        assert len(plan.paths) == 2


def test_told_gains_the_operator_keeps_their_level() -> None:
    scenario = example_scenario((14, 12), transmitter=False)
    readings = Measurements.at([[0, 0], [13, 11], [6, 6]], [-90.0, -95.0, -80.0])
    told, free = (
        AdaptivePredictor(level=level).begin(scenario).updated(readings)
        for level in ("gain", "any")
    )
    assert told.offset_db == (0.0, 0.0)
    assert free.offset_db[0] != 0.0


def test_without_a_building_on_the_map_the_operator_does_not_lead() -> None:
    mapped = example_scenario((14, 12), transmitter=False)
    flat = Scenario(City(mapped.grid, np.zeros(mapped.grid.shape)))
    leaders = [int(AdaptivePredictor().begin(s).weight.argmax()) for s in (mapped, flat)]
    assert leaders == [0, 1]


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"level": "dBm"}, "unknown level"),
        ({"of": ""}, "needs methods"),
        ({"of": "adaptive"}, "weigh itself"),
        ({"of": "kriging-blnd"}, "kriging-blind"),
    ],
)
def test_wrong_options_are_refused(options: dict, word: str) -> None:
    with pytest.raises(InputError, match=word):
        AdaptivePredictor(**options)
