"""The training loop of every predictor network: batches in, checkpoints and a JSONL log out.

The loop holds no hidden state. Batch k comes from (seed, k), the optimiser, the moving average of
the weights and the step counter are in the checkpoint, so a killed run continues to the very same
weights. Batches are made in a thread beside the network's work (the Numba kernels release the
interpreter lock).
"""

from __future__ import annotations

__all__ = ["Result", "TrainConfig", "train"]

import copy
import functools
import json
import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.weights import load_network, runs_folder
from skygain.training.run import autocast as native_autocast
from skygain.training.run import optimiser_tensors, restore_optimiser, under
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
    finish_steps: int = 0
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


@dataclass(frozen=True)
class Result:
    """Where a run stands."""

    step: int
    """steps made in all"""
    samples: int
    """samples seen in all"""
    seconds: float
    """training time in all, over every call"""
    scores: dict[str, float]
    """last validation"""
    checkpoint: Path
    """file with everything"""


def train(
    config: TrainConfig, report: Callable[[dict[str, Any]], None] = lambda record: None
) -> Result:
    """Train until ``total_steps`` or ``max_seconds``; every log record also goes to ``report``."""
    task, folder = config.task, Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "checkpoint.safetensors"
    links, held_out = (
        task.load(config.data, split, report)
        for split in (config.train_split, config.validation_split)
    )
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")

    torch.manual_seed(config.seed)
    network = task.network().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.AdamW(
        network.parameters(),
        config.learning_rate,
        config.betas,
        config.epsilon,
        config.weight_decay,
        fused=True,
    )
    average = {
        key: value.detach().clone()
        for key, value in network.state_dict().items()
        if value.is_floating_point()
    }
    step, seconds, scores = 0, 0.0, {}
    finish: list[int] | None = None
    if path.exists():
        tensors, meta = load_checkpoint(path)
        step, seconds, scores, finish = (
            meta["step"],
            meta["seconds"],
            meta["scores"],
            meta.get("finish"),
        )
        network.load_state_dict(under("network.", tensors))
        restore_optimiser(optimiser, under("optimiser.", tensors))
        average = {key: value.to(device) for key, value in under("average.", tensors).items()}
    elif config.start_from:
        kept = (
            runs_folder() / config.start_from / "checkpoint.safetensors"
        )  # finer than the weights exported from it
        load_network(network, kept if kept.exists() else config.start_from, adapt=True)
        average = {
            key: value.detach().clone()
            for key, value in network.state_dict().items()
            if value.is_floating_point()
        }
    if finish is None and config.finish_steps:
        finish = [step, config.finish_steps]
    end = config.total_steps if finish is None else sum(finish)
    # The average must forget what was before the rate fell.
    average_decay = (
        config.average_decay
        if finish is None
        else min(config.average_decay, max(0.0, 1.0 - 10.0 / finish[1]))
    )
    (folder / "config.json").write_text(json.dumps(asdict(config), indent=2, default=str))

    on_cuda = functools.partial(torch.autocast, "cuda", dtype=torch.bfloat16, enabled=config.bf16)
    autocast = native_autocast(config.bf16) if device.type == "cpu" else on_cuda
    trial = task.network().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    trial.load_state_dict(network.state_dict())
    validation = [_to(batch, device) for batch in _validation_batches(config, held_out)]
    rate_of = functools.partial(_learning_rate, config, finish)

    def record(**values: Any) -> None:
        line = {
            "step": step,
            "samples": step * config.batch_size,
            "seconds": round(seconds, 1),
            **values,
        }
        with (folder / "log.jsonl").open("a") as log:
            log.write(json.dumps(line) + "\n")
        report(line)

    def save() -> None:
        if average_decay == 0:
            _follow(average, network, 0.0)
        tensors = {f"network.{k}": v for k, v in network.state_dict().items()}
        tensors |= {f"average.{k}": v for k, v in average.items()}
        tensors |= {f"optimiser.{k}": v for k, v in optimiser_tensors(optimiser).items()}
        meta = {"step": step, "seconds": seconds, "scores": scores, "finish": finish}
        save_checkpoint(path, tensors, {**meta, "config": _plain(asdict(config))})

    network.train()
    threads = torch.get_num_threads()
    shared = device.type == "cpu" and config.workers > 1
    if shared:
        torch.set_num_threads(1)  # the workers are the parallelism
    shares = _Shares(task, network, config.workers if device.type == "cpu" else 1, autocast, device)
    begun, saved, losses = time.monotonic(), time.monotonic(), []
    earlier = seconds
    with _prefetched(
        lambda k: task.batch(links, config.batch_size, _stream(config.seed, k)), step, end
    ) as batches:
        for batch in batches:
            for group in optimiser.param_groups:
                group["lr"] = rate_of(step)
            loss = shares.gradients(batch)
            if config.clip_norm > 0:
                nn.utils.clip_grad_norm_(network.parameters(), config.clip_norm)
            torch.set_num_threads(
                threads
            )  # a pass over all weights is shared by all cores, the workers wait meanwhile
            optimiser.step()
            step += 1
            if average_decay > 0:
                _follow(average, network, min(average_decay, step / (step + 10)))
            torch.set_num_threads(1 if shared else threads)
            losses.append(loss)
            now = time.monotonic()
            seconds = earlier + now - begun
            if step % 50 == 0:
                record(loss=round(float(torch.stack(losses).mean()), 5), rate=rate_of(step))
                losses = []
            if step % config.validate_steps == 0 or (finish is not None and step == end):
                trial.load_state_dict(
                    average if average_decay > 0 else network.state_dict(), strict=False
                )
                scores = shares.pool.submit(task.scores, trial, validation, autocast).result()
                record(**scores)
            if now - saved > config.checkpoint_seconds:
                save()
                saved = now
            if now - begun > config.max_seconds:
                break
    save()
    torch.set_num_threads(threads)
    return Result(step, step * config.batch_size, seconds, scores, path)


def _learning_rate(config: TrainConfig, finish: list[int] | None, step: int) -> float:
    rise = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    fall = 1.0 if finish is None else max(0.0, 1.0 - (step - finish[0]) / finish[1])
    return config.learning_rate * rise * fall * min(1.0, (config.hold_steps / max(step, 1)) ** 0.5)


def _stream(seed: int, k: int) -> np.random.Generator:
    return np.random.default_rng([seed, k])


def _validation_batches(config: TrainConfig, links: Any) -> list[Batch]:
    count = -(-config.validation_samples // 32)
    return [
        config.task.batch(links, 32, np.random.default_rng([2**32 - 1, k]), augment=False)
        for k in range(count)
    ]


class _Shares:
    """Data-parallel gradients: each worker takes its share of the batch through the same weights,
    with running statistics of its own."""

    def __init__(
        self,
        task: Task,
        network: nn.Module,
        workers: int,
        autocast: Callable[[], Any],
        device: torch.device,
    ) -> None:
        self.task, self.autocast, self.device = task, autocast, device
        self.parameters = list(network.parameters())
        # deepcopy leaves alone what its memo holds already
        self.networks = [
            network,
            *(
                copy.deepcopy(network, {id(p): p for p in self.parameters})
                for _ in range(workers - 1)
            ),
        ]
        limit = (
            functools.partial(torch.set_num_threads, 1)
            if device.type == "cpu" and workers > 1
            else None
        )
        self.pool = ThreadPoolExecutor(workers, initializer=limit)

    def gradients(self, batch: Batch) -> Tensor:
        """Leave the gradient of the batch's mean loss in the parameters and return that loss."""
        n = len(self.networks)
        parts = [
            _to({key: value[i::n] for key, value in batch.items()}, self.device) for i in range(n)
        ]
        losses, gradients = zip(*self.pool.map(self._share, self.networks, parts), strict=True)
        total = list(gradients[0])
        for more in gradients[1:]:
            torch._foreach_add_(total, more)
        for p, gradient in zip(self.parameters, total, strict=True):
            # Fused Adam walks through memory, so a gradient must lie as its parameter does
            # (channels last).
            p.grad = (
                gradient if gradient.stride() == p.stride() else torch.empty_like(p).copy_(gradient)
            )
        with (
            torch.no_grad()
        ):  # the running statistics of the normalisation layers are those of all shares
            for buffers in zip(
                *(network.named_buffers() for network in self.networks), strict=True
            ):
                if "running_" in buffers[0][0]:
                    mean = torch.stack([buffer for _, buffer in buffers]).mean(0)
                    for _, buffer in buffers:
                        buffer.copy_(mean)
        return torch.stack(losses).sum()

    def _share(self, network: nn.Module, part: Batch) -> tuple[Tensor, tuple[Tensor, ...]]:
        with self.autocast():
            loss = self.task.loss(network, part) / len(self.networks)
        return loss.detach(), torch.autograd.grad(loss, self.parameters)


class _prefetched:  # noqa: N801 - reads as a verb in a with statement
    """Iterator over ``make(k)`` for k in [first, end), made three ahead in a thread."""

    def __init__(self, make: Callable[[int], Batch], first: int, end: int) -> None:
        self.make, self.first, self.end = make, first, end
        self.ready: queue.Queue[Batch | BaseException | None] = queue.Queue(maxsize=3)
        self.stop = threading.Event()
        self.worker = threading.Thread(target=self._work, daemon=True)

    def _put(self, item: Batch | BaseException | None) -> None:
        while not self.stop.is_set():
            with suppress(queue.Full):
                self.ready.put(item, timeout=0.2)
                return

    def _work(self) -> None:
        try:
            for k in range(self.first, self.end):
                if self.stop.is_set():
                    return
                self._put(self.make(k))
            self._put(None)
        except BaseException as error:  # handed to the consumer, who raises it
            self._put(error)

    def __enter__(self) -> Iterator[Batch]:
        self.worker.start()

        def batches() -> Iterator[Batch]:
            while (item := self.ready.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                yield item

        return batches()

    def __exit__(self, *error: object) -> None:
        self.stop.set()
        self.worker.join()


def _follow(average: dict[str, Tensor], network: nn.Module, decay: float) -> None:
    state = network.state_dict()
    with torch.no_grad():
        torch._foreach_lerp_(list(average.values()), [state[key] for key in average], 1.0 - decay)


def _to(batch: Batch, device: torch.device) -> Batch:
    return {key: value.to(device, non_blocking=True) for key, value in batch.items()}


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=str))
