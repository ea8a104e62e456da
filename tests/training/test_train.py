"""Training is repeatable, resumes to the same bytes, and its loss is the likelihood."""

import contextlib
import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import skygain
from skygain.datasets.links import _together, load_links
from skygain.ground.errors import InputError
from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.operator.network import OperatorConfig
from skygain.training import train_predictor
from skygain.training.likelihood import gaussian_loss
from skygain.training.recipes import RECIPES
from skygain.training.tasks.base import OperatorTask
from skygain.training.tasks.unets import DirectTask, PaperTask
from skygain.training.train import _Shares

SAMPLE = Path(skygain.__file__).parent / "data" / "sample.zarr.zip"
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
    train_predictor(
        "operator", SAMPLE, tmp_path / "parts", finish_steps=4, max_seconds=0.0, **QUICK
    )
    ended = train_predictor("operator", SAMPLE, tmp_path / "parts", **QUICK)
    assert ended.step == 6
    assert train_predictor("operator", SAMPLE, tmp_path / "parts", **QUICK).step == 6
    train_predictor("operator", SAMPLE, tmp_path / "whole", total_steps=2, **QUICK)
    whole = train_predictor("operator", SAMPLE, tmp_path / "whole", finish_steps=4, **QUICK)
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
    _Shares(task, shared, 2, contextlib.nullcontext, torch.device("cpu")).gradients(part)
    for network in (plain, shared):
        torch.optim.AdamW(network.parameters(), 1e-3, eps=1e-2, fused=True).step()
    for (name, one), two in zip(plain.named_parameters(), shared.parameters(), strict=True):
        assert torch.allclose(one, two, atol=2e-5), name


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


def test_loss_is_the_normal_likelihood_without_its_constant(rng):
    mean, truth = (torch.from_numpy(rng.normal(size=(2, 5, 5))) for _ in range(2))
    log_variance = torch.from_numpy(rng.normal(size=(2, 5, 5)))
    mask = torch.from_numpy(rng.random((2, 5, 5)) < 0.5)
    normal = torch.distributions.Normal(mean, torch.exp(0.5 * log_variance))
    expected = -normal.log_prob(truth)[mask].mean() - 0.5 * np.log(2 * np.pi)
    assert torch.isclose(gaussian_loss(mean, log_variance, truth, mask), expected)


def test_a_view_turns_map_and_transmitter_together():
    links = load_links(SAMPLE, "T1")
    plain = links.view(0, 0, 5, 9, 96)
    for symmetry in range(8):
        view = links.view(0, 0, 5, 9, 96, symmetry)
        # The strongest gain lies near the transmitter in every picture.
        near = np.unravel_index(
            np.where(view.outdoor, view.gain_db, -999).argmax(), view.gain_db.shape
        )
        plainly = np.unravel_index(
            np.where(plain.outdoor, plain.gain_db, -999).argmax(), plain.gain_db.shape
        )
        distance = np.hypot(near[0] - view.transmitter[0], near[1] - view.transmitter[1])
        assert np.isclose(
            distance, np.hypot(plainly[0] - plain.transmitter[0], plainly[1] - plain.transmitter[1])
        )
        assert np.isclose(view.height_m.sum(), plain.height_m.sum())


def test_several_data_sets_are_one(tmp_path):
    alone = load_links(SAMPLE, "T1")
    twice = load_links([SAMPLE, SAMPLE], "T1")
    assert (len(twice), len(twice.height_m)) == (2 * len(alone), 2 * len(alone.height_m))
    for k in range(len(alone)):
        one, two = alone.view(k, 0, 3, 4, 96), twice.view(len(alone) + k, 0, 3, 4, 96)
        assert one.transmitter == two.transmitter
        assert np.array_equal(one.gain_db, two.gain_db)
        assert np.array_equal(one.height_m, two.height_m)
    lower = replace(
        alone,
        altitude_m=alone.altitude_m[:1],
        gain_db=alone.gain_db[:, :1],
        ray_traced=alone.ray_traced[:, :1],
        available=alone.available[:, :1],
    )
    both = _together([lower, alone])
    assert np.array_equal(
        both.available, np.concatenate([[[True, False, False]] * len(alone), alone.available])
    )
    drawn = {
        both.draw(np.random.default_rng(k), 96, np.array([0.0, 1.0, 0.0])).altitude_m
        for k in range(20)
    }
    assert drawn == {20.0}
    with pytest.raises(InputError, match="maps at 10 m"):
        lower.draw(np.random.default_rng(0), 96, np.array([0.0]))
    with pytest.raises(InputError, match="maps of one size"):
        _together([alone, replace(alone, spacing_m=5.0)])
    result = train_predictor("operator", [SAMPLE, SAMPLE], tmp_path, total_steps=1, **QUICK)
    assert result.step == 1


def test_recipes_are_the_papers():
    paper = RECIPES["paper-unet"]
    assert (paper.learning_rate, paper.betas, paper.epsilon, paper.batch_size) == (
        1e-3,
        (0.9, 0.999),
        1e-6,
        160,
    )
    assert replace(paper.task, blind=True) == RECIPES["paper-unet-mapblind"].task


def test_what_cannot_be_used_is_named(tmp_path):
    with pytest.raises(InputError, match=r"known: .*operator"):
        train_predictor("opertor", SAMPLE, tmp_path)
    with pytest.raises(InputError, match="no data set at"):
        train_predictor("operator", tmp_path / "none.zarr.zip", tmp_path)
    with pytest.raises(InputError, match="no link of split 'T9'"):
        load_links(SAMPLE, "T9")
    (tmp_path / "checkpoint.safetensors").write_bytes(b"not one")
    with pytest.raises(InputError, match="not a Skygain checkpoint"):
        train_predictor("operator", SAMPLE, tmp_path, total_steps=1, **QUICK)


def test_a_checkpoint_keeps_tensors_and_meta(tmp_path):
    save_checkpoint(tmp_path / "c.safetensors", {"a": torch.arange(3)}, {"step": 2, "name": "x"})
    tensors, meta = load_checkpoint(tmp_path / "c.safetensors")
    assert tensors["a"].tolist() == [0, 1, 2]
    assert meta == {"step": 2, "name": "x"}
