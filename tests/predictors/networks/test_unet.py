"""Predictors that are one network: conformance with untrained weights, and clear words where there
are none."""

import numpy as np
import pytest
import torch

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.networks.unets.direct import DirectNet
from skygain.networks.unets.paper import PaperUNets
from skygain.networks.weights import write_weights
from skygain.predictors.interpolators.idw import IdwPredictor
from skygain.predictors.networks.paper_unet import PaperUNetPredictor, map_blind_unet
from skygain.predictors.networks.unet import UNetPredictor
from skygain.scenario import Scenario
from skygain.testing.predictors import check_predictor, example_scenario


def saved(network, folder):
    path = folder / "untrained.safetensors"
    write_weights(path, network.state_dict(), {"name": "untrained"})
    return path


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    torch.manual_seed(0)
    return PaperUNetPredictor(weights=saved(PaperUNets(), tmp_path_factory.mktemp("paper")))


def test_the_papers_unet_conforms(paper):
    check_predictor(paper)


def test_the_direct_network_conforms(tmp_path):
    torch.manual_seed(0)
    check_predictor(UNetPredictor(weights=saved(DirectNet(), tmp_path)))


def test_the_blind_twin_conforms(tmp_path):
    torch.manual_seed(0)
    check_predictor(map_blind_unet(weights=saved(PaperUNets(blind=True), tmp_path)))


def test_the_blind_twin_gives_every_city_the_same_map(tmp_path):
    torch.manual_seed(0)
    blind = map_blind_unet(weights=saved(PaperUNets(blind=True), tmp_path))
    built, flat = (
        example_scenario(),
        Scenario(City(example_scenario().grid, np.zeros((24, 20), np.float32))),
    )
    assert np.array_equal(
        blind.begin(built).posterior().mean_db, blind.begin(flat).posterior().mean_db
    )


def test_a_map_too_large_for_the_paper_is_refused(paper):
    large = Scenario(City(Grid((97, 40), 4.0), np.zeros((97, 40), np.float32)))
    with pytest.raises(InputError, match="up to 96 × 96 cells"):
        paper.begin(large)


def test_missing_weights_name_the_command_that_makes_them(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYGAIN_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="skygain train predictor --recipe paper-unet-20m"):
        UNetPredictor(weights="paper-unet-20m").begin(example_scenario())
    with pytest.raises(InputError, match=r"there are no weights 'unit' .* did you mean 'unet'"):
        UNetPredictor(weights="unit").begin(example_scenario())


def test_weights_of_another_network_are_refused(tmp_path):
    with pytest.raises(InputError, match="does not fit"):
        PaperUNetPredictor(weights=saved(DirectNet(), tmp_path)).begin(example_scenario())


def scenario_at(altitude_m, spacing_m=4.0):
    city = City(Grid((24, 24), spacing_m), np.zeros((24, 24), np.float32))
    return Scenario(city, uav_altitude_m=altitude_m, prediction_altitude_m=altitude_m)


@pytest.mark.parametrize(
    ("altitude_m", "spacing_m", "uavs", "quantity", "told"),
    [
        (10.0, 4.0, 3, "gain", ""),
        (10.0, 4.0, None, "gain", ""),
        (10.0, 4.0, 5, "gain", "trained for 3 UAVs, here are 5 UAVs"),
        (20.0, 4.0, 1, "gain", "trained for 3 UAVs, 10 m above ground, here are 1 UAV, 20 m"),
        (10.0, 8.0, 3, "power", "cells of 4 m, gains in dB, here are of 8 m, levels in dBm"),
    ],
)
def test_a_survey_unlike_the_training_is_told(altitude_m, spacing_m, uavs, quantity, told):
    scenario = scenario_at(altitude_m, spacing_m)
    line = PaperUNetPredictor().outside_training(scenario, uavs=uavs, quantity=quantity)
    assert bool(line) == bool(told)
    assert told in line


def test_any_number_of_uavs_is_like_the_training_of_the_direct_network():
    network = UNetPredictor()
    assert not network.outside_training(scenario_at(15.0), uavs=7)
    assert "10 to 30 m, here are 60 m" in network.outside_training(scenario_at(60.0), uavs=7)
    assert not IdwPredictor().outside_training(scenario_at(60.0), uavs=7, quantity="power")
