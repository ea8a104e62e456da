"""Learning from surveys: (city, measurements so far) → gain, for the paper's U-Nets and for our
direct network."""

from __future__ import annotations

__all__ = ["DirectTask", "PaperTask", "measured_cells"]

from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.datasets.links import Links, View
from skygain.networks.operator.network import OperatorConfig
from skygain.networks.scales import PAPER_SIDE
from skygain.networks.unets.direct import DirectNet
from skygain.networks.unets.inputs import direct_inputs, paper_inputs
from skygain.networks.unets.paper import PaperUNets
from skygain.training.likelihood import gaussian_loss
from skygain.training.tasks.base import Batch, GainTask, odds_for, stacked
from skygain.training.trajectories import (
    covering_paths,
    lawnmower_cells,
    random_waypoints,
    scattered_cells,
)


def _odds(links: Links, altitude_m: float) -> NDArray[np.float64]:
    return (links.altitude_m == altitude_m).astype(float)


def _mask(shape: tuple[int, int], cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, dtype=bool)
    mask[cells[..., 0], cells[..., 1]] = True
    return mask


def _with_inputs(views: list[View], inputs: NDArray[np.float32]) -> Batch:
    maps = torch.from_numpy(inputs).contiguous(memory_format=torch.channels_last)
    return {"inputs": maps, **stacked(views)}


def _surveyed(
    views: list[View], measured: list[NDArray[np.bool_]]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Heights, gains and the mask of measured cells, each ``[sample, row, col]``."""
    heights, gains = (
        np.stack([getattr(view, name) for view in views]) for name in ("height_m", "gain_db")
    )
    return heights, gains, np.stack(measured)


@dataclass(frozen=True)
class PaperTask(GainTask):
    """The paper's training (section VIII-B): N random-waypoint UAVs, p = 0.8, 50–300 steps each."""

    uavs: int = 3
    """N; the paper trains one model per N"""
    altitude_m: float = 10.0
    """one model per altitude"""
    blind: bool = False
    """the map-blind twin sees the measurements only"""
    side: int = PAPER_SIDE
    """cells along the edge of a training window; the network's dense layer allows no other"""

    def network(self) -> nn.Module:
        return PaperUNets(self.blind)

    def batch(
        self, links: Links, size: int, rng: np.random.Generator, augment: bool = True
    ) -> Batch:
        views, measured = [], []
        for _ in range(size):
            view = links.draw(rng, self.side, _odds(links, self.altitude_m), augment)
            paths = random_waypoints(view.outdoor, rng.integers(50, 301, size=self.uavs), rng)
            views.append(view)
            measured.append(_mask(view.outdoor.shape, paths))
        return _with_inputs(views, paper_inputs(*_surveyed(views, measured), self.blind))

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        return gaussian_loss(*self.predict(network, batch), batch["truth"], batch["mask"])

    def predict(self, network: nn.Module, batch: Batch) -> tuple[Tensor, Tensor]:
        return network(batch["inputs"])


@dataclass(frozen=True)
class DirectTask(GainTask):
    """Any number of UAVs on any kind of path: the mixture that keeps a network from relying on one
    planner's habits."""

    side: int = 96
    """cells along the edge of a training window"""
    altitude_odds: tuple[float, float, float] = (6.0, 1.0, 1.0)
    """relative odds of drawing 10, 20 and 30 m"""
    planned: float = 0.2
    """share of surveys on paths as planners fly them, see `trajectories.covering_paths`"""
    mean_scale_db: float = 10.0
    """scale of the squared error added to the likelihood, see `gaussian_loss`"""
    net: OperatorConfig = field(default_factory=OperatorConfig)
    """sizes of the network"""

    def network(self) -> nn.Module:
        return DirectNet(self.net)

    def batch(
        self, links: Links, size: int, rng: np.random.Generator, augment: bool = True
    ) -> Batch:
        views = [
            links.draw(rng, self.side, odds_for(links, self.altitude_odds), augment)
            for _ in range(size)
        ]
        measured = [
            _mask(v.outdoor.shape, measured_cells(v.outdoor, rng, self.planned)) for v in views
        ]
        altitudes = np.array([v.altitude_m for v in views])
        return _with_inputs(views, direct_inputs(*_surveyed(views, measured), altitudes))

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        return gaussian_loss(
            *self.predict(network, batch), batch["truth"], batch["mask"], self.mean_scale_db
        )

    def predict(self, network: nn.Module, batch: Batch) -> tuple[Tensor, Tensor]:
        return network(batch["inputs"])


def measured_cells(
    free: NDArray[np.bool_], rng: np.random.Generator, planned: float = 0.0
) -> NDArray[np.int64]:
    """``[n, (row, col)]`` cells of a survey of a random kind and size.

    A share of ``planned`` covers the map as planners do (1–8 UAVs). Of the others six in ten are
    random waypoints (1–8 UAVs, p from 0.5 to 0.97, clustered or spread starts), three lawnmower
    lines, one scattered.
    """
    count = int(np.exp(rng.uniform(np.log(10), np.log(4000))))
    if rng.random() < planned:
        uavs = int(rng.integers(1, 9))
        side = 10 if rng.random() < 0.7 else max(free.shape)
        return covering_paths(free, uavs, min(max(count // uavs, 1), 600), rng, side=side).reshape(
            -1, 2
        )
    kind = rng.random()
    if kind < 0.6:
        uavs = int(rng.integers(1, 9))
        lengths = np.full(uavs, min(max(count // uavs, 1), 600))
        repeat, side = rng.uniform(0.5, 0.97), 10 if rng.random() < 0.7 else max(free.shape)
        return random_waypoints(free, lengths, rng, repeat=repeat, side=side).reshape(-1, 2)
    if kind < 0.9:
        return lawnmower_cells(free, count, rng)
    return scattered_cells(free, count, rng)
