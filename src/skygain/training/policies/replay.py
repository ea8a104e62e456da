"""The central replay memory: every joint step once, in files mapped into memory.

A joint step holds the packed maps of mean and standard deviation, the cells, moves and rewards of
all UAVs, and the number of the episode; heights stand once per episode. A UAV's
transition (s, a, r, s′) is put together when it is sampled, its multi-step return included. Nothing
is stored as an observation, so three UAVs at 96 × 96 cells cost 6.2 kB per transition instead of
the 369 kB of two observations of five float planes.

Lanes (surveys stepped together) are rings of equal length. A ring has ``guard`` rows more than are
ever sampled: what is written after a checkpoint overwrites nothing that a run resumed from it may
still ask for.
"""

from __future__ import annotations

__all__ = ["Replay", "ReplayConfig", "Transitions"]

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.environments.surveys import SurveyBatch
from skygain.networks.policies.inputs import Seen
from skygain.networks.policies.planes import action_masks


@dataclass(frozen=True)
class ReplayConfig:
    """Sizes."""

    lanes: int
    """surveys stepped together"""
    n_uavs: int
    """UAVs of each"""
    side: int
    """rows and columns of the maps"""
    steps: int
    """T, steps of an episode"""
    capacity: int
    """transitions (joint steps times UAVs) that can be sampled"""
    guard: int = 0
    """joint steps between checkpoints"""

    @property
    def rows(self) -> int:
        """Joint steps per lane that can be sampled."""
        return max(self.capacity // (self.lanes * self.n_uavs), 1)

    @property
    def slots(self) -> int:
        """Joint steps per lane that are stored."""
        return self.rows + self.guard

    @property
    def episodes(self) -> int:
        """Episodes per lane whose heights are stored."""
        return self.slots // self.steps + 2


@dataclass(frozen=True, eq=False)
class Transitions:
    """A batch for Q-learning."""

    now: Seen
    """s_t"""
    move: NDArray[np.int64]
    """``[sample]`` a_t"""
    reward: NDArray[np.float32]
    """``[sample]`` Σ_{m<M} γ^m r_{t+m}, up to the end of the episode"""
    discount: NDArray[np.float32]
    """``[sample]`` γ^M, 0 if the episode ends within M steps"""
    then: Seen
    """s_{t+M}; of no meaning where the discount is 0"""
    mask: NDArray[np.bool_]
    """``[sample, move]`` legal moves there"""


class Replay:
    """Files in ``folder``; see the module. ``written`` counts joint steps per lane since the
    beginning."""

    def __init__(self, folder: Path, config: ReplayConfig, written: int = 0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.config, self.written = config, written
        c = config
        plane, swarm = (c.side, c.side), (c.n_uavs,)
        shapes: dict[str, tuple[tuple[int, ...], str]] = {
            "mean": (plane, "u1"),
            "std": (plane, "u1"),
            "cells": ((*swarm, 2), "i2"),
            "last": (swarm, "i1"),
            "moves": (swarm, "i1"),
            "reward": (swarm, "f4"),
            "episode": ((), "i4"),
            "step": ((), "i2"),
            "ended": ((), "?"),
        }
        self._files = {
            k: _mapped(folder / f"{k}.bin", (c.lanes, c.slots, *shape), kind)
            for k, (shape, kind) in shapes.items()
        }
        self._worlds = {
            k: _mapped(folder / f"{k}.bin", (c.lanes, c.episodes, *plane), kind)
            for k, kind in (("height", "u1"), ("flyable", "?"))
        }

    def __len__(self) -> int:
        """Transitions that can be sampled."""
        return min(self.written, self.config.rows) * self.config.lanes * self.config.n_uavs

    @property
    def bytes_per_transition(self) -> float:
        """On disk, heights included."""
        c = self.config
        total = sum(m.nbytes for m in (*self._files.values(), *self._worlds.values()))
        return total / (c.slots * c.lanes * c.n_uavs)

    def remember(self, surveys: SurveyBatch, last: NDArray[np.int64]) -> None:
        """Store what the UAVs of ``surveys`` see, ``last[survey, uav]`` being their last moves;
        `complete` adds what came of it."""
        slot = self.written % self.config.slots
        row = {
            "mean": surveys.mean,
            "std": surveys.std,
            "cells": surveys.cells,
            "last": last,
            "episode": surveys.episode,
            "step": surveys.steps_flown,
        }
        for key, value in row.items():
            self._files[key][:, slot] = value
        lanes = np.arange(self.config.lanes)
        self._worlds["height"][lanes, surveys.episode % self.config.episodes] = surveys.height
        self._worlds["flyable"][lanes, surveys.episode % self.config.episodes] = surveys.flyable

    def complete(
        self, moves: NDArray[np.int64], reward: NDArray[np.float32], ended: NDArray[np.bool_]
    ) -> None:
        """The moves chosen in the row just remembered, ``[survey, uav]``, their rewards, and
        ``[survey]`` whether that was the end."""
        slot = self.written % self.config.slots
        (
            self._files["moves"][:, slot],
            self._files["reward"][:, slot],
            self._files["ended"][:, slot],
        ) = moves, reward, ended
        self.written += 1

    def sample(
        self, rng: np.random.Generator, size: int, n_steps: int, discount: float
    ) -> Transitions:
        """``size`` transitions with returns over ``n_steps``; the last ``n_steps`` rows, whose
        successors are missing, are left out."""
        c = self.config
        oldest = max(0, self.written - c.rows)
        row = rng.integers(oldest, self.written - n_steps, size=size)
        lane, uav = rng.integers(c.lanes, size=size), rng.integers(c.n_uavs, size=size)
        total, alive = np.zeros(size), np.ones(size, dtype=bool)
        for m in range(n_steps):
            slot = (row + m) % c.slots
            total += np.where(alive, discount**m * self._files["reward"][lane, slot, uav], 0.0)
            alive &= ~self._files["ended"][lane, slot]
        now, then = self.seen(lane, row, uav), self.seen(lane, row + n_steps, uav)
        return Transitions(
            now=now,
            move=self._files["moves"][lane, row % c.slots, uav].astype(np.int64),
            reward=total.astype(np.float32),
            discount=np.where(alive, discount**n_steps, 0.0).astype(np.float32),
            then=then,
            mask=action_masks(then.flyable, then.cells)[np.arange(size), uav],
        )

    def seen(self, lane: NDArray[np.int64], row: NDArray[np.int64], uav: NDArray[np.int64]) -> Seen:
        """What ``uav[sample]`` saw in joint step ``row[sample]`` of ``lane[sample]``."""
        slot = row % self.config.slots
        world = self._files["episode"][lane, slot] % self.config.episodes
        return Seen(
            mean=self._files["mean"][lane, slot],
            std=self._files["std"][lane, slot],
            height=self._worlds["height"][lane, world],
            flyable=self._worlds["flyable"][lane, world],
            cells=self._files["cells"][lane, slot].astype(np.int64),
            uav=uav,
            last=self._files["last"][lane, slot, uav].astype(np.int64),
            left=self.config.steps - self._files["step"][lane, slot].astype(np.int64),
        )

    def flush(self) -> None:
        """Hand everything to the operating system."""
        for file in (*self._files.values(), *self._worlds.values()):
            file.flush()


def _mapped(path: Path, shape: tuple[int, ...], kind: str) -> np.memmap:
    size = int(np.prod(shape)) * np.dtype(kind).itemsize
    if not path.exists() or path.stat().st_size != size:
        with path.open("wb") as file:
            file.truncate(size)
    return np.memmap(path, dtype=kind, mode="r+", shape=shape)
