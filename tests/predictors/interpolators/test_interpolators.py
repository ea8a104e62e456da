"""IDW, kNN, GIDS and thin plate splines: exact where measured, equal to their definitions
elsewhere, and honest about their error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.predictors import create_predictor
from skygain.predictors.interpolators import thin_plate
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario
from skygain.testing import check_predictor

GRID = Grid((19, 14), 4.0)
SCENARIO = Scenario(City(GRID, np.zeros(GRID.shape)))


def readings(rng, n, **options) -> Measurements:
    return Measurements.at(
        rng.permutation(GRID.cells)[:n], -100 + 10 * rng.standard_normal(n), **options
    )


def distances(data):
    return np.linalg.norm(GRID.cells[:, None] - data.cell[None], axis=-1)


@pytest.mark.parametrize("name", ["idw", "knn", "gids", "thin-plate"])
def test_keeps_the_promises_of_a_predictor(name):
    check_predictor(create_predictor(name))


@pytest.mark.parametrize("power", [1.0, 2.0, 3.5])
def test_idw_is_the_weighted_mean_of_its_definition(power, rng):
    data = readings(rng, 40)
    mean = create_predictor("idw", power=power).begin(SCENARIO).updated(data).posterior().mean_db
    distance = distances(data)
    free = distance.min(axis=1) > 0
    weight = distance[free] ** -power
    np.testing.assert_allclose(
        mean.ravel()[free], weight @ data.gain_db / weight.sum(axis=1), atol=1e-8
    )


@pytest.mark.parametrize("k", [1, 5, 99])
def test_knn_is_the_mean_of_the_nearest(k, rng):
    """Where the k-th and the next reading are equally near, the definition leaves the choice open;
    those cells are left out."""
    data = readings(rng, 40)
    mean = create_predictor("knn", k=k).begin(SCENARIO).updated(data).posterior().mean_db.ravel()
    distance = distances(data)
    order = np.argsort(distance, axis=1)
    near = np.take_along_axis(distance, order, axis=1)
    clear = (near[:, 0] > 0) & ((near[:, k - 1] < near[:, k]) if k < 40 else True)
    np.testing.assert_allclose(
        mean[clear], data.gain_db[order[:, : min(k, 40)]].mean(axis=1)[clear]
    )


@pytest.mark.parametrize("name", ["idw", "knn", "gids", "thin-plate", "tensor"])
def test_the_variance_is_about_the_squared_error(name):
    """On fields of a known covariance the mean squared error over variance is near 1."""
    if name == "tensor":
        pytest.importorskip("tensorly", reason="needs the extra 'tensor'")
    rng = np.random.default_rng(5)
    grid = Grid((40, 40), 4.0)
    scenario = Scenario(City(grid, np.zeros(grid.shape)))
    xy = grid.xy_m(grid.cells)
    truth = KrigingParameters.known_trend(-100.0, sill_db2=150.0, range_m=30.0)
    distance = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    root = np.linalg.cholesky(
        truth.sill_db2 * np.exp(-distance / truth.range_m) + 1e-9 * np.eye(len(xy))
    )
    ratios = []
    for _ in range(6):
        field = -100 + root @ rng.standard_normal(len(xy))
        cells = rng.permutation(len(xy))[:120]
        posterior = (
            create_predictor(name)
            .begin(scenario)
            .updated(Measurements.at(grid.cells[cells], field[cells]))
            .posterior()
        )
        free = np.setdiff1d(np.arange(len(xy)), cells)
        error = posterior.mean_db.ravel()[free] - field[free]
        ratios.append(np.mean(error**2 / posterior.variance_db2.ravel()[free]))
    assert 0.6 < np.mean(ratios) < 1.6


def test_gids_is_the_sum_of_its_definition(rng):
    data = readings(rng, 40)
    mean = create_predictor("gids").begin(SCENARIO).updated(data).posterior().mean_db.ravel()
    xy, here = GRID.xy_m(GRID.cells), GRID.xy_m(data.cell)
    slope = np.linalg.lstsq(np.column_stack([np.ones(40), here]), data.gain_db, rcond=None)[0][1:]
    distance = distances(data)
    free = distance.min(axis=1) > 0
    weight = distance[free] ** -2.0
    moved = data.gain_db + (xy[free, None] - here[None]) @ slope
    np.testing.assert_allclose(
        mean[free], (weight * moved).sum(axis=1) / weight.sum(axis=1), atol=1e-8
    )


@pytest.mark.parametrize("name", ["gids", "thin-plate"])
def test_a_plane_is_reproduced(name, rng):
    cells = rng.permutation(GRID.cells)[:25]
    x, y = GRID.xy_m(GRID.cells).T
    plane = -100 + 0.1 * x - 0.2 * y
    posterior = (
        create_predictor(name)
        .begin(SCENARIO)
        .updated(Measurements.at(cells, plane[GRID.flat(cells)]))
        .posterior()
    )
    np.testing.assert_allclose(posterior.mean_db.ravel(), plane, atol=1e-4)


@pytest.mark.parametrize("name", ["gids", "thin-plate"])
def test_readings_on_a_line_give_finite_answers(name):
    cells = [[4, c] for c in range(10)]
    posterior = (
        create_predictor(name)
        .begin(SCENARIO)
        .updated(Measurements.at(cells, np.linspace(-90, -110, 10)))
        .posterior()
    )
    assert np.isfinite(posterior.mean_db).all()
    assert np.abs(posterior.mean_db + 100).max() < 60


def test_thin_plate_equals_scipy(rng):
    data = readings(rng, 40)
    xy, here = GRID.xy_m(GRID.cells), GRID.xy_m(data.cell)
    mean = create_predictor("thin-plate").begin(SCENARIO).updated(data).posterior().mean_db.ravel()
    free = distances(data).min(axis=1) > 0
    # Our roughness is found by likelihood; SciPy is given the same one.
    centred = here - here.mean(axis=0)
    extent = np.linalg.svd(centred, compute_uv=False)[0] / np.sqrt(40)
    unit = centred / extent
    roughness, _ = thin_plate.roughness_and_scale(
        thin_plate.kernel(unit, unit), thin_plate.plane(unit), data.gain_db - data.gain_db.mean()
    )
    peer = RBFInterpolator(
        unit, data.gain_db, kernel="thin_plate_spline", degree=1, smoothing=roughness
    )
    np.testing.assert_allclose(mean[free], peer((xy - here.mean(axis=0)) / extent)[free], atol=1e-6)


def test_a_noisy_reading_keeps_its_noise_as_variance():
    data = Measurements.at([[3, 4]], [-90.0], noise_std_db=2.0)
    posterior = create_predictor("idw").begin(SCENARIO).updated(data).posterior()
    assert posterior.mean_db[3, 4] == -90.0
    assert posterior.variance_db2[3, 4] == 4.0


@pytest.mark.parametrize(
    ("name", "options"), [("idw", {"power": 0.0}), ("idw", {"power": 9.0}), ("knn", {"k": 0})]
)
def test_senseless_options_are_refused(name, options):
    with pytest.raises(InputError):
        create_predictor(name, **options)
