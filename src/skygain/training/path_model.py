"""Training of the path model: single paths of random windows → gain there."""

from __future__ import annotations

__all__ = ["train_path_model"]

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from skygain.datasets.links import Links, load_links
from skygain.networks.checkpoints import save_checkpoint
from skygain.networks.operator.features import CHANNELS, fill_cells
from skygain.networks.operator.path_model import (
    FREE_SPACE_5GHZ_DB,
    HIDDEN,
    LOG_DISTANCE,
    USED,
    PathModel,
)
from skygain.training.train import Result


def train_path_model(
    data: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    rounds: int = 1200,
    seed: int = 0,
    report: Callable[[dict[str, Any]], None] = lambda record: None,
) -> Result:
    """Train on T1 (every round: 16 new windows, 512 cells of each), score on T2, write the weight
    file ``out``; takes a minute."""
    begun = time.monotonic()
    torch.manual_seed(seed)
    net = nn.Sequential(
        nn.Linear(len(USED), HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, 2),
    )
    optimiser = torch.optim.Adam(net.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 5e-3, total_steps=4 * rounds)
    links, rng = load_links(data, "T1"), np.random.default_rng(seed)
    for k in range(rounds):
        features, gain, _ = _sample(links, rng, 16)
        for part in torch.randperm(len(gain)).chunk(4):
            x, y = features[part], gain[part]
            result = net(x[:, USED])
            mean = FREE_SPACE_5GHZ_DB - 20.0 * (x[:, LOG_DISTANCE] + 2.0) + 20.0 * result[:, 0]
            log_std = (math.log(10.0) + result[:, 1]).clamp(0.0, math.log(40.0))
            loss = (
                log_std
                + 0.5 * ((y - mean) * torch.exp(-log_std)) ** 2
                + 0.5 * ((y - mean) / 10.0) ** 2
            ).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
        if k % 20 == 19:
            report({"round": k + 1, "loss": round(float(loss.detach()), 4)})
    linear = [layer for layer in net if isinstance(layer, nn.Linear)]
    tensors = {
        f"{i}.{kind}": getattr(layer, kind)
        for i, layer in enumerate(linear)
        for kind in ("weight", "bias")
    }
    model = PathModel(
        tuple((layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in linear)
    )
    features, gain, traced = _sample(load_links(data, "T2"), np.random.default_rng(seed + 1), 200)
    mean, std = model.of_features(features.numpy())
    error = mean - gain.numpy()
    card = {
        "name": "path-model",
        "rounds": rounds,
        "seed": seed,
        "rmse_db": round(float(np.sqrt(np.mean(error**2))), 3),
        "rmse_traced_db": round(float(np.sqrt(np.mean(error[traced.numpy()] ** 2))), 3),
        "gof": round(float(np.log(np.mean(error**2 / std**2))), 3),
    }
    save_checkpoint(Path(out), tensors, card)
    report(card)
    scores = {key: float(card[key]) for key in ("rmse_db", "rmse_traced_db", "gof")}  # type: ignore[arg-type]
    return Result(4 * rounds, rounds * 16, time.monotonic() - begun, scores, Path(out))


def _sample(links: Links, rng: np.random.Generator, windows: int) -> tuple[Any, ...]:
    features, gain, traced = [], [], []
    for _ in range(windows):
        view = links.draw(rng, 96)
        cells = np.argwhere(view.outdoor)
        cells = cells[rng.integers(len(cells), size=512)]
        found = np.empty((512, 1, len(CHANNELS)), dtype=np.float32)
        fill_cells(
            view.height_m,
            links.spacing_m,
            np.array([view.transmitter]),
            cells,
            view.altitude_m,
            found,
        )
        features.append(found[:, 0])
        gain.append(view.gain_db[cells[:, 0], cells[:, 1]])
        traced.append(view.ray_traced[cells[:, 0], cells[:, 1]])
    return tuple(torch.from_numpy(np.concatenate(column)) for column in (features, gain, traced))
