"""Distributional Q-learning on a fixed support (Bellemare, Dabney and Munos, 2017), with multi-step
returns.

The return's distribution is p_i on atoms z_i = v_min + i Δ. Its target after m rewards R with
discount γ^m ahead is the distribution of R + γ^m z under the target network's p at the best next
move, each atom's mass shared by the two nearest atoms of the support,

    (Φp)_i = Σ_j p_j · max(0, 1 − |clip(R + γ^m z_j) − z_i| / Δ),

and the loss is the cross entropy of the present distribution with it.
"""

from __future__ import annotations

__all__ = ["cross_entropy", "expected", "masked_argmax", "projected", "support"]

import torch
from torch import Tensor


def support(v_min: float, v_max: float, atoms: int) -> Tensor:
    """``[atom]`` z."""
    return torch.linspace(v_min, v_max, atoms)


def projected(probability: Tensor, reward: Tensor, discount: Tensor, z: Tensor) -> Tensor:
    """``[sample, atom]`` Φp.

    ``probability[sample, atom]`` is that of the next state, ``reward[sample]`` the rewards up to it
    and ``discount[sample]`` the factor γ^m, 0 where the episode has ended. Costs O(atoms) per
    sample: mass is added to the two atoms it falls between.
    """
    step = (z[-1] - z[0]) / (len(z) - 1)
    value = (reward[:, None] + discount[:, None] * z).clamp(float(z[0]), float(z[-1]))
    place = ((value - z[0]) / step).clamp(0, len(z) - 1)
    low = place.floor()
    upper_share = place - low
    below = low.long()
    above = (below + 1).clamp(max=len(z) - 1)
    out = torch.zeros_like(probability)
    out.scatter_add_(1, below, probability * (1 - upper_share))
    return out.scatter_add_(1, above, probability * upper_share)


def expected(logits: Tensor, z: Tensor) -> Tensor:
    """``[sample, move]`` Q from ``logits[sample, move, atom]``."""
    return torch.softmax(logits, dim=-1) @ z


def masked_argmax(q: Tensor, mask: Tensor) -> Tensor:
    """``[sample]`` the best of the moves that ``mask[sample, move]`` allows."""
    return q.masked_fill(~mask, -torch.inf).argmax(dim=-1)


def cross_entropy(logits: Tensor, move: Tensor, target: Tensor) -> Tensor:
    """``[sample]`` −Σ target · log p at the move taken."""
    taken = logits[torch.arange(len(move)), move]
    return -(target * torch.log_softmax(taken, dim=-1)).sum(dim=-1)
