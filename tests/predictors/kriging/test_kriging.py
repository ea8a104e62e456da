"""Kriging against independent libraries, and the properties that planners rely on."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import check_grad

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.kriging.known_source import KrigingPredictor, blind_kriging
from skygain.predictors.kriging.parameters import (
    KrigingParameters,
    trained_parameters,
    trend_columns,
)
from skygain.predictors.kriging.survey_fit import likelihood_loss, map_estimate
from skygain.scenario import Scenario
from skygain.testing import check_predictor
from skygain.testing.predictors import example_scenario

SHAPE = (17, 23)
SIMPLE = KrigingParameters.known_trend(27.0, 72.0, sill_db2=380.0, range_m=57.0)


def open_ground(shape=SHAPE, **options) -> Scenario:
    return Scenario(
        City(Grid(shape, 4.0), np.zeros(shape)), transmitter_m=(31.0, -17.0, 1.5), **options
    )


def random_readings(rng, n, *, noise=None, shape=SHAPE) -> Measurements:
    cells = rng.permutation(Grid(shape, 4.0).cells)[:n]
    return Measurements.at(
        cells, -110 + 15 * rng.standard_normal(n), noise_std_db=0.0 if noise is None else noise
    )


def unmeasured(scenario, data):
    return ~data.visited(scenario.grid.shape)


@pytest.mark.parametrize("seed", range(4))
def test_equals_gaussian_process_regression_of_scikit_learn(seed):
    gaussian_process = pytest.importorskip("sklearn.gaussian_process")
    kernels = gaussian_process.kernels
    rng = np.random.default_rng(seed)
    sill, delta, nugget = rng.uniform(50, 500), rng.uniform(10, 120), rng.uniform(0.5, 20)
    scenario = open_ground()
    data = random_readings(rng, 70, noise=rng.uniform(0.1, 4.0, 70) * (rng.random(70) < 0.7))
    parameters = KrigingParameters.known_trend(
        27.0, 72.0, sill_db2=sill, range_m=delta, nugget_db2=nugget
    )
    belief = KrigingPredictor(parameters=parameters, refit=False).begin(scenario)
    for part in np.array_split(np.arange(70), 9):  # a belief that grew must equal one solve
        belief = belief.updated(data.taken(part))

    kernel = kernels.ConstantKernel(sill, "fixed") * kernels.Matern(
        delta, "fixed", nu=0.5
    ) + kernels.WhiteKernel(nugget, "fixed")
    xy = scenario.grid.xy_m(scenario.grid.cells)
    line = trend_columns("log-distance", scenario.grid, 10.0, scenario.transmitter_m) @ [27.0, 72.0]
    measured = scenario.grid.flat(data.cell)
    peer = gaussian_process.GaussianProcessRegressor(
        kernel, alpha=data.noise_std_db**2 + 1e-12, optimizer=None
    )
    peer.fit(xy[measured], data.gain_db - line[measured])
    mean, std = peer.predict(xy, return_std=True)
    free = unmeasured(scenario, data)
    posterior = belief.posterior()
    np.testing.assert_allclose(
        posterior.mean_db[free], (mean + line).reshape(SHAPE)[free], atol=1e-6
    )
    np.testing.assert_allclose(
        posterior.variance_db2[free], (std**2).reshape(SHAPE)[free], atol=1e-6 * sill
    )

    cells = np.argwhere(free)[rng.permutation(free.sum())[:12]]
    _, joint = peer.predict(scenario.grid.xy_m(cells), return_cov=True)
    np.testing.assert_allclose(posterior.covariance(cells), joint, atol=1e-6 * sill)


@pytest.mark.parametrize("range_m", [4e3, 4e5, 4e7])
def test_nearly_coincident_cells_are_told_apart_as_scikit_learn_does(range_m):
    """Cells of 4 m under a correlation that reaches up to ten million of them."""
    gaussian_process = pytest.importorskip("sklearn.gaussian_process")
    rng = np.random.default_rng(3)
    scenario, sill = open_ground(), 300.0
    cells = np.argwhere(np.ones((6, 7), dtype=bool))[rng.permutation(42)[:30]]
    difference = rng.standard_normal(len(cells)) * np.sqrt(2 * sill * 4.0 / range_m)
    data = Measurements.at(cells, -100 + difference)
    parameters = KrigingParameters.known_trend(27.0, 72.0, sill_db2=sill, range_m=range_m)
    predictor = KrigingPredictor(parameters=parameters, refit=False)
    posterior = predictor.begin(scenario).updated(data).posterior()

    kernels = gaussian_process.kernels
    kernel = kernels.ConstantKernel(sill, "fixed") * kernels.Matern(range_m, "fixed", nu=0.5)
    xy = scenario.grid.xy_m(scenario.grid.cells)
    line = trend_columns("log-distance", scenario.grid, 10.0, scenario.transmitter_m) @ [27.0, 72.0]
    measured = scenario.grid.flat(cells)
    peer = gaussian_process.GaussianProcessRegressor(kernel, alpha=1e-12 * sill, optimizer=None)
    peer.fit(xy[measured], data.gain_db - line[measured])
    mean, std = peer.predict(xy, return_std=True)
    near = unmeasured(scenario, data)
    near[8:] = False
    near[:, 9:] = False
    both = (posterior.mean_db - line.reshape(SHAPE))[near], posterior.std_db[near]
    np.testing.assert_allclose(both[0], mean.reshape(SHAPE)[near], atol=1e-4)
    np.testing.assert_allclose(both[1], std.reshape(SHAPE)[near], atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_equals_simple_kriging_of_gstools(seed):
    gstools = pytest.importorskip("gstools")
    rng = np.random.default_rng(seed)
    scenario = open_ground()
    noise = rng.uniform(0.5, 3.0, 60)
    data = random_readings(rng, 60, noise=noise)
    parameters = KrigingParameters.known_trend(-108.0, sill_db2=300.0, range_m=40.0)
    posterior = (
        blind_kriging(parameters=parameters, refit=False).begin(scenario).updated(data).posterior()
    )

    model = gstools.Exponential(dim=2, var=300.0, len_scale=40.0)
    xy = scenario.grid.xy_m(data.cell)
    peer = gstools.krige.Simple(
        model, xy.T, data.gain_db, mean=-108.0, cond_err=noise**2, exact=False
    )
    mean, variance = peer(scenario.grid.xy_m(scenario.grid.cells).T)
    np.testing.assert_allclose(posterior.mean_db.ravel(), mean, atol=1e-6)
    np.testing.assert_allclose(posterior.variance_db2.ravel(), variance, atol=1e-6 * 300)


@pytest.mark.parametrize("trend", ["constant", "log-distance"])
def test_with_a_vague_trend_it_equals_universal_kriging_of_pykrige(trend, rng):
    uk = pytest.importorskip("pykrige.uk")
    scenario = open_ground()
    data = random_readings(rng, 60)
    columns = trend_columns(trend, scenario.grid, 10.0, scenario.transmitter_m)
    k = columns.shape[1]
    vague = KrigingParameters(
        (0.0,) * k, tuple(map(tuple, 1e10 * np.eye(k))), sill_db2=250.0, range_m=30.0
    )
    posterior = (
        KrigingPredictor(trend, vague, refit=False).begin(scenario).updated(data).posterior()
    )

    xy, everywhere = scenario.grid.xy_m(data.cell), scenario.grid.xy_m(scenario.grid.cells)
    drift = columns[:, 1:].T  # the constant is always part of it
    peer = uk.UniversalKriging(
        *xy.T,
        data.gain_db,
        variogram_model="exponential",
        variogram_parameters={"psill": 250.0, "range": 3 * 30.0, "nugget": 0.0},
        drift_terms=["specified"] if k > 1 else [],
        specified_drift=[row[scenario.grid.flat(data.cell)] for row in drift],
    )
    options = {"specified_drift_arrays": list(drift)} if k > 1 else {}
    mean, variance = peer.execute("points", *everywhere.T, **options)
    free = unmeasured(scenario, data).ravel()
    np.testing.assert_allclose(posterior.mean_db.ravel()[free], mean[free], atol=1e-5)
    np.testing.assert_allclose(
        posterior.variance_db2.ravel()[free], variance[free], atol=1e-6 * 250
    )


@pytest.mark.parametrize("name", ["kriging", "kriging-blind", "kriging-quadratic"])
@pytest.mark.parametrize("refit", [True, False])
def test_keeps_the_promises_of_a_predictor(name, refit):
    check_predictor(create_predictor(name, refit=refit))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_variance_never_grows_with_data(seed, known_trend):
    rng = np.random.default_rng(seed)
    parameters = SIMPLE if known_trend else trained_parameters("log-distance", 10.0)
    scenario = open_ground((9, 11))
    belief = KrigingPredictor(parameters=parameters, refit=False).begin(scenario)
    variance = belief.posterior().variance_db2
    for _ in range(6):
        n = int(rng.integers(1, 9))
        cells = rng.integers((0, 0), (9, 11), size=(n, 2))
        noise = rng.uniform(0, 3, n) * rng.integers(0, 2, n)
        belief = belief.updated(
            Measurements.at(cells, -100 + 20 * rng.standard_normal(n), noise_std_db=noise)
        )
        next_variance = belief.posterior().variance_db2
        assert (next_variance <= variance + 1e-9 * parameters.sill_db2).all()
        assert (next_variance >= 0).all()
        variance = next_variance


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_branches_do_not_disturb_each_other(seed):
    """Every belief of a random tree of updates equals one that took the same readings in alone."""
    rng = np.random.default_rng(seed)
    scenario = open_ground()
    predictor = KrigingPredictor(parameters=SIMPLE, refit=False)
    data = random_readings(rng, 320)
    tree = [(predictor.begin(scenario), np.empty(0, dtype=int))]
    for _ in range(9):
        belief, taken = tree[rng.integers(len(tree))]
        more = rng.permutation(np.setdiff1d(np.arange(320), taken))[: rng.integers(1, 70)]
        tree.append((belief.updated(data.taken(more)), np.concatenate([taken, more])))
    for belief, taken in tree:
        alone = predictor.begin(scenario).updated(data.taken(taken))
        np.testing.assert_allclose(belief.posterior().mean_db, alone.posterior().mean_db, atol=1e-7)
        np.testing.assert_allclose(
            belief.posterior().variance_db2, alone.posterior().variance_db2, atol=1e-7
        )


def test_noisy_repeats_count_as_their_weighted_mean(rng):
    scenario = open_ground()
    predictor = KrigingPredictor(parameters=SIMPLE, refit=False)
    cell = [[4, 5]]
    apart = predictor.begin(scenario)
    for gain, std in ((-90.0, 1.0), (-96.0, 2.0), (-93.0, 0.5)):
        apart = apart.updated(Measurements.at(cell, [gain], noise_std_db=std))
    weight = 1 / np.array([1.0, 4.0, 0.25])
    mean = weight @ [-90.0, -96.0, -93.0] / weight.sum()
    together = predictor.begin(scenario).updated(
        Measurements.at(cell, [mean], noise_std_db=weight.sum() ** -0.5)
    )
    np.testing.assert_allclose(apart.posterior().mean_db, together.posterior().mean_db, atol=1e-9)
    np.testing.assert_allclose(
        apart.posterior().variance_db2, together.posterior().variance_db2, atol=1e-9
    )


def test_prediction_at_another_altitude_equals_scikit_learn_in_three_dimensions(rng):
    gaussian_process = pytest.importorskip("sklearn.gaussian_process")
    kernels = gaussian_process.kernels
    scenario = open_ground(uav_altitude_m=30.0, prediction_altitude_m=10.0)
    data = random_readings(rng, 50)
    posterior = (
        KrigingPredictor(parameters=SIMPLE, refit=False).begin(scenario).updated(data).posterior()
    )
    xy = scenario.grid.xy_m(scenario.grid.cells)
    low, high = (np.column_stack([xy, np.full(len(xy), z)]) for z in (10.0, 30.0))
    line_low, line_high = (
        trend_columns("log-distance", scenario.grid, z, scenario.transmitter_m) @ [27.0, 72.0]
        for z in (10.0, 30.0)
    )
    measured = scenario.grid.flat(data.cell)
    kernel = kernels.ConstantKernel(380.0, "fixed") * kernels.Matern(57.0, "fixed", nu=0.5)
    peer = gaussian_process.GaussianProcessRegressor(kernel, alpha=1e-10, optimizer=None)
    peer.fit(high[measured], data.gain_db - line_high[measured])
    mean, std = peer.predict(low, return_std=True)
    np.testing.assert_allclose(posterior.mean_db.ravel(), mean + line_low, atol=1e-5)
    np.testing.assert_allclose(posterior.std_db.ravel(), std, atol=1e-5)


def test_a_reading_at_the_floor_pulls_the_belief_below_it():
    """One such reading gives the moments of the normal cut off at the floor, by Monte Carlo."""
    scenario = open_ground()
    belief = KrigingPredictor(parameters=SIMPLE, refit=False).begin(scenario)
    before = belief.posterior()
    floor = float(before.mean_db[3, 3]) - 5.0
    after = belief.updated(Measurements.at([[3, 3]], [floor], censored=True)).posterior()
    draws = before.mean_db[3, 3] + before.std_db[3, 3] * np.random.default_rng(0).standard_normal(
        400_000
    )
    kept = draws[draws <= floor]
    assert after.mean_db[3, 3] == pytest.approx(kept.mean(), abs=0.1)
    assert after.std_db[3, 3] == pytest.approx(kept.std(), abs=0.1)


def test_a_reading_at_a_floor_far_above_the_belief_is_no_news():
    belief = KrigingPredictor(parameters=SIMPLE, refit=False).begin(open_ground())
    after = belief.updated(Measurements.at([[3, 3]], [-20.0], censored=True))
    assert len(after.measurements) == 1
    np.testing.assert_array_equal(after.posterior().mean_db, belief.posterior().mean_db)


def correlated_field(rng, n, sill, delta):
    """Readings of a field of known covariance, as (positions, values, distances)."""
    xy = 4.0 * rng.permutation(Grid((40, 40), 4.0).cells)[:n]
    distance = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    return (
        xy,
        -105
        + np.linalg.cholesky(sill * np.exp(-distance / delta) + 0.5 * np.eye(n))
        @ rng.standard_normal(n),
        distance,
    )


def test_the_gradient_of_the_likelihood_is_its_slope(rng):
    _, gain, distance = correlated_field(rng, 40, 40.0, 20.0)
    trend_part = np.full((40, 40), 25.0)

    def loss(x):
        return likelihood_loss(x, distance, gain + 100, np.full(40, 0.3), trend_part)

    at = np.log([80.0, 35.0, 2.0])
    assert check_grad(lambda x: loss(x)[0], lambda x: loss(x)[1], at) < 1e-3


def test_the_fit_explains_the_data_at_least_as_well_as_the_covariance_that_made_them(rng):
    """With a vague prior and many readings; the truth itself is one of the candidates."""
    _, gain, distance = correlated_field(rng, 250, 40.0, 20.0)
    vague = KrigingParameters(
        (-110.0,),
        ((100.0,),),
        sill_db2=380.0,
        range_m=57.0,
        nugget_db2=5.0,
        log_spread=(9.0, 9.0, 9.0),
    )
    _, fitted = map_estimate(vague, distance, gain, np.zeros(250), np.ones((250, 1)))

    def loss(phi, delta, nu):
        return likelihood_loss(
            np.log([phi, delta, nu]),
            distance,
            gain + 110,
            np.zeros(250),
            np.full((250, 250), 100.0),
        )[0]

    assert loss(fitted.sill_db2, fitted.range_m, fitted.nugget_db2) < loss(40.0, 20.0, 0.5) + 0.5


def test_levels_that_are_no_gains_do_not_spoil_kriging_with_a_mast(rng):
    """On a field of another kind, in dBm, with a transmitter unlike the trained ones, it stays
    ahead of IDW from ten readings on."""
    city = City(Grid((40, 40), 4.0), np.zeros((40, 40)))
    scenario = Scenario(
        city, uav_altitude_m=1.5, prediction_altitude_m=1.5, transmitter_m=(80.0, 80.0, 25.0)
    )
    errors = {"kriging": [], "idw": []}
    for _ in range(8):
        xy, gain, _ = correlated_field(rng, 400, 60.0, 30.0)
        cells = scenario.grid.cells_at(xy)
        for name, list_ in errors.items():
            posterior = (
                create_predictor(name)
                .begin(scenario)
                .updated(Measurements.at(cells[:15], gain[:15]))
                .posterior()
            )
            list_.append(
                np.sqrt(np.mean((posterior.mean_db[cells[15:, 0], cells[15:, 1]] - gain[15:]) ** 2))
            )
    assert np.mean(errors["kriging"]) <= np.mean(errors["idw"])


def test_many_exact_readings_stay_stable():
    """Every second cell of a map with a long correlation and no nugget: the worst conditioned case
    there is."""
    rng = np.random.default_rng(0)
    scenario = open_ground((30, 30))
    stiff = KrigingParameters.known_trend(-100.0, sill_db2=400.0, range_m=2000.0)
    belief = blind_kriging(parameters=stiff, refit=False).begin(scenario)
    order = rng.permutation(900)[:450]
    field = 10 * np.sin(scenario.grid.cells[:, 0] / 7.0) + scenario.grid.cells[:, 1] - 100
    for part in np.array_split(order, 90):
        belief = belief.updated(Measurements.at(scenario.grid.cells[part], field[part]))
    posterior = belief.posterior()
    assert np.abs(posterior.mean_db.ravel() - field).max() < 3.0
    assert posterior.variance_db2.max() < 3.0


@pytest.mark.parametrize("transform", [0.0, 5.0, 1e9])
def test_variances_do_not_depend_on_who_looked_when(transform, rng, monkeypatch):
    """Nor, but for rounding, on whether they are summed by products or by transforms."""
    scenario, data = open_ground(), random_readings(rng, 150, noise=0.5)
    expected = begun(scenario).updated(data).posterior()
    monkeypatch.setattr("skygain.fields.gaussian_process.TRANSFORM", transform)
    asked = unasked = begun(scenario)
    for first in range(0, 150, 7):
        part = data.taken(np.arange(first, min(first + 7, 150)))
        asked, unasked = asked.updated(part), unasked.updated(part)
        asked.posterior()
    one, other = asked.posterior(), unasked.posterior()
    assert np.array_equal(one.variance_db2, other.variance_db2)
    assert np.array_equal(one.mean_db, other.mean_db)
    assert np.allclose(one.variance_db2, expected.variance_db2, rtol=1e-9, atol=1e-7)
    assert np.allclose(one.mean_db, expected.mean_db, atol=1e-6)


def begun(scenario):
    parameters = KrigingParameters.known_trend(
        27.0, 72.0, sill_db2=90.0, range_m=25.0, nugget_db2=4.0
    )
    return KrigingPredictor(parameters=parameters, refit=False).begin(scenario)


def test_kriging_without_a_transmitter_names_the_alternatives():
    scenario = open_ground().without_transmitter()
    with pytest.raises(InputError, match="kriging-blind"):
        create_predictor("kriging").begin(scenario)


def test_readings_off_the_map_are_refused():
    belief = create_predictor("kriging").begin(open_ground())
    with pytest.raises(InputError, match="off the map"):
        belief.updated(Measurements.at([[99, 0]], [-100.0]))


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"trend": "cubic"}, "unknown trend"),
        ({"trend": "constant", "parameters": SIMPLE}, "coefficients"),
    ],
)
def test_wrong_options_are_refused(options, word):
    with pytest.raises(InputError, match=word):
        KrigingPredictor(**options)


def test_parameters_between_trained_altitudes_lie_between():
    low, middle, high = (trained_parameters("constant", z) for z in (10.0, 15.0, 20.0))
    assert min(low.sill_db2, high.sill_db2) <= middle.sill_db2 <= max(low.sill_db2, high.sill_db2)
    assert trained_parameters("constant", 2.0) == low


def test_a_single_reading_is_taken_without_a_warning():
    scenario = example_scenario(transmitter=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        posterior = (
            create_predictor("kriging-blind")
            .begin(scenario)
            .updated(Measurements.at([[0, 0]], [-90.0]))
            .posterior()
        )
    assert np.isfinite(posterior.mean_db).all()
