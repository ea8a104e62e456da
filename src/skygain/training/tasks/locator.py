"""Learning where the transmitter is: surveys of training cities → evidence maps → probability of
every square.

Judging thousands of positions by hundreds of readings takes half a second a survey, so the surveys
are flown once into a pool on disk (evidence maps at three moments of each, and where the
transmitter really was) and drawn from it many times, turned and mirrored.
"""

from __future__ import annotations

__all__ = ["LocatorPool", "LocatorTask", "survey_cells"]

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.datasets.links import Links, Paths
from skygain.grid import SYMMETRIES, turned, turned_cells
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.networks.operator.evidence import (
    EVIDENCE_CHANNELS,
    EvidenceSums,
    PathPredictions,
    PositionGrid,
    evidence_channels,
)
from skygain.networks.operator.locator import LocatorNet
from skygain.networks.operator.path_model import PathModel
from skygain.networks.weights import weight_file
from skygain.training.pools import flown_cities
from skygain.training.run import Report
from skygain.training.tasks.base import Batch, odds_for
from skygain.training.trajectories import (
    covering_paths,
    lawnmower_cells,
    random_waypoints,
    scattered_cells,
)

MOMENTS = 3
"""per survey: somewhere in its first part, in its middle, and at its end"""
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
    """per city ``[sample, channel, row, col]``, memory-mapped"""
    transmitter: list[NDArray[np.float32]]
    """per city ``[sample, (row, col)]`` of the window"""
    side: int
    """cells along the edge of the window"""

    @cached_property
    def _after(self) -> NDArray[np.int64]:
        return np.cumsum([len(rows) for rows in self.transmitter])

    def __len__(self) -> int:
        return int(self._after[-1])

    def sample(self, k: int, symmetry: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Evidence maps and target of sample ``k``, under a symmetry."""
        city = int(np.searchsorted(self._after, k, side="right"))
        at = k - int(self._after[city])  # from the end: negative
        maps, place = self.channels[city][at], self.transmitter[city][at]
        maps = turned(maps, symmetry)
        row, col = turned_cells(place, (self.side - 1, self.side - 1), symmetry)
        maps = maps.astype(np.float32)
        return maps, _target(maps[EVIDENCE_CHANNELS.index("open")] > 0, float(row), float(col))


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
    flights: int = 4
    """windows and paths drawn in each city; every transmitter of the city is listened to on each"""
    altitude_odds: tuple[float, float, float] = (6.0, 1.0, 1.0)
    """relative odds of drawing 10, 20 and 30 m, among the altitudes that the city has"""
    paths: str = "path-model"
    """name or file of the path model's weights"""
    pool: str = ""
    """folder of the pools; by default beside the runs"""

    def load(self, data: Paths, split: str, report: Report) -> LocatorPool:
        """The pools of ``split`` of every data set, flown as far as that has not been done yet."""
        told = (
            self.side,
            self.flights,
            self.altitude_odds,
            MARGIN_CELLS,
            SIDE_CELLS,
            EVIDENCE_CHANNELS,
        )
        files = flown_cities(
            "locator-pool",
            data,
            split,
            self.fly_city,
            weights=(self.paths,),
            settings=told,
            stream=lambda path, city: [ord(split[1]), city],
            pool=self.pool,
            report=report,
        )
        channels = [np.load(file.with_suffix(".maps.npy"), mmap_mode="r") for file in files]
        transmitter = [np.load(file)["transmitter"] for file in files]
        return LocatorPool(channels, transmitter, self.side)

    def fly_city(self, links: Links, city: int, rng: np.random.Generator, file: Path) -> None:
        """The maps are written first, so that a city whose small file exists is whole."""
        model = PathModel.load(weight_file(self.paths))
        maps, transmitter = self._flown(links, city, model, rng)
        with atomic_write(file.with_suffix(".maps.npy")) as part, part.open("wb") as out:
            np.save(out, maps)
        with atomic_write(file) as part, part.open("wb") as out:
            np.savez(out, transmitter=transmitter)

    def _flown(
        self, links: Links, city: int, model: PathModel, rng: np.random.Generator
    ) -> tuple[NDArray[np.float16], NDArray[np.float32]]:
        maps, transmitter = [], []
        for _ in range(self.flights):
            heard = np.flatnonzero(links.city == city)
            odds = odds_for(links, self.altitude_odds) * links.available[heard].any(axis=0)
            if not odds.sum() > 0:
                raise InputError(
                    f"city {city} of the data set has no map at an altitude wanted (odds of 10, "
                    f"20, 30 m: {self.altitude_odds})"
                )
            altitude = int(rng.choice(len(odds), p=odds / odds.sum()))
            heard = heard[links.available[heard, altitude]]
            row, col = links.corner(rng, self.side)
            views = [links.view(int(link), altitude, row, col, self.side) for link in heard]
            height, altitude_m = views[0].height_m, views[0].altitude_m
            cells = survey_cells(np.logical_and.reduce([view.outdoor for view in views]), rng)
            n, taken = len(cells), 0
            nothing = EvidenceSums.none(PositionGrid.over(height, links.spacing_m))
            sums = [nothing for _ in views]
            moments = [
                max(1, int(n * share))
                for share in (rng.uniform(0.1, 0.4), rng.uniform(0.4, 0.8), 1.0)
            ]
            for moment in moments:
                while taken < moment:
                    some = cells[taken : min(taken + READINGS_AT_ONCE, moment)]
                    predicted = PathPredictions.made(
                        model, nothing.grid, height, links.spacing_m, altitude_m, some
                    )
                    sums = [
                        s.taken(predicted, view.gain_db[some[:, 0], some[:, 1]])
                        for s, view in zip(sums, views, strict=True)
                    ]
                    taken += len(some)
                for s, view in zip(sums, views, strict=True):
                    maps.append(
                        evidence_channels(s, height, links.spacing_m, altitude_m).astype(np.float16)
                    )
                    transmitter.append(view.transmitter[:2])
        return np.stack(maps), np.array(transmitter, np.float32)

    def network(self) -> nn.Module:
        return LocatorNet()

    def batch(
        self, links: LocatorPool, size: int, rng: np.random.Generator, augment: bool = True
    ) -> Batch:
        drawn = [
            links.sample(
                int(rng.integers(len(links))), int(rng.integers(SYMMETRIES)) if augment else 0
            )
            for _ in range(size)
        ]
        maps, target = (np.stack(column) for column in zip(*drawn, strict=True))
        return {
            "inputs": torch.from_numpy(maps).contiguous(memory_format=torch.channels_last),
            "target": torch.from_numpy(target).flatten(1),
        }

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        """Cross-entropy between the blurred truth and the network's probabilities."""
        return (
            -(batch["target"] * network(batch["inputs"]).float().clamp(min=-30)).sum(dim=1).mean()
        )

    def scores(self, network: nn.Module, batches: list[Batch], autocast: Any) -> dict[str, float]:
        """Cross-entropy, mean log probability of the 25 m around the transmitter, mean distance of
        a drawn position."""
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
                row, col = (
                    (target.sum(2) @ middle)[:, None, None],
                    (target.sum(1) @ middle)[:, None, None],
                )
                away = torch.hypot(middle[None, :, None] - row, middle[None, None] - col)
                near.append(torch.log((probability * (away < 25)).sum((1, 2)) + 1e-4))
                distance.append((probability * away).sum((1, 2)))
        network.train()
        found = {"cross_entropy": entropy, "log_near": near, "distance_m": distance}
        return {name: round(float(torch.cat(values).mean()), 4) for name, values in found.items()}


def survey_cells(
    free: NDArray[np.bool_], rng: np.random.Generator, planned: float = 0.0
) -> NDArray[np.int64]:
    """``[n, (row, col)]`` distinct cells in the order of measuring.

    A share of ``planned`` covers the map as planners do; the others are random waypoints (six in
    ten), lawnmower lines or scattered cells.
    """
    kind, count = rng.random(), int(np.exp(rng.uniform(np.log(12), np.log(600))))
    uavs = int(rng.choice([1, 2, 3, 3, 3, 4, 5, 6, 8])) if kind < 0.6 or planned > 0 else 1
    if planned > 0 and rng.random() < planned:
        cells = covering_paths(free, uavs, -(-count // uavs), rng).transpose(1, 0, 2).reshape(-1, 2)
    elif kind < 0.6:
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
