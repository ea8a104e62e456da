"""Policies by recipe: what does not exist is named."""

from __future__ import annotations

import pytest

from skygain.ground.errors import InputError
from skygain.training.policies.recipes import train_policy


def test_unknown_recipes_settings_and_weights_are_refused(tmp_path):
    with pytest.raises(InputError, match="known: dqn, dqn-rewards-only, imitation, paper-dqn"):
        train_policy("a3c", "sample", tmp_path)
    with pytest.raises(InputError, match="no setting `start_from`"):
        train_policy("imitation", "sample", tmp_path, start_from="x")
