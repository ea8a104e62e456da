"""What is learned: a task makes batches, names the network and scores it; `train` knows nothing
else about it.

Batch number k is a function of (seed, k) alone, so a resumed run sees exactly the data it would
have seen.
"""

from __future__ import annotations

__all__ = ["GainTask", "OperatorTask", "Task", "scores_of"]

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.datasets.links import Links, Paths, View, load_links
from skygain.networks.operator.features import CHANNELS, PROFILE_CHANNELS, fill_features
from skygain.networks.operator.network import OperatorConfig, PropagationOperator
from skygain.training.likelihood import gaussian_loss, gaussian_scores
from skygain.training.run import Report

Batch = dict[str, Tensor]


class Task(Protocol):
    """One thing to learn."""

    @property
    def side(self) -> int:
        """Cells along the edge of a training window."""

    def load(self, data: Paths, split: str, report: Report) -> Any:
        """What batches are made of, from one split of the data sets ``data``; ``report`` hears of
        long preparations."""

    def network(self) -> nn.Module:
        """A fresh network; its initial weights come from PyTorch's global generator."""

    def batch(self, links: Any, size: int, rng: np.random.Generator, augment: bool = True) -> Batch:
        """``size`` samples drawn from what `load` gave."""

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        """The scalar to minimise."""

    def scores(self, network: nn.Module, batches: list[Batch], autocast: Any) -> dict[str, float]:
        """Validation scores."""


class GainTask:
    """What tasks share that learn gain maps from the links of a data set."""

    def load(self, data: Paths, split: str, report: Report) -> Links:
        return load_links(data, split)

    def predict(self, network: nn.Module, batch: Batch) -> tuple[Tensor, Tensor]:
        """Mean in dB and log variance, each ``[sample, row, col]``."""
        raise NotImplementedError

    def scores(self, network: nn.Module, batches: list[Batch], autocast: Any) -> dict[str, float]:
        return scores_of(self, network, batches, autocast)


def odds_for(links: Links, odds: tuple[float, float, float]) -> NDArray[np.float64]:
    """``[altitude]`` relative odds of the links' altitudes from those of 10, 20 and 30 m; any other
    altitude has 1."""
    known = dict(zip((10.0, 20.0, 30.0), odds, strict=True))
    return np.array([known.get(float(altitude), 1.0) for altitude in links.altitude_m])


def stacked(views: list[View]) -> Batch:
    """The targets of a batch of views."""
    return {
        "truth": torch.from_numpy(np.stack([v.gain_db for v in views])),
        "mask": torch.from_numpy(np.stack([v.outdoor for v in views])),
        "ray_traced": torch.from_numpy(np.stack([v.ray_traced for v in views])),
        "altitude_m": torch.tensor([v.altitude_m for v in views]),
    }


@dataclass(frozen=True)
class OperatorTask(GainTask):
    """(city, transmitter) → gain, at all altitudes with one network."""

    side: int = 96
    """cells along the edge of a training window"""
    altitude_odds: tuple[float, float, float] = (2.0, 1.0, 1.0)
    """relative odds of drawing 10, 20 and 30 m"""
    profile: bool = True
    """whether the network sees the heights along the path; without, it has the map, distance and
    direction only"""
    mean_scale_db: float = 10.0
    """scale of the squared error added to the likelihood, see `gaussian_loss`"""
    net: OperatorConfig = field(default_factory=OperatorConfig)
    """sizes of the network"""

    def network(self) -> nn.Module:
        return PropagationOperator(self.net)

    def batch(
        self, links: Links, size: int, rng: np.random.Generator, augment: bool = True
    ) -> Batch:
        views = [
            links.draw(rng, self.side, odds_for(links, self.altitude_odds), augment)
            for _ in range(size)
        ]
        inputs = np.empty((size, len(CHANNELS), self.side, self.side), dtype=np.float32)
        for view, out in zip(views, inputs, strict=True):
            fill_features(view.height_m, links.spacing_m, *view.transmitter, view.altitude_m, out)
        if not self.profile:
            inputs[:, -len(PROFILE_CHANNELS) :] = 0.0
        return {
            "inputs": torch.from_numpy(inputs).to(memory_format=torch.channels_last),
            **stacked(views),
        }

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        mean, log_variance = network(batch["inputs"])
        return gaussian_loss(mean, log_variance, batch["truth"], batch["mask"], self.mean_scale_db)

    def predict(self, network: nn.Module, batch: Batch) -> tuple[Tensor, Tensor]:
        mean, log_variance = network(batch["inputs"])
        return mean, log_variance


def scores_of(
    task: GainTask, network: nn.Module, batches: list[Batch], autocast: Any
) -> dict[str, float]:
    """Validation scores by altitude: RMSE (all cells, ray-traced cells, the rest), NLL, goodness of
    fit, cover of the 90 % interval."""
    network.eval()
    sums: dict[str, list[Tensor]] = {}
    with torch.inference_mode(), autocast():
        for batch in batches:
            mean, log_variance = task.predict(network, batch)
            parts = gaussian_scores(
                mean.float(),
                log_variance.float(),
                batch["truth"],
                batch["mask"],
                batch["ray_traced"],
            )
            for key, value in {**parts, "altitude_m": batch["altitude_m"]}.items():
                sums.setdefault(key, []).append(value)
    network.train()
    total = {key: torch.cat(value) for key, value in sums.items()}
    scores = {}
    for altitude in torch.unique(total["altitude_m"]).tolist():
        chosen = total["altitude_m"] == altitude
        s = {key: value[chosen] for key, value in total.items()}
        cells, traced = s["cells"].sum(), s["traced_cells"].sum()
        found = {
            "rmse_db": (s["square"] / s["cells"]).sqrt().mean(),
            "rmse_traced_db": (s["traced_square"].sum() / traced).sqrt(),
            "rmse_rest_db": (
                (s["square"].sum() - s["traced_square"].sum()) / (cells - traced)
            ).sqrt(),
            "nll": s["nll"].sum() / cells,
            "gof": (s["ratio"].sum() / cells).log(),
            "cover90": s["covered"].sum() / cells,
        }
        scores.update(
            {f"{key}@{altitude:g}": round(float(value), 4) for key, value in found.items()}
        )
    return scores
