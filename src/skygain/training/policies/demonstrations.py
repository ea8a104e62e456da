"""Flights of an expert, recorded for imitation.

One survey alternates between two pilots. The learner (in the first round a pilot of random straight
lines) flies a random number of steps, then the expert plans from where that has led and flies its
plan; only the expert's moves are recorded. So the expert is asked in the states that the learner
gets itself into, which is the point of DAgger (Ross, Gordon and Bagnell, 2011), and one plan of an
expert that looks far ahead labels every step it commits to.
"""

from __future__ import annotations

__all__ = ["DemonstrationConfig", "Demonstrations", "fly_demonstration"]

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.environments.worlds import Episode, LinkWorlds
from skygain.flight.swarm import Swarm
from skygain.ground.files import atomic_write
from skygain.measurements import Measurements
from skygain.networks.policies.inputs import Seen, last_moves, moves_of
from skygain.networks.policies.planes import packed_height, packed_mean, packed_std
from skygain.planners.base import Planner
from skygain.planners.random_waypoint import RandomWaypointPlanner
from skygain.predictors.base import Belief
from skygain.survey.methods import MethodSpec

MOST_UAVS = 6


@dataclass(frozen=True)
class DemonstrationConfig:
    """How the expert is watched."""

    worlds: LinkWorlds
    """where"""
    predictors: tuple[str, ...]
    """predictor texts, used in turn"""
    expert: str
    """planner text of the expert"""
    uavs: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    """sizes of swarm, drawn at random"""
    steps: int = 200
    """T"""
    record_every: int = 1
    """of the expert's steps, every so many are kept: neighbours look alike"""
    longest_detour: int = 20
    """the learner flies 0 to so many steps between two plans"""
    learner_share: float = 0.6
    """probability that the learner flies before a plan at all"""


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Joint steps of expert flights; swarms are padded to six UAVs with cells of −1."""

    mean: NDArray[np.uint8]
    """``[step, row, col]`` packed"""
    std: NDArray[np.uint8]
    """``[step, row, col]`` packed"""
    world: NDArray[np.int64]
    """``[step]`` which map"""
    height: NDArray[np.uint8]
    """``[world, row, col]`` packed"""
    flyable: NDArray[np.bool_]
    """``[world, row, col]``"""
    cells: NDArray[np.int16]
    """``[step, 6, (row, col)]``"""
    last: NDArray[np.int8]
    """``[step, 6]`` last move, −1 for none"""
    moves: NDArray[np.int8]
    """``[step, 6]`` the expert's move, −1 where there is none"""
    left: NDArray[np.int16]
    """``[step]`` steps left"""

    def __len__(self) -> int:
        return len(self.mean)

    def save(self, path: Path) -> None:
        """Write to ``path`` (.npz), atomically."""
        with atomic_write(path) as part, part.open("wb") as file:
            np.savez(file, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, paths: list[Path]) -> Demonstrations:
        """All of ``paths`` one after another."""
        parts: dict[str, list[NDArray]] = {f.name: [] for f in fields(cls)}
        worlds = 0
        for path in paths:
            with np.load(path, allow_pickle=False) as file:
                for name, kept in parts.items():
                    kept.append(file[name] + worlds if name == "world" else file[name])
            worlds += len(parts["height"][-1])
        return cls(**{name: np.concatenate(kept) for name, kept in parts.items()})

    def sample(self, rng: np.random.Generator, size: int) -> tuple[Seen, NDArray[np.int64]]:
        """``size`` random pairs of what a UAV saw and where the expert sent it."""
        step, uav = rng.integers(len(self), size=size), rng.integers(MOST_UAVS, size=size)
        while (none := self.moves[step, uav] < 0).any():
            step[none], uav[none] = (
                rng.integers(len(self), size=none.sum()),
                rng.integers(MOST_UAVS, size=none.sum()),
            )
        return self.seen(step, uav), self.moves[step, uav].astype(np.int64)

    def seen(self, step: NDArray[np.int64], uav: NDArray[np.int64]) -> Seen:
        """What ``uav[sample]`` saw at ``step[sample]``."""
        world = self.world[step]
        return Seen(
            mean=self.mean[step],
            std=self.std[step],
            height=self.height[world],
            flyable=self.flyable[world],
            cells=self.cells[step].astype(np.int64),
            uav=uav,
            last=self.last[step, uav].astype(np.int64),
            left=self.left[step].astype(np.int64),
        )


def fly_demonstration(
    config: DemonstrationConfig, learner: Planner | None, seed: tuple[int, ...], path: Path
) -> None:
    """Fly the survey number ``seed[-1]`` of the stream ``seed`` and write it to ``path``."""
    rng = np.random.default_rng(seed)
    text = config.predictors[seed[-1] % len(config.predictors)]
    method = MethodSpec(text, config.expert)
    predictor, expert = method.build_predictor(), method.build_planner()
    world = config.worlds.draw(rng, int(rng.choice(config.uavs)))
    scenario = method.visible(world.scenario, predictor)
    swarm = Swarm.deployed(scenario, world.start, config.steps)
    belief = predictor.begin(scenario).updated(_readings(world, swarm.cells))
    pilot = learner or RandomWaypointPlanner(repeat_probability=0.95)
    kept: dict[str, list[NDArray]] = {
        "mean": [],
        "std": [],
        "cells": [],
        "last": [],
        "moves": [],
        "left": [],
    }
    while (left := int(swarm.steps_left.max())) > 0:
        if rng.random() < config.learner_share:
            for _ in range(min(int(rng.integers(1, config.longest_detour + 1)), left - 1)):
                plan = pilot.plan(swarm, belief, 1, rng)
                swarm, belief = _flown(world, swarm, belief, plan.paths[:, 1])
        plan = expert.plan(swarm, belief, int(swarm.steps_left.max()), rng)
        for k in range(1, plan.commit_steps + 1):
            if k % config.record_every == 1 % config.record_every:
                for name, value in _recorded(swarm, belief, plan.paths[:, k]).items():
                    kept[name].append(value)
            swarm, belief = _flown(world, swarm, belief, plan.paths[:, k])
    arrays = {name: np.stack(values) for name, values in kept.items()}
    Demonstrations(
        **arrays,
        world=np.zeros(len(arrays["mean"]), dtype=np.int64),
        height=packed_height(scenario.city.height_m)[None],
        flyable=scenario.flyable[None],
    ).save(path)


def _flown(
    world: Episode, swarm: Swarm, belief: Belief, cells: NDArray[np.int64]
) -> tuple[Swarm, Belief]:
    moved = (cells != swarm.cells).any(axis=1)
    return swarm.advanced(cells), belief.updated(_readings(world, cells[moved]))


def _readings(world: Episode, cells: NDArray[np.int64]) -> Measurements:
    return Measurements.at(cells, world.truth_db[cells[:, 0], cells[:, 1]].astype(float))


def _recorded(swarm: Swarm, belief: Belief, then: NDArray[np.int64]) -> dict[str, NDArray]:
    posterior, n = belief.posterior(), swarm.n_uavs
    cells = np.full((MOST_UAVS, 2), -1, dtype=np.int16)
    last, moves = np.full(MOST_UAVS, -1, dtype=np.int8), np.full(MOST_UAVS, -1, dtype=np.int8)
    cells[:n], last[:n], moves[:n] = swarm.cells, last_moves(swarm), moves_of(then - swarm.cells)
    return {
        "mean": packed_mean(posterior.mean_db),
        "std": packed_std(posterior.variance_db2),
        "cells": cells,
        "last": last,
        "moves": moves,
        "left": np.array(swarm.steps_left.max(), dtype=np.int16),
    }
