"""The loop of small networks: rounds over samples that fit into memory, one cycle of the rate."""

from __future__ import annotations

__all__ = ["in_rounds"]

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor

from skygain.training.run import Run, one_cycle, set_rate


def in_rounds(
    run: Run,
    optimiser: torch.optim.Optimizer,
    losses: Callable[[], Iterator[Tensor]],
    *,
    rounds: int,
    per_round: int,
    peak: float,
    every: int = 1,
    scores: Callable[[], dict[str, float]] = dict,
) -> None:
    """Train until ``rounds`` are done or the call has had its time.

    ``losses()`` gives the ``per_round`` losses of a round, each computed when it is asked for.
    After ``every`` so many rounds ``scores()`` are taken, and log and checkpoint written.
    """
    beta = optimiser.param_groups[0]["betas"][1]
    while run.step < rounds and not run.over:
        found = []
        for k, loss in enumerate(losses()):
            rate, momentum = one_cycle(run.step * per_round + k, rounds * per_round, peak)
            set_rate(optimiser, rate, betas=(momentum, beta))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            found.append(float(loss.detach()))
        run.step += 1
        if run.step % every == 0 or run.step == rounds:
            run.scores = scores()
            run.record(loss=round(float(np.mean(found)), 4), **run.scores)
            run.save()
    run.save()
