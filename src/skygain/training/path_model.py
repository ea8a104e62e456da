"""Training of the path model: single paths of random windows → gain there."""

from __future__ import annotations

__all__ = ["PathModelConfig", "train_path_model"]

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from skygain.datasets.links import Links, load_links, several_paths
from skygain.networks.operator.features import CHANNELS, fill_cells
from skygain.networks.operator.path_model import (
    FREE_SPACE_5GHZ_DB,
    HIDDEN,
    LOG_DISTANCE,
    USED,
    PathModel,
)
from skygain.networks.weights import write_weights
from skygain.training.rounds import in_rounds
from skygain.training.run import Part, Report, Result, Run

WINDOWS = 16
"""new windows in each round"""
CELLS = 512
"""cells of each"""
PARTS = 4
"""steps of a round"""


@dataclass(frozen=True)
class PathModelConfig:
    """One run; it takes a minute."""

    data: str | tuple[str, ...] = "sample"
    """path of the data set, or of several; T1 trains, T2 gives the scores"""
    out: str = ""
    """folder of the run; an existing checkpoint is continued"""
    rounds: int = 1200
    """rounds in all"""
    seed: int = 0
    """of weights and data"""
    max_seconds: float = math.inf
    """stop this call after so long; the run continues with the next call"""


def train_path_model(config: PathModelConfig, report: Report = lambda record: None) -> Result:
    """Train, score, and write the weight file ``path-model.safetensors`` into the run's folder."""
    links, held_out = (load_links(config.data, split) for split in ("T1", "T2"))
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    network = nn.Sequential(
        nn.Linear(len(USED), HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, 2),
    )
    optimiser = torch.optim.Adam(network.parameters())
    parts: dict[str, Part] = {
        "network": network,
        "optimiser": optimiser,
        "windows": rng,
        "order": torch.default_generator,
    }
    run = Run(config.out, config, parts, report)

    def losses() -> Iterator[Tensor]:
        features, gain, _ = _sample(links, rng, WINDOWS)
        for part in torch.randperm(len(gain)).chunk(PARTS):
            yield _loss(network, features[part], gain[part])

    in_rounds(run, optimiser, losses, rounds=config.rounds, per_round=PARTS, peak=5e-3, every=20)
    linear = [layer for layer in network if isinstance(layer, nn.Linear)]
    model = PathModel(
        tuple((layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in linear)
    )
    run.scores = _scores(model, held_out, np.random.default_rng(config.seed + 1))
    run.record(**run.scores)
    run.save()
    tensors = {
        f"{i}.{kind}": getattr(layer, kind).detach()
        for i, layer in enumerate(linear)
        for kind in ("weight", "bias")
    }
    card = {
        "name": "path-model",
        "what": "geometry of one path -> mean and standard deviation of the gain",
        "data": " + ".join(path.name for path in several_paths(config.data)),
        "steps": run.step,
        "scores": run.scores,
        "samples": run.step * WINDOWS,
        "recipe": {"seed": config.seed},
    }
    write_weights(run.folder / "path-model.safetensors", tensors, card)
    return run.result(run.step * WINDOWS)


def _sample(links: Links, rng: np.random.Generator, windows: int) -> tuple[Tensor, Tensor, Tensor]:
    """Features ``[path, channel]``, gain and whether a ray arrived, of cells of random windows."""
    features, gain, traced = [], [], []
    for _ in range(windows):
        view = links.draw(rng, 96)
        cells = np.argwhere(view.outdoor)
        cells = cells[rng.integers(len(cells), size=CELLS)]
        found = np.empty((CELLS, 1, len(CHANNELS)), dtype=np.float32)
        place = np.array([view.transmitter])
        fill_cells(view.height_m, links.spacing_m, place, cells, view.altitude_m, found)
        features.append(found[:, 0])
        gain.append(view.gain_db[cells[:, 0], cells[:, 1]])
        traced.append(view.ray_traced[cells[:, 0], cells[:, 1]])
    columns = (torch.from_numpy(np.concatenate(column)) for column in (features, gain, traced))
    return tuple(columns)  # type: ignore[return-value]


def _loss(network: nn.Module, features: Tensor, gain: Tensor) -> Tensor:
    """Gaussian likelihood plus the squared error over 10 dB."""
    result = network(features[:, USED])
    mean = FREE_SPACE_5GHZ_DB - 20.0 * (features[:, LOG_DISTANCE] + 2.0) + 20.0 * result[:, 0]
    log_std = (math.log(10.0) + result[:, 1]).clamp(0.0, math.log(40.0))
    error = gain - mean
    likelihood = log_std + 0.5 * (error * torch.exp(-log_std)) ** 2
    return (likelihood + 0.5 * (error / 10.0) ** 2).mean()


def _scores(model: PathModel, links: Links, rng: np.random.Generator) -> dict[str, float]:
    features, gain, traced = _sample(links, rng, 200)
    mean, std = model.of_features(features.numpy())
    error = mean - gain.numpy()
    found = {
        "rmse_db": np.sqrt(np.mean(error**2)),
        "rmse_traced_db": np.sqrt(np.mean(error[traced.numpy()] ** 2)),
        "gof": np.log(np.mean(error**2 / std**2)),
    }
    return {name: round(float(value), 3) for name, value in found.items()}
