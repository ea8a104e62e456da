"""The operator predictor: its algebra is exact whatever the network says, so an untrained network serves as well."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy import stats

from skygain.learning.checkpoints import save_checkpoint
from skygain.learning.operator_net import PropagationOperator
from skygain.learning.path_model import USED
from skygain.measurements import Measurements
from skygain.predictors.evidence import SMALLEST, Evidence, Factor, posterior_weights
from skygain.predictors.operator import OperatorPredictor, OperatorSettings
from skygain.predictors.residual_field import SMALLEST_VARIANCE, CorrelationModel, ResidualField
from skygain.predictors.transmitter_search import coarse_squares, split_square
from skygain.testing.predictors import check_predictor, example_scenario

QUICK = OperatorSettings(at_most=60, fine_at_most=200)


@pytest.fixture(scope="module")
def predictor(tmp_path_factory):
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("weights")
    save_checkpoint(folder / "operator.safetensors", PropagationOperator().state_dict(), {"name": "untrained"})
    sizes = (len(USED), 8, 2)
    layers = {f"{i}.weight": torch.randn(b, a) / 4 for i, (a, b) in enumerate(pairwise(sizes))}
    save_checkpoint(folder / "paths.safetensors", layers | {f"{i}.bias": torch.zeros(b) for i, b in enumerate(sizes[1:])}, {})
    return OperatorPredictor(weights=folder / "operator.safetensors", paths=folder / "paths.safetensors", settings=QUICK)


@pytest.mark.parametrize("known", [True, False])
def test_conforms(predictor, known):
    check_predictor(predictor, example_scenario(transmitter=known))


def test_the_field_is_the_textbook_gaussian_process(rng):
    model = CorrelationModel(length_m=20.0, far_length_m=90.0, far_share=0.3, nugget=0.1)
    shape = (9, 11)
    field, cells = ResidualField.empty(model, shape, 4.0), rng.permutation(99)[:12]
    noise = rng.random(12)
    for cell, share in zip(cells, noise, strict=True):
        field, _ = field.grown(divmod(int(cell), 11), float(share))
    rows, cols = np.divmod(np.arange(99), 11)
    R = model.table(shape, 4.0)[np.abs(rows[:, None] - rows), np.abs(cols[:, None] - cols)].astype(float)
    K = R[np.ix_(cells, cells)] + np.diag(noise + SMALLEST_VARIANCE)
    expected = np.linalg.solve(np.linalg.cholesky(K), R[cells])
    assert np.allclose(field.W, expected, atol=1e-4)
    assert np.allclose(field.left, 1 - (expected**2).sum(0), atol=1e-4)


def evidence_of(readings, updates, soften=1e9):
    """Evidence after ``readings`` = (cells, z, std), taken in parts of the sizes ``updates``."""
    cells, z, std = readings
    factor, evidence, at = Factor.empty(CorrelationModel(nugget=0.3), 4.0), Evidence.none(z.shape[1]), 0
    for size in updates:
        part = slice(at, at + size)
        factor, rows = factor.grown(cells[part], np.zeros(size))
        evidence, at = evidence.grown(z[part], std[part], rows, soften), at + size
    return factor, evidence


@pytest.fixture
def readings(rng):
    cells = np.stack(np.divmod(rng.permutation(100)[:9], 10), axis=-1)
    return cells, rng.normal(size=(9, 4)), rng.uniform(2, 9, size=(9, 4))


def test_the_likelihood_is_the_multivariate_students(readings):
    cells, z, std = readings
    factor, evidence = evidence_of(readings, [9])
    distance = 4.0 * np.hypot(*np.moveaxis(cells[:, None] - cells[None], -1, 0))
    R = factor.model.correlation(distance) + SMALLEST * np.eye(9)
    expected = [
        stats.multivariate_t(loc=np.zeros(9), shape=np.outer(s, s) * R, df=5).logpdf(v * s)
        for v, s in zip(z.T, std.T, strict=True)
    ]
    found = evidence.log_likelihood(5.0)
    assert np.allclose(found - found[0], np.array(expected) - expected[0], atol=1e-4)


def test_the_likelihood_does_not_depend_on_how_the_readings_came(readings):
    straight, parts = evidence_of(readings, [9], 2.0)[1], evidence_of(readings, [1, 5, 3], 2.0)[1]
    assert np.allclose(straight.log_likelihood(3.0), parts.log_likelihood(3.0), atol=1e-4)
    factor, _ = evidence_of(readings, [4, 5], 2.0)
    late = Evidence.solved(readings[1], readings[2], factor, 2.0)
    assert np.allclose(straight.log_likelihood(3.0), late.log_likelihood(3.0), atol=1e-4)


def test_weights_are_probabilities_and_the_power_flattens_them():
    prior, likelihood = np.array([1.0, 1.0, 2.0]), np.array([0.0, -4.0, -400.0])
    sharp, flat = posterior_weights(prior, likelihood, 1.0), posterior_weights(prior, likelihood, 0.01)
    assert np.isclose(sharp.sum(), 1)
    assert sharp[0] > flat[0]
    assert np.allclose(posterior_weights(prior, likelihood, 0.0), [0.25, 0.25, 0.5])


def test_an_older_field_survives_a_branch():
    field, _ = ResidualField.empty(CorrelationModel(), (6, 6), 4.0).grown((1, 1), 0.0)
    before = field.W.copy()
    field.grown((2, 2), 0.0)
    other, _ = field.grown((5, 5), 0.0)
    assert np.array_equal(field.W, before)
    assert other.W[1].argmax() == 35


def test_squares_cover_open_ground_once():
    scenario = example_scenario(transmitter=False)
    squares = coarse_squares(scenario, margin_m=20.0, side_m=16.0, at_most=1000)
    margin, cells = 5, {}
    for square in squares:
        for row in range(square.row, square.row + square.side):
            for col in range(square.col, square.col + square.side):
                cells[row, col] = cells.get((row, col), 0) + 1
    assert set(cells.values()) == {1}
    open_cells = {tuple(c) for c in np.argwhere(scenario.city.height_m == 0)}
    assert open_cells <= set(cells)
    assert any(row == -margin for row, _ in cells)


def test_a_split_keeps_the_prior_and_never_enters_a_building():
    scenario = example_scenario(transmitter=False)
    squares = coarse_squares(scenario, margin_m=20.0, side_m=16.0, at_most=1000)
    while squares:
        for square in squares:
            row, col = (round(v) for v in square.position)
            assert not scenario.grid.contains((row, col)) or scenario.city.height_m[row, col] == 0
        quarters = [split_square(scenario, 20.0, square) for square in squares]
        for square, parts in zip(squares, quarters, strict=True):
            assert square.side == 1 or np.isclose(sum(q.prior for q in parts), square.prior)
        squares = [q for parts in quarters for q in parts]


def test_fewer_squares_than_allowed():
    scenario = example_scenario(transmitter=False)
    assert len(coarse_squares(scenario, margin_m=102.0, side_m=4.0, at_most=80)) <= 80


def test_measurements_of_a_candidates_own_map_find_it(predictor, rng):
    scenario = example_scenario(transmitter=False)
    belief = predictor.begin(scenario)
    target = 7
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:25]]
    mean, _ = belief.maps.at(belief.candidates.maps[[target]], scenario.grid.flat(cells), 10.0)
    after = belief.updated(Measurements.at(cells, mean[:, 0]))
    square = belief.candidates.squares[target]
    weights = after.weights()
    inside = [
        w
        for w, s in zip(weights, after.candidates.squares, strict=True)
        if square.row <= s.row < square.row + square.side and square.col <= s.col < square.col + square.side
    ]
    assert sum(inside) > 3 * belief.weights()[target]


def test_variance_shrinks_where_the_transmitter_is_known(predictor, rng):
    scenario = example_scenario()
    belief = predictor.begin(scenario)
    free = np.argwhere(scenario.flyable)
    before = belief.posterior().variance_db2
    for cell in free[rng.permutation(len(free))[:8]]:
        belief = belief.updated(Measurements.at([cell], [-100.0]))
        after = belief.posterior().variance_db2
        assert (after <= before + 1e-3).all()
        before = after


def test_another_altitude_for_the_map_than_for_the_flight(predictor):
    scenario = replace(example_scenario(transmitter=False), prediction_altitude_m=20.0)
    posterior = predictor.begin(scenario).updated(Measurements.at([[0, 0]], [-90.0])).posterior()
    assert np.isfinite(posterior.mean_db).all()
    assert (posterior.variance_db2 > 0).all()
