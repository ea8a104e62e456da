"""Training the judge of candidates (`candidate_judge`) on surveys of cities that the operator and
the locator were not trained on.

The second stage rests on the first, so it learns from the split T3, as policies do. Each city is
flown once: a window, its transmitters, a path for each of random waypoints, lawnmower lines,
scattered cells or planned as in `trajectories.covering_paths`, and at three moments of each survey
what the judge would see of every candidate, which candidates stand near the transmitter, and how
the candidates' maps err together: with E[c] the error of candidate c's map over the unvisited
outdoor cells, weights w make the mean squared error wᵀ(EEᵀ/cells)w. The loss is the cross-entropy
of the candidates near the transmitter plus a share of the root of that.
"""

from __future__ import annotations

__all__ = ["train_judge"]

import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.city import City
from skygain.datasets.links import Links, View, load_links, read_links, several_paths
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.ground.executor import process_pool
from skygain.measurements import Measurements
from skygain.networks.checkpoints import save_checkpoint
from skygain.networks.operator.judge import INPUTS, judge_inputs
from skygain.networks.weights import runs_folder, weight_file
from skygain.predictors.networks.operator import OperatorBelief, OperatorPredictor, OperatorSettings
from skygain.scenario import Scenario
from skygain.training.tasks.locator import survey_cells
from skygain.training.train import Result

SIDE = 96
PER_CITY = 4
"""transmitters listened to in each city"""
COARSE_M = 32.0
"""spacing of the first candidates in these surveys; wider than in use, so that the samples stay
small"""
PLANNED = 0.3
"""share of surveys on paths as planners fly them"""
CITIES_AT_ONCE = 4
"""per task of a worker"""
READINGS_AT_ONCE = 24
"""per update of the belief"""
NEAR_M = 8.0
"""standard deviation of the target about the candidate nearest to the transmitter"""
AT_MOST_M = 60.0
BATCH = 16
ERROR_SHARE = 0.4
"""of the root mean squared error in the loss, per dB"""


class _Network(nn.Module):
    """`candidate_judge.CandidateJudge` with gradients."""

    def __init__(self, inputs: Tensor, hidden: int) -> None:
        super().__init__()
        self.centre, self.scale = inputs.mean(0), inputs.std(0) + 1e-3
        self.linear = nn.Linear(INPUTS, 1, bias=False)
        self.hidden = nn.Sequential(
            nn.Linear(INPUTS, hidden),
            nn.SiLU(),
            nn.Linear(hidden, hidden),
            nn.SiLU(),
            nn.Linear(hidden, 1),
        )
        for layer in (self.linear, self.hidden[-1]):
            nn.init.zeros_(layer.weight)  # type: ignore[arg-type]

    def forward(self, inputs: Tensor) -> Tensor:
        x = (inputs - self.centre) / self.scale
        return torch.log_softmax((self.linear(x) + self.hidden(x))[:, 0], dim=0)

    def tensors(self) -> dict[str, Tensor]:
        layers = [layer for layer in self.hidden if isinstance(layer, nn.Linear)]
        found = {"centre": self.centre, "scale": self.scale, "linear": self.linear.weight[0]}
        for i, layer in enumerate(layers):
            found |= {f"{i}.matrix": layer.weight.T, f"{i}.offset": layer.bias}
        return found


@dataclass(frozen=True, eq=False)
class _Sample:
    """One moment of a survey."""

    inputs: Tensor
    """``[candidate, input]``"""
    target: Tensor
    """``[candidate]``"""
    gram: Tensor
    """``[candidate, candidate]`` dB²"""


def train_judge(
    data: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    rounds: int = 30,
    hidden: int = 64,
    weight_decay: float = 0.1,
    seed: int = 0,
    workers: int = 1,
    operator: str | Path = "operator",
    locator: str | Path = "locator",
    pool: str | Path = "",
    report: Callable[[dict[str, Any]], None] = lambda record: None,
) -> Result:
    """Fly T3 for training and T2 for the scores (once, into ``pool``), train, and write the weight
    file ``out``.

    Flying takes a few seconds a city, by ``workers`` processes; a flown city is not flown again for
    the same operator and locator.

    Raises:
        InputError: no such data set, or it lacks one of the two splits.
    """
    begun = time.monotonic()
    predictor = OperatorPredictor(
        weights=operator, locator=locator, judge="", settings=OperatorSettings(coarse_m=COARSE_M)
    )
    parts = {
        split: _flown(data, split, predictor, Path(pool) if str(pool) else None, workers, report)
        for split in ("T3", "T2")
    }
    training, held_out = parts["T3"], parts["T2"]
    torch.manual_seed(seed)
    rng, network = (
        np.random.default_rng(seed),
        _Network(torch.cat([s.inputs for s in training]), hidden),
    )
    optimiser = torch.optim.AdamW(network.parameters(), 3e-3, weight_decay=weight_decay)
    per_round = -(-len(training) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 9e-3, total_steps=rounds * per_round)
    for k in range(rounds):
        order, losses = rng.permutation(len(training)), []
        for some in np.array_split(order, per_round):
            loss = torch.stack(
                [_loss(network(training[i].inputs), training[i]) for i in some]
            ).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(float(loss.detach()))
        report(
            {"round": k + 1, "loss": round(float(np.mean(losses)), 4), **_scores(network, held_out)}
        )
    scores = _scores(network, held_out)
    card = {
        "name": "judge",
        "what": (
            "judge of candidate positions: how their maps agree with the readings -> probability"
        ),
        "data": " + ".join(path.name for path in several_paths(data)) + ", split T3; scores on T2",
        "surveys": len(training) // 3,
        "rounds": rounds,
        "hidden": hidden,
        "weight_decay": weight_decay,
        "seed": seed,
        "scores": scores,
        "recipe": "judge",
    }
    path = Path(out)
    save_checkpoint(path, network.tensors(), card)
    path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n")
    return Result(
        rounds * per_round, rounds * len(training), time.monotonic() - begun, scores, path
    )


def _loss(log_probability: Tensor, sample: _Sample) -> Tensor:
    probability = log_probability.exp()
    entropy = -(sample.target * log_probability.clamp(min=-12.0)).sum()
    return entropy + ERROR_SHARE * torch.sqrt(probability @ sample.gram @ probability + 0.1)


def _scores(network: _Network, samples: list[_Sample]) -> dict[str, float]:
    with torch.inference_mode():
        answers = [network(s.inputs) for s in samples]
    entropy = [
        float(-(s.target * a.clamp(min=-12.0)).sum()) for s, a in zip(samples, answers, strict=True)
    ]
    error = [
        float(torch.sqrt((a.exp() @ s.gram @ a.exp()).clamp(min=0)))
        for s, a in zip(samples, answers, strict=True)
    ]
    best = [float(torch.sqrt(s.gram[k, k])) for s in samples for k in [int(s.target.argmax())]]
    return {
        "cross_entropy": round(float(np.mean(entropy)), 4),
        "rmse_db": round(float(np.mean(error)), 3),
        "rmse_of_nearest_db": round(float(np.mean(best)), 3),
    }


def _flown(
    data: str | Path | Sequence[str | Path],
    split: str,
    predictor: OperatorPredictor,
    pool: Path | None,
    workers: int,
    report: Callable[[dict[str, Any]], None],
) -> list[_Sample]:
    """The surveys of ``split``, flown as far as that has not been done with these weights."""
    sources, flights = (
        (predictor.weights, predictor.paths, predictor.locator),
        (PER_CITY, PLANNED, SIDE),
    )
    state = hashlib.sha256(
        b"".join(
            [
                *(weight_file(name).read_bytes() for name in sources),
                repr((predictor.settings, flights)).encode(),
            ]
        )
    ).hexdigest()[:12]
    files: list[Path] = []
    for path in several_paths(data):
        links = read_links(path, split)
        if links is None:
            continue  # another data set may have some
        cities = len(links.height_m)
        folder = (pool or runs_folder() / "judge-pool") / f"{path.name}-{state}" / split
        folder.mkdir(parents=True, exist_ok=True)
        here = [folder / f"{city:04d}.npz" for city in range(cities)]
        missing = [city for city, file in enumerate(here) if not file.exists()]
        done = 0

        def flown(some: int) -> None:
            nonlocal done
            done += some
            report({"pool": path.name, "split": split, "city": done, "of": len(missing)})  # noqa: B023 - called within the iteration

        if workers > 1 and len(missing) > 1:
            parts = [
                missing[k : k + CITIES_AT_ONCE] for k in range(0, len(missing), CITIES_AT_ONCE)
            ]
            with process_pool(workers) as processes:
                jobs = [
                    processes.submit(_fly_some, path, split, predictor, part, here)
                    for part in parts
                ]
                for job in as_completed(jobs):
                    flown(job.result())
        else:
            for city in missing:
                flown(_fly_some(path, split, predictor, [city], here))
        files += here
    if not files:
        raise InputError(
            f"{', '.join(map(str, several_paths(data)))} holds no link of split {split!r}, which "
            "the judge needs"
        )
    return [sample for file in files for sample in _read(file)]


_held = lru_cache(maxsize=1)(load_links)  # a worker is given a few cities at a time


def _fly_some(
    data: Path, split: str, predictor: OperatorPredictor, cities: list[int], files: list[Path]
) -> int:
    links, threads = _held(data, split), torch.get_num_threads()
    torch.set_num_threads(
        1
    )  # the networks are small; several threads would only wait for each other
    try:
        for city in cities:
            # A stream of its own for every data set, so that two with the same cities fly different
            # surveys.
            stream = [int.from_bytes(data.name.encode()[:8], "little"), ord(split[1]), city]
            _write(
                files[city], _city_samples(links, city, predictor, np.random.default_rng(stream))
            )
    finally:
        torch.set_num_threads(threads)
    return len(cities)


def _city_samples(
    links: Links, city: int, predictor: OperatorPredictor, rng: np.random.Generator
) -> list[_Sample]:
    heard = np.flatnonzero((links.city == city) & links.available.any(axis=1))
    altitude = int(rng.choice(np.flatnonzero(links.available[heard].any(axis=0))))
    heard = heard[links.available[heard, altitude]]
    row, col = links.corner(rng, SIDE)
    samples: list[_Sample] = []
    scenario = None
    for link in rng.permutation(heard)[:PER_CITY]:
        view = links.view(int(link), altitude, row, col, SIDE)
        if scenario is None:
            city_map = City(Grid(view.height_m.shape, links.spacing_m), view.height_m)
            scenario = Scenario(city_map, view.altitude_m, view.altitude_m)
        samples += _survey_samples(scenario, view, predictor, rng)
    return samples


def _survey_samples(
    scenario: Scenario, view: View, predictor: OperatorPredictor, rng: np.random.Generator
) -> list[_Sample]:
    cells, samples = survey_cells(view.outdoor, rng, PLANNED), []
    belief, taken, n = predictor.begin(scenario), 0, len(cells)
    for moment in (
        max(1, int(n * rng.uniform(0.1, 0.4))),
        max(1, int(n * rng.uniform(0.4, 0.8))),
        n,
    ):
        while taken < moment:
            some = cells[taken : min(taken + READINGS_AT_ONCE, moment)]
            belief = belief.updated(
                Measurements.at(some, view.gain_db[some[:, 0], some[:, 1]].astype(float))
            )
            taken += len(some)
        unvisited = view.outdoor.copy()
        unvisited[cells[:taken, 0], cells[:taken, 1]] = False
        samples.append(_sample(belief, view, unvisited))
    return samples


def _sample(belief: OperatorBelief, view: View, unvisited: NDArray[np.bool_]) -> _Sample:
    search = belief.search
    assert search is not None
    inputs = judge_inputs(belief.terms, len(belief.cells), *search.standing())
    place = search.evidence.grid.position[search.chosen, :2] * belief.scenario.grid.spacing_m
    away = np.hypot(*(place - np.array(view.transmitter[:2]) * belief.scenario.grid.spacing_m).T)
    near = np.exp(-0.5 * (away**2 - away.min() ** 2) / NEAR_M**2) * (
        (away < AT_MOST_M) | (away == away.min())
    )
    counted = np.flatnonzero(unvisited)[::3]
    mean, std = belief.maps.whole(belief.candidates, view.altitude_m)
    error = (
        mean[:, counted]
        + std[:, counted] * (belief.whitened.T @ belief.residual.W[:, counted])
        - view.gain_db.ravel()[counted]
    )
    gram = error @ error.T / max(len(counted), 1)
    return _Sample(
        *(
            torch.from_numpy(np.ascontiguousarray(a, dtype=np.float32))
            for a in (inputs, near / near.sum(), gram)
        )
    )


def _write(file: Path, samples: list[_Sample]) -> None:
    part = file.with_suffix(".part")
    arrays = {
        f"{key}{k}": getattr(s, key).numpy()
        for k, s in enumerate(samples)
        for key in ("inputs", "target")
    }
    arrays |= {f"gram{k}": s.gram.numpy().astype(np.float16) for k, s in enumerate(samples)}
    with part.open("wb") as out:
        np.savez(out, **arrays)
    os.replace(part, file)


def _read(file: Path) -> list[_Sample]:
    with np.load(file) as found:
        count = sum(key.startswith("gram") for key in found)
        return [
            _Sample(
                *(
                    torch.from_numpy(found[f"{key}{k}"].astype(np.float32))
                    for key in ("inputs", "target", "gram")
                )
            )
            for k in range(count)
        ]
