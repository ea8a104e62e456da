"""Learning where the transmitter is: surveys of training cities → evidence maps → probability of every square.

Judging thousands of positions by hundreds of readings takes half a second a survey, so the surveys are flown once into a pool on disk
(evidence maps at three moments of each, and where the transmitter really was) and drawn from it many times, turned and mirrored.
"""

from __future__ import annotations

__all__ = ["LocatorPool", "LocatorTask"]

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.learning.links import Links, load_links
from skygain.learning.locator_net import LocatorNet
from skygain.learning.path_model import PathModel
from skygain.learning.tasks import Batch
from skygain.learning.trajectories import lawnmower_cells, random_waypoints, scattered_cells
from skygain.learning.transmitter_evidence import CHANNELS, EvidenceSums, PositionGrid, evidence_channels
from skygain.learning.weights import find_weights, runs_folder

MOMENTS = 3
"""per survey: somewhere in its first part, in its middle, and at its end"""
SHARD = 50
"""surveys per file of a pool"""
READINGS_AT_ONCE = 64
"""bounds the memory of the path model"""
MARGIN_CELLS = 26
SIDE_CELLS = 2
BLUR_M = 4.8
"""standard deviation of the target about the true position"""


@dataclass(frozen=True, eq=False)
class LocatorPool:
    """Flown surveys of one split."""

    channels: list[NDArray[np.float16]]
    """per shard ``[sample, channel, row, col]``, memory-mapped"""
    transmitter: NDArray[np.float32]
    """``[sample, (row, col)]`` of the window"""
    side: int
    """cells along the edge of the window"""

    def __len__(self) -> int:
        return len(self.transmitter)

    def sample(self, k: int, symmetry: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Evidence maps and target of sample ``k``, turned and mirrored as in `Links.view`."""
        per_shard = SHARD * MOMENTS
        maps, (row, col) = self.channels[k // per_shard][k % per_shard], self.transmitter[k]
        if symmetry & 1:
            maps, row = maps[:, ::-1], self.side - 1 - row
        if symmetry & 2:
            maps, col = maps[:, :, ::-1], self.side - 1 - col
        if symmetry & 4:
            maps, row, col = maps.transpose(0, 2, 1), col, row
        maps = maps.astype(np.float32)
        return maps, _target(maps[CHANNELS.index("open")] > 0, float(row), float(col))


def _target(open_: NDArray[np.bool_], row: float, col: float) -> NDArray[np.float32]:
    """Probabilities of the squares: the true position, blurred a little, on open ground."""
    middle = np.arange(len(open_)) * SIDE_CELLS - MARGIN_CELLS + (SIDE_CELLS - 1) / 2
    square = (middle[:, None] - row) ** 2 + (middle[None] - col) ** 2
    square = np.where(open_, square, np.inf)
    weight = np.exp(-0.5 * (square - square.min()) / (BLUR_M / 4.0) ** 2)
    return (weight / weight.sum()).astype(np.float32)


@dataclass(frozen=True)
class LocatorTask:
    """(evidence maps) → probability of every square, all altitudes and any kind of survey."""

    side: int = 96
    """cells along the edge of a survey's window"""
    surveys: int = 2600
    """surveys flown over the training split"""
    held_out: int = 150
    """and over the validation split"""
    altitude_odds: tuple[float, float, float] = (3.0, 1.0, 1.0)
    """relative odds of drawing 10, 20 and 30 m"""
    paths: str = "path-model"
    """name or file of the path model's weights"""
    pool: str = ""
    """folder of the pools; by default beside the runs"""

    def load(self, data: str, split: str, report: Callable[[dict[str, Any]], None]) -> LocatorPool:
        """The pool of ``split``, flown as far as that has not been done yet."""
        folder = Path(self.pool) if self.pool else runs_folder() / "locator-pool"
        folder = folder / split
        folder.mkdir(parents=True, exist_ok=True)
        count = self.surveys if split == "T1" else self.held_out
        links, model = None, None
        files = [folder / f"{k:04d}.npz" for k in range(-(-count // SHARD))]
        for k, file in enumerate(files):
            if not file.exists():
                links = links or load_links(data, split)
                model = model or PathModel.load(find_weights(self.paths))
                _write(file, *self._flown(links, model, np.random.default_rng([ord(split[1]), k])))
                report({"pool": split, "surveys": (k + 1) * SHARD, "of": len(files) * SHARD})
        channels, transmitter = [], []
        for file in files:
            maps = np.load(file.with_suffix(".maps.npy"), mmap_mode="r")
            channels.append(maps)
            with np.load(file) as found:
                transmitter.append(found["transmitter"])
        return LocatorPool(channels, np.concatenate(transmitter), self.side)

    def _flown(
        self, links: Links, model: PathModel, rng: np.random.Generator
    ) -> tuple[NDArray[np.float16], NDArray[np.float32], NDArray[np.float32]]:
        squares = (self.side + 2 * MARGIN_CELLS) // SIDE_CELLS
        maps = np.empty((SHARD * MOMENTS, len(CHANNELS), squares, squares), dtype=np.float16)
        transmitter, card = np.empty((len(maps), 2), np.float32), np.empty((len(maps), 2), np.float32)
        for survey in range(SHARD):
            view = links.draw(rng, self.side, np.asarray(self.altitude_odds), augment=False)
            cells = _survey_cells(view.outdoor, rng)
            n = len(cells)
            sums, taken = EvidenceSums.none(PositionGrid.over(view.height_m, links.spacing_m)), 0
            moments = [max(1, int(n * share)) for share in (rng.uniform(0.1, 0.4), rng.uniform(0.4, 0.8), 1.0)]
            for k, moment in enumerate(moments, survey * MOMENTS):
                while taken < moment:
                    some = cells[taken : min(taken + READINGS_AT_ONCE, moment)]
                    gain = view.gain_db[some[:, 0], some[:, 1]]
                    sums = sums.grown(model, view.height_m, links.spacing_m, view.altitude_m, some, gain)
                    taken += len(some)
                maps[k] = evidence_channels(sums, view.height_m, links.spacing_m, view.altitude_m)
                transmitter[k], card[k] = view.transmitter[:2], (taken, view.altitude_m)
        return maps, transmitter, card

    def network(self) -> nn.Module:
        return LocatorNet()

    def batch(self, links: LocatorPool, size: int, rng: np.random.Generator, augment: bool = True) -> Batch:
        drawn = [links.sample(int(rng.integers(len(links))), int(rng.integers(8)) if augment else 0) for _ in range(size)]
        maps, target = (np.stack(column) for column in zip(*drawn, strict=True))
        return {
            "inputs": torch.from_numpy(maps).contiguous(memory_format=torch.channels_last),
            "target": torch.from_numpy(target).flatten(1),
        }

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        """Cross-entropy between the blurred truth and the network's probabilities."""
        return -(batch["target"] * network(batch["inputs"]).float().clamp(min=-30)).sum(dim=1).mean()

    def scores(self, network: nn.Module, batches: list[Batch], autocast: Any) -> dict[str, float]:
        """Cross-entropy, mean log probability of the 25 m around the transmitter, mean distance of a drawn position."""
        network.eval()
        entropy, near, distance = [], [], []
        with torch.inference_mode(), autocast():
            for batch in batches:
                log_probability = network(batch["inputs"]).float()
                entropy.append(-(batch["target"] * log_probability.clamp(min=-30)).sum(dim=1))
                count = round(log_probability.shape[1] ** 0.5)
                probability = log_probability.exp().reshape(-1, count, count)
                middle = SIDE_CELLS * 4.0 * torch.arange(count)
                target = batch["target"].reshape(-1, count, count)
                row, col = (target.sum(2) @ middle)[:, None, None], (target.sum(1) @ middle)[:, None, None]
                away = torch.hypot(middle[None, :, None] - row, middle[None, None] - col)
                near.append(torch.log((probability * (away < 25)).sum((1, 2)) + 1e-4))
                distance.append((probability * away).sum((1, 2)))
        network.train()
        found = {"cross_entropy": entropy, "log_near": near, "distance_m": distance}
        return {name: round(float(torch.cat(values).mean()), 4) for name, values in found.items()}


def _survey_cells(free: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """``[n, (row, col)]`` distinct cells in the order of measuring: random waypoints (six in ten), lawnmower lines or scattered cells."""
    kind, count = rng.random(), int(np.exp(rng.uniform(np.log(12), np.log(600))))
    if kind < 0.6:
        uavs = int(rng.choice([1, 2, 3, 3, 3, 4, 5, 6, 8]))
        steps = min(max(2 * count // uavs, 4), 300)
        repeat = rng.uniform(0.6, 0.95) if rng.random() < 0.5 else 0.8
        side = 10 if rng.random() < 0.75 else max(free.shape)
        paths = random_waypoints(free, np.full(uavs, steps), rng, repeat=repeat, side=side)
        cells = paths.transpose(1, 0, 2).reshape(-1, 2)
    elif kind < 0.85:
        cells = lawnmower_cells(free, count, rng)
    else:
        cells = scattered_cells(free, count, rng)
    _, first = np.unique(cells[:, 0] * free.shape[1] + cells[:, 1], return_index=True)
    return cells[np.sort(first)][:count]


def _write(file: Path, maps: NDArray, transmitter: NDArray, card: NDArray) -> None:
    """The maps first, so that a shard whose small file exists is whole."""
    for path, save in (
        (file.with_suffix(".maps.npy"), lambda f: np.save(f, maps)),
        (file, lambda f: np.savez(f, transmitter=transmitter, card=card)),
    ):
        part = path.with_suffix(".part")
        with part.open("wb") as out:
            save(out)
        os.replace(part, path)
