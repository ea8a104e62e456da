"""Shared work is the same work."""

import contextlib
import copy

import numpy as np
import pytest
import torch

from skygain.datasets.links import load_links
from skygain.datasets.sample import SAMPLE
from skygain.networks.operator.network import OperatorConfig
from skygain.training.parallel import Shares, prefetched
from skygain.training.tasks.base import OperatorTask
from skygain.training.tasks.unets import DirectTask, PaperTask

SMALL = OperatorConfig(stem=4, widths=(8, 8, 8), blocks=(1, 1, 2), heads=2)


@pytest.mark.parametrize(
    "task", [PaperTask(), OperatorTask(side=32, net=SMALL), DirectTask(side=32, net=SMALL)]
)
def test_shared_work_takes_the_step_that_one_worker_would(task):
    """Gradients in another memory layout than their parameters would be applied to the wrong
    weights by the fused optimiser."""
    torch.manual_seed(0)
    plain = task.network().to(memory_format=torch.channels_last).train()
    shared = copy.deepcopy(plain)
    batch = task.batch(load_links(SAMPLE, "T1"), 2, np.random.default_rng(0))
    part = {
        key: value[:1].repeat(2, *[1] * (value.ndim - 1)) for key, value in batch.items()
    }  # equal shares have equal statistics
    task.loss(plain, part).backward()
    with Shares(task, shared, 2, contextlib.nullcontext, torch.device("cpu")) as shares:
        shares.gradients(part)
    for network in (plain, shared):
        torch.optim.AdamW(network.parameters(), 1e-3, eps=1e-2, fused=True).step()
    for (name, one), two in zip(plain.named_parameters(), shared.parameters(), strict=True):
        assert torch.allclose(one, two, atol=2e-5), name


def test_batches_come_in_order_however_many_make_them():
    task, links = PaperTask(), load_links(SAMPLE, "T1")

    def make(k):
        return task.batch(links, 2, np.random.default_rng([0, k]))

    for makers in (1, 4):
        with prefetched(make, 3, 11, makers) as batches:
            found = list(batches)
        assert len(found) == 8
        for k, batch in zip(range(3, 11), found, strict=True):
            assert torch.equal(batch["inputs"], make(k)["inputs"])


def test_a_batch_that_cannot_be_made_ends_the_run():
    def make(k):
        if k == 2:
            raise ValueError("no such batch")
        return {"k": torch.tensor(k)}

    with prefetched(make, 0, 9, 3) as batches:
        assert [int(next(batches)["k"]) for _ in range(2)] == [0, 1]
        with pytest.raises(ValueError, match="no such batch"):
            next(batches)


def test_what_nobody_takes_is_not_made():
    made = []

    def make(k):
        made.append(k)
        return {}

    with prefetched(make, 0, 1000, 2) as batches:
        next(batches)
    assert len(made) < 10
