"""A run keeps its parts, and says what it cannot go on from."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import nn

from skygain.datasets.sample import open_sample
from skygain.datasets.writer import write_dataset
from skygain.ground.errors import InputError
from skygain.training.run import Run, one_cycle


@dataclass(frozen=True)
class Settings:
    max_seconds: float = float("inf")
    rate: float = 0.1


def parts(seed):
    torch.manual_seed(seed)
    network = nn.Linear(3, 2)
    return {
        "network": network,
        "optimiser": torch.optim.Adam(network.parameters(), 0.1),
        "average": {"weight": network.weight.detach().clone()},
        "numbers": np.random.default_rng(seed),
    }


def stepped(kept):
    drawn = torch.from_numpy(kept["numbers"].normal(size=(4, 3)).astype(np.float32))
    kept["optimiser"].zero_grad()
    kept["network"](drawn).square().sum().backward()
    kept["optimiser"].step()


def test_every_part_goes_on_as_if_nothing_had_happened(tmp_path):
    one = parts(0)
    run = Run(tmp_path, Settings(), one, mark=1)
    stepped(one)
    run.step, run.scores, run.state = 5, {"rmse_db": 2.0}, {"mark": 7}
    run.save()
    two = parts(1)
    again = Run(tmp_path, Settings(), two, mark=1)
    assert (again.resumed, again.step, again.scores, again.state) == (
        True,
        5,
        {"rmse_db": 2.0},
        {"mark": 7},
    )
    assert torch.equal(one["average"]["weight"], two["average"]["weight"])
    for kept in (one, two):
        stepped(kept)
    assert torch.equal(one["network"].weight, two["network"].weight)


@dataclass(frozen=True)
class Learning(Settings):
    data: str = "sample"


def test_a_run_does_not_go_on_with_data_of_another_model(tmp_path):
    sample = open_sample()
    other = write_dataset(
        tmp_path / "other.zarr.zip",
        [sample.record(0)],
        grid=sample.grid,
        altitudes_m=sample.altitudes_m,
        attributes={**sample.attributes, "data_version": -1},
    )
    Run(tmp_path / "run", Learning(), parts(0)).save()
    assert Run(tmp_path / "run", Learning(), parts(1)).resumed
    with pytest.raises(InputError, match=r"learned from union by launch.* `data` is now .*-1"):
        Run(tmp_path / "run", Learning(data=str(other)), parts(1))


def test_checkpoints_of_another_kind_are_refused(tmp_path):
    Run(tmp_path, Settings(), parts(0)).save()
    with pytest.raises(InputError, match="another kind of run"):
        Run(tmp_path, Settings(), {"network": nn.Linear(9, 2)})
    with pytest.raises(InputError, match="another kind of run"):
        Run(tmp_path, Settings(), parts(0), lanes=[])


def test_a_call_ends_when_its_time_is_over(tmp_path):
    assert Run(tmp_path, Settings(max_seconds=0.0), {}).over
    assert not Run(tmp_path, Settings(), {}).over


@pytest.mark.parametrize("total", [40, 4800])
def test_the_cycle_is_pytorchs(total):
    network = nn.Linear(1, 1)
    optimiser = torch.optim.Adam(network.parameters(), 1.0)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 5e-3, total_steps=total)
    for k in range(total):
        group = optimiser.param_groups[0]
        assert one_cycle(k, total, 5e-3) == (group["lr"], group["betas"][0])
        optimiser.step()
        if k < total - 1:
            schedule.step()
