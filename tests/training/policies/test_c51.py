from __future__ import annotations

import numpy as np
import pytest
import torch

from skygain.training.policies.c51 import cross_entropy, expected, masked_argmax, projected, support


@pytest.fixture
def case(rng):
    """Distributions, rewards within and far beyond the support, episodes that go on and that have
    ended."""
    probability = torch.from_numpy(rng.dirichlet(np.ones(40), size=300))
    reward = torch.from_numpy(
        np.where(rng.random(300) < 0.2, rng.normal(0, 100, 300), rng.normal(-5, 6, 300))
    )
    discount = torch.from_numpy(
        np.where(rng.random(300) < 0.3, 0.0, 0.99 ** rng.integers(1, 6, 300))
    )
    return probability, reward, discount, torch.linspace(-20.0, 5.0, 40, dtype=torch.double)


def dense(probability, reward, discount, z):
    """The projection as the equation has it, every atom with every other."""
    step = z[1] - z[0]
    value = (reward[:, None] + discount[:, None] * z).clamp(z[0], z[-1])
    share = (1 - (value[:, None, :] - z[None, :, None]).abs() / step).clamp(0, 1)
    return (share * probability[:, None, :]).sum(-1)


def test_projection_is_the_equation(case):
    assert torch.allclose(projected(*case), dense(*case), atol=1e-9)


def test_projection_keeps_mass_and_mean(case):
    probability, reward, discount, z = case
    target = projected(*case)
    assert torch.allclose(target.sum(-1), torch.ones(300, dtype=torch.double))
    inside = (reward + discount * z[0] >= z[0]) & (reward + discount * z[-1] <= z[-1])
    assert inside.sum() > 30
    assert torch.allclose((target @ z)[inside], (reward + discount * (probability @ z))[inside])


def test_projection_agrees_with_tianshou(case):
    tianshou = pytest.importorskip(
        "tianshou", reason="tianshou is not installed; it is needed for this comparison only"
    )
    from tianshou.algorithm.modelfree.c51 import C51
    from tianshou.data import Batch

    assert tianshou.__version__
    probability, reward, discount, z = case

    class Policy:
        v_min, v_max, support = float(z[0]), float(z[-1]), z

        def __call__(self, batch, model=None):
            return Batch(act=np.zeros(len(probability), dtype=int), logits=probability[:, None])

    algorithm = C51.__new__(C51)
    torch.nn.Module.__init__(algorithm)
    algorithm.policy, algorithm.delta_z, algorithm.target_update_freq = (
        Policy(),
        float(z[1] - z[0]),
        0,
    )
    algorithm.__dict__["model_old"] = None
    type(algorithm).use_target_network = property(lambda self: False)
    batch = Batch(
        obs_next=np.zeros(len(probability)), returns=reward[:, None] + discount[:, None] * z
    )
    assert torch.allclose(projected(*case), algorithm._target_dist(batch), atol=1e-6)


def test_an_ended_episode_is_worth_its_rewards():
    z = support(-1.0, 1.0, 3)
    target = projected(
        torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([0.25]), torch.tensor([0.0]), z
    )
    assert torch.allclose(target, torch.tensor([[0.0, 0.75, 0.25]]))


def test_the_best_move_is_a_legal_one():
    q = torch.tensor([[3.0, 1.0, 2.0, 0.0], [0.0, 1.0, 2.0, 3.0]])
    mask = torch.tensor([[False, True, True, True], [True, True, False, False]])
    assert masked_argmax(q, mask).tolist() == [2, 1]


def test_cross_entropy_is_least_at_the_target(rng):
    target = torch.from_numpy(rng.dirichlet(np.ones(5), size=6))
    logits = torch.log(target)[:, None].repeat(1, 4, 1)
    move = torch.tensor([0, 1, 2, 3, 0, 1])
    entropy = -(target * torch.log(target)).sum(-1)
    assert torch.allclose(cross_entropy(logits, move, target), entropy)
    assert torch.allclose(
        expected(logits, support(0, 4, 5).double())[:, 2], target @ torch.arange(5.0).double()
    )
