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

__all__ = ["JudgeConfig", "JudgeNetwork", "train_judge"]

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.city import City
from skygain.datasets.links import Links, View, several_paths
from skygain.grid import Grid
from skygain.ground.files import atomic_write
from skygain.measurements import Measurements
from skygain.networks.operator.judge import INPUTS, judge_inputs
from skygain.networks.weights import write_weights
from skygain.predictors.networks.operator import OperatorBelief, OperatorPredictor, OperatorSettings
from skygain.scenario import Scenario
from skygain.training.compute import threads
from skygain.training.pools import flown_cities
from skygain.training.rounds import in_rounds
from skygain.training.run import Part, Report, Result, Run
from skygain.training.tasks.locator import survey_cells

SIDE = 96
PER_CITY = 4
"""transmitters listened to in each city"""
COARSE_M = 32.0
"""spacing of the first candidates in these surveys; wider than in use, so that the samples stay
small"""
PLANNED = 0.3
"""share of surveys on paths as planners fly them"""
MOMENTS = 3
"""of each survey that are looked at"""
READINGS_AT_ONCE = 24
"""per update of the belief"""
NEAR_M = 8.0
"""standard deviation of the target about the candidate nearest to the transmitter"""
AT_MOST_M = 60.0
BATCH = 16
ERROR_SHARE = 0.4
"""of the root mean squared error in the loss, per dB"""


@dataclass(frozen=True)
class JudgeConfig:
    """One run; flying takes an hour or more, training minutes."""

    data: str | tuple[str, ...] = "sample"
    """path of the data set, or of several; T3 trains, T2 gives the scores"""
    out: str = ""
    """folder of the run; an existing checkpoint is continued"""
    windows: int = 1
    """windows that are flown in each city"""
    rounds: int = 30
    """passes over all surveys"""
    hidden: int = 64
    """width of the two hidden layers"""
    weight_decay: float = 0.1
    """decoupled weight decay"""
    operator: str = "operator"
    """name or file of the operator's weights"""
    locator: str = "locator"
    """name or file of the locator's weights"""
    pool: str = ""
    """folder of the flown surveys; by default beside the runs"""
    workers: int = 1
    """processes that fly"""
    cluster: str = ""
    """a Dask cluster that flies instead"""
    seed: int = 0
    """of weights and order"""
    max_seconds: float = math.inf
    """stop training after so long; the run continues with the next call"""


class JudgeNetwork(nn.Module):
    """`skygain.networks.operator.judge.CandidateJudge` with gradients."""

    centre: Tensor
    scale: Tensor

    def __init__(self, inputs: Tensor, hidden: int) -> None:
        super().__init__()
        self.register_buffer("centre", inputs.mean(0))
        self.register_buffer("scale", inputs.std(0) + 1e-3)
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
        return {name: tensor.detach() for name, tensor in found.items()}


@dataclass(frozen=True, eq=False)
class _Sample:
    """One moment of a survey."""

    inputs: Tensor
    """``[candidate, input]``"""
    target: Tensor
    """``[candidate]``"""
    gram: Tensor
    """``[candidate, candidate]`` dB²"""


def train_judge(config: JudgeConfig, report: Report = lambda record: None) -> Result:
    """Fly T3 for training and T2 for the scores (once, into the pool), train, and write the weight
    file ``judge.safetensors`` into the run's folder.

    Flying takes a few seconds a city; a flown city is not flown again for the same operator and
    locator.

    Raises:
        InputError: no such data set, or it lacks one of the two splits.
    """
    training, held_out = (_flown(config, split, report) for split in ("T3", "T2"))
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    network = JudgeNetwork(torch.cat([s.inputs for s in training]), config.hidden)
    optimiser = torch.optim.AdamW(network.parameters(), weight_decay=config.weight_decay)
    parts: dict[str, Part] = {"network": network, "optimiser": optimiser, "order": rng}
    run = Run(config.out, config, parts, report)
    per_round = -(-len(training) // BATCH)

    def losses() -> Iterator[Tensor]:
        for some in np.array_split(rng.permutation(len(training)), per_round):
            found = [_loss(network(training[i].inputs), training[i]) for i in some]
            yield torch.stack(found).mean()

    in_rounds(
        run,
        optimiser,
        losses,
        rounds=config.rounds,
        per_round=per_round,
        peak=9e-3,
        scores=lambda: _scores(network, held_out),
    )
    names = " + ".join(path.name for path in several_paths(config.data))
    card = {
        "name": "judge",
        "what": "candidate positions: how their maps agree with the readings -> probability",
        "data": f"{names}, split T3; scores on T2",
        "steps": run.step,
        "scores": run.scores,
        "samples": len(training),
        "recipe": {
            "surveys": len(training) // MOMENTS,
            **{key: getattr(config, key) for key in ("hidden", "weight_decay", "seed")},
        },
    }
    write_weights(run.folder / "judge.safetensors", network.tensors(), card)
    return run.result(run.step * len(training))


def _loss(log_probability: Tensor, sample: _Sample) -> Tensor:
    probability = log_probability.exp()
    entropy = -(sample.target * log_probability.clamp(min=-12.0)).sum()
    return entropy + ERROR_SHARE * torch.sqrt(probability @ sample.gram @ probability + 0.1)


def _scores(network: JudgeNetwork, samples: list[_Sample]) -> dict[str, float]:
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


def _flown(config: JudgeConfig, split: str, report: Report) -> list[_Sample]:
    """The surveys of ``split``, flown as far as that has not been done with these weights."""
    predictor = OperatorPredictor(
        weights=config.operator,
        locator=config.locator,
        judge="",
        # every candidate has a map
        settings=OperatorSettings(coarse_m=COARSE_M, first_maps=10_000),
    )
    files: list[Path] = []
    for window in range(config.windows):
        more = (window,) if window else ()
        files += flown_cities(
            "judge-pool",
            config.data,
            split,
            partial(_fly_city, predictor),
            weights=(predictor.weights, predictor.paths, predictor.locator),
            settings=(predictor.settings, (PER_CITY, PLANNED, SIDE, *more)),
            # a stream of its own for every data set, so that two with the same cities fly
            # different surveys
            stream=lambda path, city, more=more: [  # type: ignore[misc]
                int.from_bytes(path.name.encode()[:8], "little"),
                ord(split[1]),
                city,
                *more,
            ],
            pool=config.pool,
            workers=config.workers,
            cluster=config.cluster,
            report=report,
        )
    return [sample for file in files for sample in _read(file)]


def _fly_city(
    predictor: OperatorPredictor, links: Links, city: int, rng: np.random.Generator, file: Path
) -> None:
    with threads(1):  # the networks are small
        _write(file, _city_samples(links, city, predictor, rng))


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
    place = search.evidence.grid.position[search.candidates(), :2] * belief.scenario.grid.spacing_m
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
    arrays = {
        f"{key}{k}": getattr(s, key).numpy()
        for k, s in enumerate(samples)
        for key in ("inputs", "target")
    }
    arrays |= {f"gram{k}": s.gram.numpy().astype(np.float16) for k, s in enumerate(samples)}
    with atomic_write(file) as part, part.open("wb") as out:
        np.savez(out, **arrays)


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
