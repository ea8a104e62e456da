"""The operator predictor: its algebra is exact whatever the network says, so an untrained network
serves as well."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from skygain.fields.residual_field import SMALLEST_VARIANCE, CorrelationModel, ResidualField
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.networks.operator.judge import INPUTS, TERMS, CandidateJudge, error_terms, judge_inputs
from skygain.networks.operator.locator import LocatorNet
from skygain.networks.operator.network import PropagationOperator
from skygain.networks.operator.path_model import USED
from skygain.networks.weights import write_weights
from skygain.predictors.networks import operator
from skygain.predictors.networks.operator import OperatorPredictor, OperatorSettings
from skygain.predictors.networks.transmitter_search import TransmitterSearch
from skygain.testing.predictors import check_predictor, example_scenario

QUICK = OperatorSettings(at_most=30, fine_at_most=600)


def begun(scenario, **changes):
    options = {
        "margin_m": 40.0,
        "fine_m": 8.0,
        "fine_at_most": 5000,
        "coarse_m": 32.0,
        "at_most": 300,
        "first_maps": 300,
        "height_z_m": 1.5,
    }
    return TransmitterSearch.begun(scenario, **{**options, **changes})


def any_judge():
    sizes = (INPUTS, 6, 6, 1)
    layers = {f"{i}.matrix": torch.randn(a, b) / 4 for i, (a, b) in enumerate(pairwise(sizes))}
    layers |= {f"{i}.offset": torch.randn(b) / 4 for i, b in enumerate(sizes[1:])}
    return layers | {
        "centre": torch.zeros(INPUTS),
        "scale": torch.full((INPUTS,), 2.0),
        "linear": torch.rand(INPUTS) / 4,
    }


@pytest.fixture(scope="module")
def predictor(tmp_path_factory):
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("weights")
    write_weights(
        folder / "operator.safetensors", PropagationOperator().state_dict(), {"name": "untrained"}
    )
    sizes = (len(USED), 8, 2)
    layers = {f"{i}.weight": torch.randn(b, a) / 4 for i, (a, b) in enumerate(pairwise(sizes))}
    write_weights(
        folder / "paths.safetensors",
        layers | {f"{i}.bias": torch.zeros(b) for i, b in enumerate(sizes[1:])},
        {},
    )
    write_weights(folder / "locator.safetensors", LocatorNet().state_dict(), {"name": "untrained"})
    write_weights(folder / "judge.safetensors", any_judge(), {"name": "untrained"})
    files = {"weights": "operator", "paths": "paths", "locator": "locator", "judge": "judge"}
    return OperatorPredictor(
        **{k: folder / f"{name}.safetensors" for k, name in files.items()}, settings=QUICK
    )


@pytest.mark.parametrize("known", [True, False])
def test_conforms(predictor, known):
    check_predictor(predictor, example_scenario(transmitter=known))


def test_conforms_without_a_judge(predictor):
    check_predictor(replace(predictor, judge=""), example_scenario(transmitter=False))


def test_what_the_judge_sees_is_the_same_however_the_candidates_came(predictor, rng):
    """Sums grown reading by reading, and those made at once for a candidate that joined later."""
    scenario = example_scenario(transmitter=False)
    free = np.argwhere(scenario.flyable)
    cells, gain = free[rng.permutation(len(free))[:15]], rng.uniform(-130, -70, 15)
    belief = predictor.begin(scenario)
    for cell, value in zip(cells, gain, strict=True):
        belief = belief.updated(Measurements.at([cell], [value]))
    assert len(belief.candidates) > len(predictor.begin(scenario).candidates)
    _, z, std = belief._residuals(belief.candidates, belief.cells, belief.values, belief.noise_db2)
    assert np.allclose(
        belief.terms, error_terms(z, belief.whitened, std, belief.values), rtol=1e-3, atol=1e-2
    )
    judge = CandidateJudge.load(predictor.judge)
    expected = judge.probability(
        judge_inputs(belief.terms, 15, *belief.search.standing()), belief.settings.sharpen
    )
    assert np.allclose(belief.weights(), expected, atol=1e-6)


def test_a_judge_sees_the_locator_as_it_is(predictor, rng):
    """It learns from surveys without a judge, so what it is shown must not depend on whether there
    is one."""
    scenario = example_scenario(transmitter=False)
    free = np.argwhere(scenario.flyable)
    readings = Measurements.at(free[rng.permutation(len(free))[:9]], rng.uniform(-130, -70, 9))
    with_judge, without = (
        p.begin(scenario).updated(readings) for p in (predictor, replace(predictor, judge=""))
    )
    assert np.allclose(with_judge.search.located, without.search.located)
    assert not np.allclose(without.search.probability, without.search.located)


def test_the_judge_forgives_what_noise_explains(predictor, rng):
    scenario = example_scenario(transmitter=False)
    free = np.argwhere(scenario.flyable)
    cells, gain = free[rng.permutation(len(free))[:9]], rng.uniform(-130, -70, 9)
    exact, noisy = (
        predictor.begin(scenario).updated(Measurements.at(cells, gain, noise_std_db=s))
        for s in (0.0, 20.0)
    )
    k = TERMS.index("z absolute")
    shared = len(predictor.begin(scenario).candidates)
    assert (noisy.terms[k, :shared] < 0.7 * exact.terms[k, :shared]).all()


def test_the_field_is_the_textbook_gaussian_process(rng):
    model = CorrelationModel(length_m=20.0, far_length_m=90.0, far_share=0.3, nugget=0.1)
    shape = (9, 11)
    field, cells = ResidualField.empty(model, shape, 4.0), rng.permutation(99)[:12]
    noise = rng.random(12)
    L = np.zeros((12, 12))
    for first, end in ((0, 1), (1, 4), (4, 12)):  # one by one or together
        field, rows = field.grown(cells[first:end], noise[first:end])
        L[first:end, :end] = rows
    rows, cols = np.divmod(np.arange(99), 11)
    R = model.table(shape, 4.0)[np.abs(rows[:, None] - rows), np.abs(cols[:, None] - cols)].astype(
        float
    )
    K = R[np.ix_(cells, cells)] + np.diag(noise + SMALLEST_VARIANCE)
    assert np.allclose(L, np.linalg.cholesky(K), atol=1e-4)
    expected = np.linalg.solve(np.linalg.cholesky(K), R[cells])
    assert np.allclose(field.W, expected, atol=1e-4)
    assert np.allclose(field.left, 1 - (expected**2).sum(0), atol=1e-4)


def test_an_older_field_survives_a_branch():
    exact = np.zeros(1)
    empty = ResidualField.empty(CorrelationModel(), (6, 6), 4.0)
    field, _ = empty.grown(np.array([7]), exact)
    before = field.W.copy()
    field.grown(np.array([14]), exact)
    other, _ = field.grown(np.array([35]), exact)
    assert np.array_equal(field.W, before)
    assert other.W[1].argmax() == 35


def test_candidates_stand_for_every_square_and_come_closer(rng):
    scenario = example_scenario(transmitter=False)
    search = begun(scenario)
    probability = rng.random(len(search.probability)) ** 4
    search = replace(search, probability=probability / probability.sum())
    place = 4.0 * search.evidence.grid.position[:, :2]
    for _ in range(3):
        apart = np.hypot(*(place[:, None] - place[search.chosen][None]).transpose(2, 0, 1))
        assert np.allclose(search.distance_m, apart.min(axis=1))
        assert np.allclose(apart[np.arange(len(place)), search.nearest], search.distance_m)
        assert np.isclose(search.weights().sum(), 1)
        finer = search.refined(4, gain_m=0.0)
        assert finer.probability @ finer.distance_m < search.probability @ search.distance_m
        search = finer
    assert len(search.refined(100, gain_m=1e6).chosen) == len(search.chosen)


def test_the_first_candidates_are_no_more_than_allowed():
    scenario = example_scenario(transmitter=False)
    assert len(begun(scenario, coarse_m=8.0, at_most=20).chosen) <= 20
    assert len(begun(scenario, fine_at_most=200).probability) <= 200


def test_large_maps_begin_with_fewer_candidates(predictor, monkeypatch):
    scenario = example_scenario(transmitter=False)
    many = replace(predictor, settings=replace(QUICK, at_most=1000, first_maps=1000, coarse_m=8.0))
    monkeypatch.setattr(operator, "FIRST_ALWAYS", 12)
    monkeypatch.setattr(operator, "FIRST_WORK", 40 * scenario.outdoor.size)
    assert 12 < len(many.begin(scenario).candidates) <= 40
    monkeypatch.setattr(operator, "FIRST_WORK", 1)
    assert 1 < len(many.begin(scenario).candidates) <= 12


def test_squares_and_candidates_stand_on_open_ground():
    scenario = example_scenario(transmitter=False)
    search = begun(scenario)
    for row, col, _ in search.positions(np.arange(len(search.probability))):
        cell = (int(np.floor(row + 0.5)), int(np.floor(col + 0.5)))
        assert not scenario.grid.contains(cell) or scenario.city.height_m[cell] == 0


def test_measuring_brings_new_candidates_and_keeps_the_old(predictor, rng):
    scenario = example_scenario(transmitter=False)
    belief = predictor.begin(scenario)
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:12]]
    after = belief.updated(Measurements.at(cells, rng.uniform(-130, -70, 12)))
    assert np.array_equal(after.candidates[: len(belief.candidates)], belief.candidates)
    assert len(belief.candidates) < len(after.candidates) <= len(belief.candidates) + 4
    assert np.isclose(after.weights().sum(), 1)
    assert after.whitened.shape == (12, len(after.candidates))


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


def test_candidates_get_their_maps_with_the_first_updates(predictor, rng):
    scenario = example_scenario(transmitter=False)
    slow = replace(predictor, settings=replace(QUICK, first_maps=6, woken=5))
    belief = slow.begin(scenario)
    assert 1 < len(belief.candidates) <= 6
    assert np.isclose(belief.weights().sum(), 1)
    everyone = len(belief.search.chosen)
    free = np.argwhere(scenario.flyable)
    for cell in free[rng.permutation(len(free))[:8]]:
        before = belief
        belief = belief.updated(Measurements.at(cell[None], rng.uniform(-130, -70, 1)))
        assert len(belief.candidates) <= len(before.candidates) + 5 + 1
        assert np.isclose(belief.search.probability.sum(), 1)
    assert set(range(everyone)) <= set(belief.search.mapped.tolist())


def test_what_is_unlikely_gets_no_map_unless_everything_is_wanted(predictor, rng):
    scenario = example_scenario(transmitter=False)
    few = replace(predictor, covered=0.5, settings=replace(QUICK, first_maps=2))
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:6]]
    belief = few.begin(scenario).updated(Measurements.at(cells, rng.uniform(-130, -70, 6)))
    search = belief.search
    mass = np.bincount(search.nearest, search.located, minlength=len(search.chosen))
    assert mass[search.mapped].sum() >= 0.5 - 1e-9
    assert len(search.mapped) < len(search.chosen)
    with pytest.raises(InputError, match="covered must be above 0"):
        replace(predictor, covered=0.0)


def test_the_likeliest_candidates_wake_first(rng):
    search = begun(example_scenario(transmitter=False), coarse_m=16.0, first_maps=5)
    located = rng.random(len(search.located)) ** 4
    search = replace(search, located=located / located.sum())
    mass = np.bincount(search.nearest, search.located, minlength=len(search.chosen))
    woken = search.woken(1.0, 7).mapped
    new, asleep = woken[-7:], np.setdiff1d(np.arange(len(mass)), woken)
    assert np.array_equal(woken[:-7], search.mapped)
    assert mass[new].min() >= mass[asleep].max()
    half = search.woken(0.5, 1000).mapped
    assert mass[half].sum() >= 0.5 > mass[half[:-1]].sum()
