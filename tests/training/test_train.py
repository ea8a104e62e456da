"""Training is repeatable and resumes to the same bytes."""

import json

import numpy as np
import pytest
import torch

from skygain.datasets.links import load_links
from skygain.datasets.sample import SAMPLE
from skygain.ground.errors import InputError
from skygain.networks.operator.network import OperatorConfig
from skygain.training import train_predictor
from skygain.training.checkpoints import load_checkpoint
from skygain.training.tasks.base import OperatorTask
from skygain.training.tasks.unets import DirectTask

SMALL = OperatorConfig(stem=4, widths=(8, 8, 8), blocks=(1, 1, 2), heads=2)
QUICK = {
    "task": OperatorTask(side=32, net=SMALL),
    "batch_size": 4,
    "validate_steps": 4,
    "validation_samples": 8,
    "bf16": False,
}


def test_a_resumed_run_ends_with_the_same_bytes(tmp_path):
    straight = train_predictor("operator", SAMPLE, tmp_path / "straight", total_steps=6, **QUICK)
    train_predictor("operator", SAMPLE, tmp_path / "parts", total_steps=3, **QUICK)
    resumed = train_predictor("operator", SAMPLE, tmp_path / "parts", total_steps=6, **QUICK)
    one, two = load_checkpoint(straight.checkpoint)[0], load_checkpoint(resumed.checkpoint)[0]
    assert one.keys() == two.keys()
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert resumed.step == 6
    assert resumed.samples == 24
    assert resumed.scores["rmse_db@10"] > 0


def test_a_run_that_finishes_ends_at_rate_zero_and_stays_ended(tmp_path):
    train_predictor("operator", SAMPLE, tmp_path / "parts", total_steps=2, **QUICK)
    train_predictor("operator", SAMPLE, tmp_path / "parts", finish=4, max_seconds=0.0, **QUICK)
    ended = train_predictor("operator", SAMPLE, tmp_path / "parts", **QUICK)
    assert ended.step == 6
    assert train_predictor("operator", SAMPLE, tmp_path / "parts", **QUICK).step == 6
    train_predictor("operator", SAMPLE, tmp_path / "whole", total_steps=2, **QUICK)
    whole = train_predictor("operator", SAMPLE, tmp_path / "whole", finish=4, **QUICK)
    one, two = load_checkpoint(ended.checkpoint)[0], load_checkpoint(whole.checkpoint)[0]
    assert all(torch.equal(one[key], two[key]) for key in one)


def test_the_log_is_one_json_record_per_line(tmp_path):
    train_predictor(
        "unet", SAMPLE, tmp_path, total_steps=4, **{**QUICK, "task": DirectTask(side=32, net=SMALL)}
    )
    records = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert records[-1]["step"] == 4
    assert {"rmse_db@10", "nll@10", "gof@10", "cover90@10"} <= records[-1].keys()
    assert json.loads((tmp_path / "config.json").read_text())["batch_size"] == 4


def test_a_run_can_start_from_the_weights_of_another(tmp_path):
    first = train_predictor("operator", SAMPLE, tmp_path / "a", total_steps=2, **QUICK)
    start = {
        "start_from": str(first.checkpoint),
        "learning_rate": 0.0,
        "weight_decay": 0.0,
        "average_decay": 0.0,
    }
    second = train_predictor("operator", SAMPLE, tmp_path / "b", total_steps=1, **QUICK, **start)
    one, two = load_checkpoint(first.checkpoint)[0], load_checkpoint(second.checkpoint)[0]
    assert torch.equal(one["average.head.weight"], two["network.head.weight"])


@pytest.mark.parametrize("average_decay", [0.0, 0.9])
def test_a_finished_run_keeps_a_share_of_what_it_began_from(tmp_path, average_decay):
    first = train_predictor("operator", SAMPLE, tmp_path / "a", total_steps=2, **QUICK)
    begun = {"start_from": str(first.checkpoint), "average_decay": average_decay, **QUICK}
    alone = train_predictor("operator", SAMPLE, tmp_path / "alone", finish=4, **begun)
    for _ in range(2):  # the second call finds it done
        mixed = train_predictor("operator", SAMPLE, tmp_path / "mixed", finish=4, keep=0.3, **begun)
    old, new, mean = (
        load_checkpoint(run.checkpoint)[0]["average.head.weight"] for run in (first, alone, mixed)
    )
    torch.testing.assert_close(mean, 0.3 * old + 0.7 * new)
    assert mixed.scores != alone.scores


def test_learning_lowers_the_loss_on_what_it_trains_on():
    links = load_links(SAMPLE, "T1")
    task = OperatorTask(side=32, net=SMALL)
    torch.manual_seed(0)
    network = task.network()
    batch = task.batch(links, 4, np.random.default_rng(0))
    optimiser = torch.optim.Adam(network.parameters(), 3e-3)
    losses = []
    for _ in range(15):
        loss = task.loss(network, batch)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.8 * losses[0]


def test_what_cannot_be_used_is_named(tmp_path):
    with pytest.raises(InputError, match=r"known: .*operator"):
        train_predictor("opertor", SAMPLE, tmp_path)
    (tmp_path / "checkpoint.safetensors").write_bytes(b"not one")
    with pytest.raises(InputError, match="not a Skygain checkpoint"):
        train_predictor("operator", SAMPLE, tmp_path, total_steps=1, **QUICK)


def test_data_sets_are_trained_on_together(tmp_path):
    result = train_predictor("operator", [SAMPLE, SAMPLE], tmp_path, total_steps=1, **QUICK)
    assert result.step == 1
