"""The training loop of every predictor network: batches in, checkpoints and a log out.

The loop holds no hidden state. Batch k comes from (seed, k); network, optimiser, the moving average
of the weights and the step stand in the checkpoint. See `skygain.training.run`.
"""

from __future__ import annotations

__all__ = ["TrainConfig", "train"]

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skygain.networks.torch_runtime import load_network
from skygain.networks.weights import runs_folder
from skygain.training.compute import autocast, best_device, threads
from skygain.training.parallel import Shares, moved, prefetched
from skygain.training.run import Part, Report, Result, Run, set_rate
from skygain.training.tasks.base import Batch, Task


@dataclass(frozen=True)
class TrainConfig:
    """One run."""

    task: Task
    """what is learned"""
    data: str | tuple[str, ...]
    """path of the data set, or of several whose links are taken together"""
    out: str
    """folder of the run: checkpoint.safetensors, log.jsonl, config.json; an existing checkpoint is
    continued"""
    batch_size: int = 32
    """samples per step"""
    learning_rate: float = 1e-3
    """peak learning rate"""
    betas: tuple[float, float] = (0.9, 0.999)
    """Adam's decay rates"""
    epsilon: float = 1e-8
    """Adam's ε"""
    weight_decay: float = 1e-2
    """decoupled weight decay"""
    warmup_steps: int = 200
    """steps over which the learning rate rises from 0"""
    hold_steps: int = 4000
    """from here on the rate falls with 1/√(step / hold_steps); no end need be known in advance"""
    finish: int = 0
    """if positive, the rate falls linearly to 0 over so many steps from where the run stands, and
    the run ends; what constant rates leave undecided settles then"""
    average_decay: float = 0.998
    """decay per step of the moving average of the weights, which is what is validated and shipped;
    0 for none"""
    clip_norm: float = 1.0
    """largest gradient norm; 0 for no limit"""
    workers: int = 2
    """shares of a batch computed side by side, each by one CPU thread on the same weights (on CUDA
    always 1). Threads inside every single operation wait for each other hundreds of times a step,
    which a shared machine punishes"""
    bf16: bool = True
    """bfloat16 autocast (on CPUs that support it about three times as fast)"""
    seed: int = 0
    """of weights and data"""
    total_steps: int = 100_000
    """stop here"""
    max_seconds: float = float("inf")
    """stop this call after so long; the run continues with the next call"""
    checkpoint_seconds: float = 180.0
    """time between checkpoints"""
    validate_steps: int = 500
    """steps between validations"""
    validation_samples: int = 256
    """windows of the validation split, the same every time"""
    train_split: str = "T1"
    """split to train on"""
    validation_split: str = "T2"
    """split to validate on"""
    start_from: str = ""
    """name or file of the weights, or a run's checkpoint, that this run starts from (only where it
    has no checkpoint of its own)"""
    keep: float = 0.0
    """share of the weights of ``start_from`` in those that a run with ``finish`` ends with: the
    mean of old and new weights is often better on data unlike the new (Wortsman et al., 2022)"""


def train(config: TrainConfig, report: Report = lambda record: None) -> Result:
    """Train until ``total_steps`` or ``max_seconds``; every log record also goes to ``report``."""
    task = config.task
    links, held_out = (
        task.load(config.data, split, report)
        for split in (config.train_split, config.validation_split)
    )
    device = best_device()
    torch.manual_seed(config.seed)
    network, trial = (
        task.network().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        for _ in range(2)
    )
    optimiser = torch.optim.AdamW(
        network.parameters(),
        config.learning_rate,
        config.betas,
        config.epsilon,
        config.weight_decay,
        fused=True,
    )
    average = {k: v.clone() for k, v in network.state_dict().items() if v.is_floating_point()}
    parts: dict[str, Part] = {"network": network, "average": average, "optimiser": optimiser}
    run = Run(config.out, config, parts, report, finish=None, kept=0.0)
    if config.start_from and not run.resumed:
        _start(network, config)
        _follow(average, network, 0.0)
    if run.state["finish"] is None and config.finish:
        run.state["finish"] = [run.step, config.finish]
    finish = run.state["finish"]
    end = config.total_steps if finish is None else sum(finish)
    decay = config.average_decay
    if finish is not None:  # the average must forget what was before the rate fell
        decay = min(decay, max(0.0, 1.0 - 10.0 / finish[1]))
    validation = [moved(batch, device) for batch in _validation_batches(config, held_out)]
    contexts = autocast(config.bf16, device)
    workers = config.workers if device.type == "cpu" else 1
    every_thread = torch.get_num_threads()
    losses: list[Tensor] = []

    def save() -> None:
        if decay == 0 and not run.state["kept"]:
            _follow(average, network, 0.0)
        run.save()

    network.train()
    with (
        # the workers are the parallelism
        threads(1 if workers > 1 else every_thread),
        Shares(task, network, workers, contexts, device) as shares,
        prefetched(
            lambda k: task.batch(links, config.batch_size, np.random.default_rng([config.seed, k])),
            run.step,
            end,
            makers=(os.cpu_count() or 1) if device.type == "cuda" else 1,
        ) as batches,
    ):
        for batch in batches:
            rate = _learning_rate(config, finish, run.step)
            losses.append(shares.gradients(batch))
            if config.clip_norm > 0:
                nn.utils.clip_grad_norm_(network.parameters(), config.clip_norm)
            run.step += 1
            # a pass over all weights is shared by all cores, the workers wait meanwhile
            with threads(every_thread):
                set_rate(optimiser, rate)
                optimiser.step()
                if decay > 0:
                    _follow(average, network, min(decay, run.step / (run.step + 10)))
            samples = run.step * config.batch_size
            if run.step % 50 == 0:
                loss = round(float(torch.stack(losses).mean()), 5)
                run.record(
                    samples=samples, loss=loss, rate=_learning_rate(config, finish, run.step)
                )
                losses.clear()
            if run.step % config.validate_steps == 0 or (finish is not None and run.step == end):
                state = average if decay > 0 else network.state_dict()
                trial.load_state_dict(state, strict=False)
                run.scores = shares.pool.submit(task.scores, trial, validation, contexts).result()
                run.record(samples=samples, **run.scores)
            if run.unsaved_seconds > config.checkpoint_seconds:
                save()
            if run.over:
                break
    save()
    if finish is not None and run.step == end and config.keep > run.state["kept"] == 0.0:
        _start(trial, config)
        _follow(average, trial, 1.0 - config.keep)
        trial.load_state_dict(average, strict=False)
        run.scores = task.scores(trial, validation, contexts)
        run.state["kept"] = config.keep
        run.record(samples=run.step * config.batch_size, kept=config.keep, **run.scores)
        run.save()
    return run.result(run.step * config.batch_size)


def _start(network: nn.Module, config: TrainConfig) -> None:
    """Fill ``network`` with what the run starts from."""
    kept = runs_folder() / config.start_from / "checkpoint.safetensors"
    # finer than the weights exported from it
    load_network(network, kept if kept.exists() else config.start_from, adapt=True)


def _learning_rate(config: TrainConfig, finish: list[int] | None, step: int) -> float:
    rise = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    fall = 1.0 if finish is None else max(0.0, 1.0 - (step - finish[0]) / finish[1])
    return config.learning_rate * rise * fall * min(1.0, (config.hold_steps / max(step, 1)) ** 0.5)


def _validation_batches(config: TrainConfig, links: Any) -> list[Batch]:
    count = -(-config.validation_samples // 32)
    return [
        config.task.batch(links, 32, np.random.default_rng([2**32 - 1, k]), augment=False)
        for k in range(count)
    ]


def _follow(average: dict[str, Tensor], network: nn.Module, decay: float) -> None:
    state = network.state_dict()
    with torch.no_grad():
        torch._foreach_lerp_(list(average.values()), [state[key] for key in average], 1.0 - decay)
