"""The cheap gain model of one path."""

import numpy as np
import pytest

from skygain.networks.operator.features import CHANNELS, fill_cells, operator_inputs
from skygain.networks.operator.path_model import PathModel
from skygain.networks.weights import find_weights


@pytest.fixture(scope="module")
def shipped():
    return PathModel.load(find_weights("path-model"))


def test_features_at_cells_are_those_of_the_whole_map(rng):
    height = (30 * (rng.random((12, 14)) < 0.3)).astype(np.float32)
    transmitters, cells = (
        np.array([[4.0, 9.0, 1.5], [-7.0, 3.0, 1.5]]),
        np.array([[0, 0], [11, 5], [3, 13]]),
    )
    found = np.empty((3, 2, len(CHANNELS)), dtype=np.float32)
    fill_cells(height, 4.0, transmitters, cells, 10.0, found)
    maps = operator_inputs(height, 4.0, transmitters, 10.0)
    assert np.allclose(found, maps[:, :, cells[:, 0], cells[:, 1]].transpose(2, 0, 1), atol=1e-6)


def test_free_sight_follows_free_space(shipped):
    cells = np.array([[10, 15], [10, 40], [10, 90]])
    mean, std = shipped.gain(
        np.zeros((20, 96), np.float32), 4.0, np.array([[10.0, 5.0, 1.5]]), cells, 10.0
    )
    free_space = -46.43 - 20 * np.log10(np.hypot(4.0 * (cells[:, 1] - 5), 8.5))
    assert np.abs(mean[:, 0] - free_space).max() < 5.0
    assert (std > 0).all()


def test_a_wall_costs_gain_and_certainty(shipped):
    street, walled = np.zeros((20, 60), np.float32), np.zeros((20, 60), np.float32)
    walled[:, 20:30] = 30.0
    cell, tx = np.array([[10, 50]]), np.array([[10.0, 5.0, 1.5]])
    (clear, sure), (blocked, unsure) = (
        shipped.gain(h, 4.0, tx, cell, 10.0) for h in (street, walled)
    )
    assert blocked[0, 0] < clear[0, 0] - 20
    assert unsure[0, 0] > sure[0, 0]
