"""One resumable run: a folder with config.json, log.jsonl and checkpoint.safetensors.

Everything that learns here keeps its networks, optimisers and counters in a `Run`. Batches and
flights come from streams keyed by seed and step, or from generators that stand in the checkpoint
too. So a run that was killed goes on to the very bytes of one left alone.
"""

from __future__ import annotations

__all__ = ["Part", "Report", "Result", "Run", "one_cycle", "set_rate", "stop_runs", "under"]

import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skygain.datasets.links import origin_of
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write, unwritable, writable_folder
from skygain.ground.strict_json import json_text, plain
from skygain.training.checkpoints import load_checkpoint, save_checkpoint

Part = (
    nn.Module | torch.optim.Optimizer | dict[str, Tensor] | np.random.Generator | torch._C.Generator
)
"""what a checkpoint can hold"""
Report = Callable[[dict[str, Any]], None]
"""hears every record of the log"""


_asked_to_stop = Event()


def stop_runs() -> None:
    """Every run of this process ends after what is under way, and is saved."""
    _asked_to_stop.set()


@dataclass(frozen=True)
class Result:
    """Where a run stands."""

    step: int
    """steps made in all, in the run's own measure"""
    samples: int
    """samples learned from in all"""
    seconds: float
    """time in all, over every call"""
    scores: dict[str, float]
    """the last ones"""
    checkpoint: Path
    """file with everything"""


class Run:
    """A run under way. ``step``, ``scores`` and ``state`` are kept in the checkpoint beside the
    parts; whoever trains changes them in place."""

    def __init__(
        self,
        folder: str | os.PathLike[str],
        config: Any,
        parts: Mapping[str, Part],
        report: Report = lambda record: None,
        **state: Any,
    ) -> None:
        """Begin in ``folder``, or restore ``parts`` and ``state`` from the checkpoint that is
        there.

        ``config`` is a dataclass; its ``max_seconds``, if it has one, limits this call.

        Raises:
            InputError: the folder cannot be written to, or its checkpoint is none, that of
                another kind of run, or one that learned from another propagation model.
        """
        self.folder = writable_folder(folder)
        self.path = self.folder / "checkpoint.safetensors"
        self.config, self.parts, self.report = plain(config), parts, report
        self.step, self.scores, self.state = 0, dict[str, float](), state
        data = getattr(config, "data", None)
        self._origin = None if data is None else origin_of(data)
        self._limit = getattr(config, "max_seconds", math.inf)
        self._earlier = 0.0
        self.resumed = self.path.exists()
        if self.resumed:
            self._restore()
        with atomic_write(self.folder / "config.json") as file:
            file.write_text(json_text(config), encoding="utf-8")
        self._begun = self._saved = time.monotonic()

    @property
    def seconds(self) -> float:
        """Time of the run in all, over every call."""
        return self._earlier + time.monotonic() - self._begun

    @property
    def deadline(self) -> float:
        """When this call has to end, on the clock `time.monotonic`."""
        return self._begun + self._limit

    @property
    def over(self) -> bool:
        """Whether this call has had its time, or was asked to stop."""
        return _asked_to_stop.is_set() or time.monotonic() > self.deadline

    @property
    def unsaved_seconds(self) -> float:
        """Time since the last checkpoint of this call."""
        return time.monotonic() - self._saved

    def record(self, **values: Any) -> None:
        """Write a line of the log and report it."""
        line = plain({"step": self.step, "seconds": round(self.seconds, 1), **values})
        log = self.folder / "log.jsonl"
        try:
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise unwritable(log, error) from error
        self.report(line)

    def save(self) -> None:
        """Write the checkpoint; a kill at any moment leaves a whole one."""
        tensors = {
            f"{name}.{key}": value
            for name, part in self.parts.items()
            for key, value in _tensors(part).items()
        }
        meta = {"step": self.step, "scores": self.scores, "seconds": self.seconds}
        save_checkpoint(self.path, tensors, {**self.state, **meta, **self._told})
        self._saved = time.monotonic()

    @property
    def _told(self) -> dict[str, Any]:
        return {"config": self.config, "origin": self._origin}

    def result(self, samples: int) -> Result:
        """Where the run stands, after ``samples`` in all."""
        return Result(self.step, samples, self.seconds, self.scores, self.path)

    def _restore(self) -> None:
        tensors, meta = load_checkpoint(self.path)
        try:
            self.step, self.scores, self._earlier = meta["step"], meta["scores"], meta["seconds"]
            self.state = {key: meta[key] for key in self.state}
            for name, part in self.parts.items():
                _fill(part, under(f"{name}.", tensors))
        except (KeyError, IndexError, RuntimeError, ValueError) as error:
            reason = " ".join(str(error).split())[:120]
            raise InputError(
                f"{self.path} belongs to another kind of run ({reason}); give the settings it was "
                "begun with, or another folder as `out`"
            ) from error
        learned = meta.get("origin")
        if learned != self._origin:
            raise InputError(
                f"{self.path} learned from {learned or 'data of an unknown model'}, and `data` is "
                f"now {self._origin}; give the data it was begun with, or another folder as `out`"
            )


def under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose names begin with ``prefix``, without it."""
    return {
        key.removeprefix(prefix): value for key, value in tensors.items() if key.startswith(prefix)
    }


def set_rate(optimiser: torch.optim.Optimizer, rate: float, **others: Any) -> None:
    """The learning rate (and ``others``, such as Adam's ``betas``) of the next step."""
    for group in optimiser.param_groups:
        group.update(others, lr=rate)


def one_cycle(step: int, total: int, peak: float) -> tuple[float, float]:
    """Learning rate and momentum of ``step`` of ``total``: the rate rises from peak / 25 over the
    first 30 % and falls to peak / 250,000, both by a cosine; the momentum goes from 0.95 to 0.85
    and back (Smith and Topin, 2018)."""

    def between(start: float, end: float, share: float) -> float:
        return end + (start - end) / 2.0 * (math.cos(math.pi * share) + 1)

    top, last = 0.3 * total - 1, total - 1
    if step <= top:
        return between(peak / 25, peak, step / top), between(0.95, 0.85, step / top)
    share = (step - top) / (last - top)
    return between(peak, peak / 25 / 1e4, share), between(0.85, 0.95, share)


def _tensors(part: Part) -> dict[str, Tensor]:
    """What there is to keep of ``part``, by name."""
    if isinstance(part, nn.Module):
        return part.state_dict()
    if isinstance(part, torch.optim.Optimizer):
        state = part.state_dict()["state"]
        return {f"{i}.{key}": value for i, kept in state.items() for key, value in kept.items()}
    if isinstance(part, np.random.Generator):
        text = json.dumps(part.bit_generator.state)
        return {"state": torch.tensor(list(text.encode()), dtype=torch.uint8)}
    return {"state": part.get_state()} if isinstance(part, torch._C.Generator) else part


def _fill(part: Part, tensors: dict[str, Tensor]) -> None:
    """The inverse of `_tensors`."""
    if isinstance(part, nn.Module):
        part.load_state_dict(tensors)
    elif isinstance(part, torch.optim.Optimizer):
        _fill_optimiser(part, tensors)
    elif isinstance(part, np.random.Generator):
        part.bit_generator.state = json.loads(bytes(tensors["state"].tolist()))
    elif isinstance(part, torch._C.Generator):
        part.set_state(tensors["state"])
    else:
        for key, value in part.items():
            value.copy_(tensors[key])


def _fill_optimiser(optimiser: torch.optim.Optimizer, tensors: dict[str, Tensor]) -> None:
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        index, _, key = name.partition(".")
        # Fused Adam walks through memory, so its moments must lie as the parameter does.
        if value.ndim:
            value = torch.empty_like(parameters[int(index)], dtype=value.dtype).copy_(value)
        state.setdefault(int(index), {})[key] = value
    groups = optimiser.state_dict()["param_groups"]
    optimiser.load_state_dict({"state": state, "param_groups": groups})
