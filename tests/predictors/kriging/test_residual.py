"""Residual Kriging: the textbook Gaussian process on a network's residuals, and the promises of
every predictor."""

import numpy as np
import pytest
import torch
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from skygain.fields.residual_field import CorrelationModel
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.networks.unets.direct import DirectNet
from skygain.networks.weights import write_weights
from skygain.posterior import Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.kriging.residual import ResidualKrigingPredictor
from skygain.predictors.networks.unet import UNetPredictor
from skygain.testing.predictors import check_predictor, example_scenario


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    torch.manual_seed(0)
    file = tmp_path_factory.mktemp("weights") / "unet.safetensors"
    write_weights(file, DirectNet().state_dict(), {"name": "untrained"})
    return UNetPredictor(weights=file)


class Slope(Predictor):
    """A mean that never looks at a reading."""

    interpolates = False

    def begin(self, scenario):
        return SlopeBelief(scenario, Measurements.none())


class SlopeBelief(Belief):
    def __init__(self, scenario, measurements):
        self.scenario, self.measurements = scenario, measurements

    def updated(self, measurements):
        return SlopeBelief(self.scenario, self.measurements.extended(measurements))

    def posterior(self):
        rows, cols = np.indices(self.scenario.grid.shape)
        return Posterior(-100.0 - 0.5 * rows, 16.0 + 0.0 * cols)


def test_conforms_on_a_network(network):
    check_predictor(ResidualKrigingPredictor(network))


def test_conforms_on_a_mean_of_ones_own():
    check_predictor(ResidualKrigingPredictor(Slope()))


def test_equals_scikit_learn_on_a_fixed_mean(rng):
    scenario = example_scenario()
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:20]]
    gain, noise = rng.normal(-110, 8, 20), rng.uniform(0.5, 2.0, 20)
    model = CorrelationModel(length_m=20.0, far_share=0.0, nugget=0.2)
    belief = (
        ResidualKrigingPredictor(Slope(), model)
        .begin(scenario)
        .updated(Measurements.at(cells, gain, noise_std_db=noise))
    )
    posterior = belief.posterior()
    kernel = ConstantKernel(0.8, "fixed") * Matern(20.0, "fixed", nu=0.5)
    process = GaussianProcessRegressor(kernel, alpha=(noise / 4.0) ** 2 + 0.2, optimizer=None)
    process.fit(4.0 * cells, (gain - (-100.0 - 0.5 * cells[:, 0])) / 4.0)
    elsewhere = free[rng.permutation(len(free))[:50]]
    elsewhere = elsewhere[~(elsewhere[:, None] == cells[None]).all(-1).any(1)]
    mean, std = process.predict(4.0 * elsewhere, return_std=True)
    at = tuple(elsewhere.T)
    assert np.allclose(
        posterior.mean_db[at], -100.0 - 0.5 * elsewhere[:, 0] + 4.0 * mean, atol=1e-2
    )
    assert np.allclose(posterior.std_db[at], 4.0 * np.sqrt(std**2 + 0.2), atol=1e-2)


def test_a_mean_that_passes_through_the_readings_is_refused():
    with pytest.raises(InputError, match="leaves no residual"):
        ResidualKrigingPredictor("idw").begin(example_scenario())
    with pytest.raises(InputError, match="another predictor"):
        ResidualKrigingPredictor("residual-kriging").begin(example_scenario())
