"""Policy networks and their weight files."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from skygain.ground.errors import InputError
from skygain.networks.policies.network import policy_network
from skygain.networks.policies.weights import export_policy
from skygain.networks.torch_runtime import load_policy
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.testing.planners import check_planner, planner_scenarios


def test_the_paper_network_has_the_table_sizes():
    network = policy_network({"network": "paper", "atoms": 40, "side": 96, "dueling": False})
    shapes = [
        tuple(m(torch.zeros(1, 5, 96, 96)).shape[1:])
        for m in (network.features[:1], network.features[:3], network.features)
    ]
    assert shapes == [(64, 48, 48), (128, 24, 24), (256, 12, 12)]
    assert [m.out_features for m in network.head if hasattr(m, "out_features")] == [
        512,
        256,
        40,
        160,
    ]


def test_weights_as_bytes_leave_the_decisions_alone(tmp_path, rng):
    torch.manual_seed(0)
    shape = {"network": "paper", "atoms": 5, "side": 48, "dueling": False}
    network = policy_network(shape)
    path = tmp_path / "policy.safetensors"
    export_policy(network.state_dict(), path, {"policy": {**shape, "v_min": 0.0, "v_max": 1.0}})
    loaded, z = load_policy(path), torch.linspace(0.0, 1.0, 5)
    assert path.stat().st_size < 0.3 * sum(4 * p.numel() for p in network.parameters())
    x = torch.from_numpy(rng.random((50, 5, 48, 48), dtype=np.float32))
    with torch.no_grad():
        one, two = (torch.softmax(net(x), -1) @ z for net in (network, loaded))
    assert (one - two).abs().max() < 0.05 * (one.max(1).values - one.min(1).values).mean()


def test_a_policy_with_the_papers_network_conforms(tmp_path):
    torch.manual_seed(0)
    shape = {"network": "paper", "atoms": 5, "side": 48, "dueling": False}
    file = tmp_path / "policy.safetensors"
    export_policy(
        policy_network(shape).state_dict(), file, {"policy": {**shape, "v_min": -1.0, "v_max": 1.0}}
    )
    planner = create_planner("dqn", weights=str(file))
    check_planner(
        planner, create_predictor("idw"), settings=[planner_scenarios()[k] for k in (0, 3, 9)]
    )


def test_weights_that_are_not_there_are_asked_for(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYGAIN_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="train policy --recipe dqn-thin-plate"):
        load_policy("dqn-thin-plate")
    with pytest.raises(InputError, match=r"no policy 'imitate' .* did you mean 'imitation'"):
        load_policy("imitate")
