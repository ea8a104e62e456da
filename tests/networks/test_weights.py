"""Where weights are looked for, and what is said when they are not there."""

import importlib.util

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.networks.weights import (
    POLICIES,
    TRAINABLE,
    export_weights,
    find_weights,
    read_weights,
    write_weights,
)
from skygain.predictors import create_predictor
from skygain.testing.predictors import example_scenario


def test_the_papers_weights_missing_name_the_command_that_brings_them(monkeypatch, tmp_path):
    monkeypatch.setenv("SKYGAIN_CACHE", str(tmp_path))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install .*paper-weights$"):
        create_predictor("paper-unet").begin(example_scenario())
    with pytest.raises(InputError, match="skygain train predictor --recipe paper-unet-mapblind"):
        create_predictor("paper-unet-mapblind").begin(example_scenario())


def test_weights_trained_here_are_found_by_name(monkeypatch, tmp_path):
    monkeypatch.setenv("SKYGAIN_CACHE", str(tmp_path))
    file = tmp_path / "runs" / "mine" / "mine.safetensors"
    write_weights(file, {"a": np.arange(3.0)}, {"name": "mine"})
    assert find_weights("mine") == file
    assert read_weights("mine").card == {"name": "mine"}


def test_of_a_checkpoint_the_averages_are_read_and_exported(tmp_path):
    arrays = {
        "network.a": np.zeros(3, np.float32),
        "average.a": np.ones(3, np.float32),
        "average.norm.num_batches_tracked": np.array(7),
    }
    meta = {
        "step": 5,
        "seconds": 2.2,
        "scores": {"rmse_db": 1.0},
        "config": {"batch_size": 4, "out": "/somewhere", "task": {"profile": False}},
    }
    write_weights(tmp_path / "checkpoint.safetensors", arrays, meta)
    export_weights(tmp_path / "checkpoint.safetensors", tmp_path / "w.safetensors", {"name": "w"})
    found = read_weights(tmp_path / "w.safetensors")
    assert {key: value.tolist() for key, value in found.arrays.items()} == {"a": [1.0] * 3}
    assert found.card["samples"] == 20
    assert found.task == {"profile": False}
    assert "/somewhere" not in str(found.card)


@pytest.mark.parametrize(
    "name", ["dqn", "imitation", "judge", "locator", "operator", "path-model", "unet"]
)
def test_shipped_cards_have_one_form(name):
    card = read_weights(name).card
    assert card["name"] == name
    assert card["scores"]
    assert isinstance(card["recipe"], dict)
    assert card["data"]


def test_every_recipe_is_known_by_name() -> None:
    pytest.importorskip("torch")
    from skygain.training.policies.recipes import POLICY_RECIPES
    from skygain.training.recipes import RECIPES

    assert tuple(RECIPES) == TRAINABLE
    assert tuple(POLICY_RECIPES) == POLICIES
