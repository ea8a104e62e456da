from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from skygain.flight.moves import MOVES
from skygain.ground.errors import InputError
from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.policies.inputs import (
    SYMMETRIES,
    Seen,
    centred_view,
    turned_moves,
    turned_view,
)
from skygain.networks.policies.network import policy_network
from skygain.networks.policies.weights import export_policy, load_policy
from skygain.networks.unets.paper import PaperUNets
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.testing.planners import check_planner, planner_scenarios
from skygain.training.policies.dqn import DqnConfig, train_dqn
from skygain.training.policies.imitation import ImitationConfig, train_imitation
from skygain.training.policies.recipes import train_policy

SMALL = DqnConfig(
    predictor="idw",
    network="centred",
    double=True,
    dueling=True,
    side=32,
    steps=8,
    lanes=2,
    n_uavs=2,
    split="T1",
    n_steps=3,
    warmup=24,
    capacity=80,
    batch_size=8,
    learn_every=2,
    target_every=5,
    exploration=0.2,
    checkpoint_steps=12,
    log_steps=6,
    augment=True,
    bf16=False,
)


def tensors(result):
    return load_checkpoint(result.checkpoint)[0]


@pytest.mark.parametrize("predictor", ["idw", "network"])
def test_a_resumed_dqn_run_ends_with_the_same_weights(tmp_path, predictor):
    config = SMALL
    if (
        predictor == "network"
    ):  # its last bits depend on how many surveys it is asked about together
        torch.manual_seed(0)
        save_checkpoint(
            tmp_path / "unets.safetensors", PaperUNets().state_dict(), {"name": "untrained"}
        )
        config = replace(SMALL, predictor=f"paper-unet:weights={tmp_path / 'unets.safetensors'}")
    whole = train_dqn(replace(config, out=str(tmp_path / "whole"), total_steps=36))
    train_dqn(
        replace(config, out=str(tmp_path / "parts"), total_steps=23)
    )  # in the middle of an episode, the ring full
    parts = train_dqn(replace(config, out=str(tmp_path / "parts"), total_steps=36))
    assert parts.updates == whole.updates > 8
    one, two = tensors(whole), tensors(parts)
    assert all(torch.equal(one[key], two[key]) for key in one)


def straight_flights(folder):
    """Demonstrations of an expert that flies straight on as long as it can."""
    config = ImitationConfig(
        predictors=("idw",),
        expert="random-waypoint:repeat_probability=1.0",
        out=str(folder),
        side=32,
        steps=16,
        surveys=(4,),
        updates=(1,),
        held_out=1,
        batch_size=4,
        workers=1,
    )
    train_imitation(config)
    return str(folder / "demonstrations")


def test_demonstrations_are_learned_before_the_first_step_and_kept(tmp_path):
    flights = straight_flights(tmp_path / "expert")
    taught = replace(
        SMALL,
        demonstrations=flights,
        demonstration_weight=1.0,
        pretraining=60,
        learning_rate=3e-4,
        batch_size=32,
    )
    said = []
    whole = train_dqn(replace(taught, out=str(tmp_path / "whole"), total_steps=24), said.append)
    assert [r["agreement"] for r in said if "pretraining" in r][
        -1
    ] > 0.5  # of 2 to 4 legal moves; the last one is part of the view
    assert whole.scores["agreement"] > 0.5
    train_dqn(replace(taught, out=str(tmp_path / "parts"), total_steps=15))
    parts = train_dqn(replace(taught, out=str(tmp_path / "parts"), total_steps=24))
    one, two = tensors(whole), tensors(parts)
    assert all(torch.equal(one[key], two[key]) for key in one)


def test_demonstrations_that_are_not_there_are_asked_for(tmp_path):
    with pytest.raises(InputError, match="needs a folder"):
        replace(SMALL, pretraining=3)
    with pytest.raises(InputError, match="no demonstrations in"):
        train_dqn(replace(SMALL, out=str(tmp_path), demonstrations=str(tmp_path)))


@pytest.fixture
def seen(rng):
    shape = (5, 20, 23)
    return Seen(
        mean=rng.integers(0, 256, shape).astype(np.uint8),
        std=rng.integers(0, 256, shape).astype(np.uint8),
        height=rng.integers(0, 256, shape).astype(np.uint8),
        flyable=rng.random(shape) < 0.7,
        cells=rng.integers(0, 20, (5, 3, 2)),
        uav=rng.integers(0, 3, 5),
        last=rng.integers(-1, 4, 5),
        left=rng.integers(0, 200, 5),
    )


def turned_survey(seen, symmetry):
    """The same survey on the turned map."""
    rows, cols = seen.mean.shape[1:]

    def turned(maps):
        maps = maps[:, :: -1 if symmetry & 1 else 1, :: -1 if symmetry & 2 else 1]
        return np.ascontiguousarray(maps.transpose(0, 2, 1) if symmetry & 4 else maps)

    cells = seen.cells.copy()
    if symmetry & 1:
        cells[..., 0] = rows - 1 - cells[..., 0]
    if symmetry & 2:
        cells[..., 1] = cols - 1 - cells[..., 1]
    last = np.where(seen.last >= 0, turned_moves(symmetry)[seen.last], -1)
    return replace(
        seen,
        mean=turned(seen.mean),
        std=turned(seen.std),
        height=turned(seen.height),
        flyable=turned(seen.flyable),
        cells=cells[..., ::-1] if symmetry & 4 else cells,
        last=last,
    )


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_the_view_turns_with_the_survey(seen, symmetry):
    for one, two in zip(
        turned_view(centred_view(seen), symmetry),
        centred_view(turned_survey(seen, symmetry)),
        strict=True,
    ):
        assert np.allclose(one, two, atol=1e-6)


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_moves_turn_like_cells(symmetry):
    cells = np.array([[5, 5]] * 4) + MOVES
    if symmetry & 1:
        cells[:, 0] = 10 - cells[:, 0]
    if symmetry & 2:
        cells[:, 1] = 10 - cells[:, 1]
    if symmetry & 4:
        cells = cells[:, ::-1]
    assert np.array_equal(cells - 5, MOVES[turned_moves(symmetry)])


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
    loaded, z = load_policy(path)
    assert path.stat().st_size < 0.3 * sum(4 * p.numel() for p in network.parameters())
    x = torch.from_numpy(rng.random((50, 5, 48, 48), dtype=np.float32))
    with torch.no_grad():
        one, two = (torch.softmax(net(x), -1) @ z for net in (network, loaded))
    assert (one - two).abs().max() < 0.05 * (one.max(1).values - one.min(1).values).mean()


def test_dqn_recipe_makes_a_planner(tmp_path):
    settings = {
        k: getattr(SMALL, k)
        for k in (
            "predictor",
            "side",
            "steps",
            "lanes",
            "n_uavs",
            "warmup",
            "capacity",
            "batch_size",
        )
    }
    train_policy("dqn-rewards-only", "sample", tmp_path, total_steps=30, **settings)
    planner = create_planner(
        "dqn", weights=str(tmp_path / "dqn-rewards-only.safetensors"), symmetries=2
    )
    settings = [
        planner_scenarios()[k] for k in (3, 6, 9)
    ]  # empty batteries, everyone returns, no move at all
    check_planner(planner, create_predictor("idw"), settings=settings)


def test_imitation_resumes_and_learns_from_its_own_flights(tmp_path):
    config = ImitationConfig(
        predictors=("idw",),
        expert="random-waypoint:repeat_probability=1.0",
        side=32,
        steps=16,
        surveys=(4, 3),
        updates=(24, 12),
        learning_rate=3e-3,
        held_out=1,
        batch_size=16,
        workers=1,
        checkpoint_steps=24,
    )
    whole = train_imitation(replace(config, out=str(tmp_path / "whole")))
    train_imitation(replace(config, out=str(tmp_path / "parts"), surveys=(4,), updates=(24,)))
    parts = train_imitation(replace(config, out=str(tmp_path / "parts")))
    one, two = tensors(whole), tensors(parts)
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert whole.scores["held_out_loss"] < 0.95 * np.log(
        4
    )  # straight on is easily learned: the last move is part of the view
    imitator = create_planner(
        "imitation", weights=str(tmp_path / "whole" / "policy-1.safetensors"), symmetries=2
    )
    check_planner(
        imitator, create_predictor("idw"), settings=[planner_scenarios()[k] for k in (0, 3, 9)]
    )


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


def test_weights_that_fit_nothing_are_refused(tmp_path):
    save_checkpoint(tmp_path / "other.safetensors", {"something": torch.zeros(3)}, {"policy": {}})
    with pytest.raises(InputError, match="nothing in"):
        train_dqn(
            replace(
                SMALL, out=str(tmp_path / "run"), start_from=str(tmp_path / "other.safetensors")
            )
        )


def test_unknown_recipes_settings_and_weights_are_refused(tmp_path):
    with pytest.raises(InputError, match="known: dqn, dqn-rewards-only, imitation, paper-dqn"):
        train_policy("a3c", "sample", tmp_path)
    with pytest.raises(InputError, match="no setting 'start_from'"):
        train_policy("imitation", "sample", tmp_path, start_from="x")
    with pytest.raises(InputError, match="train policy --recipe nothing"):
        load_policy("nothing")
