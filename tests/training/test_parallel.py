"""Shared work is the same work."""

import contextlib
import copy

import numpy as np
import pytest
import torch

from skygain.datasets.links import load_links
from skygain.datasets.sample import SAMPLE
from skygain.networks.operator.network import OperatorConfig
from skygain.training.parallel import Shares
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
