"""How the operator's residual correlates, and which likelihood finds the transmitter: what the operator's settings were chosen by.

    python benchmarks/transmitter_likelihood.py DATA.zarr.zip --surveys 40

prints (1) the correlation of the operator's standardised residual over distance on T2, transmitter known, and (2) for several
likelihoods and powers, over random-waypoint surveys of T2 and T3 at 50, 100 and 200 steps, the mean log probability the path model
gives to the 25 m around the true transmitter (higher is better) and the expected distance of a drawn position. No T4 city is touched.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from skygain.datasets import ChannelDataset, survey_cases
from skygain.learning.links import load_links
from skygain.learning.operator_net import PropagationOperator
from skygain.learning.path_model import PathModel
from skygain.learning.tasks import OperatorTask
from skygain.learning.weights import find_weights, load_network
from skygain.planners.random_waypoint import RandomWaypointPlanner
from skygain.predictors.evidence import Evidence, Factor, posterior_weights
from skygain.predictors.residual_field import CorrelationModel
from skygain.predictors.transmitter_search import coarse_squares
from skygain.swarm import Swarm

STEPS = (50, 100, 200)
LIKELIHOODS = {
    "chosen": (CorrelationModel(length_m=30.0, far_share=0.1, nugget=0.7), 3.0, 3.0),
    "measured correlation": (CorrelationModel(), 3.0, 3.0),
    "almost independent": (CorrelationModel(nugget=0.95), 3.0, 3.0),
    "not softened": (CorrelationModel(length_m=30.0, far_share=0.1, nugget=0.7), 3.0, 1e3),
    "nearly normal": (CorrelationModel(length_m=30.0, far_share=0.1, nugget=0.7), 50.0, 3.0),
}
"""name → (correlation, ν, a)"""


def residual_correlation(data: Path, windows: int = 64) -> Iterator[tuple[float, float]]:
    """(distance in m, correlation) of the operator's standardised residual along rows and columns, residuals cut at 4."""
    network = PropagationOperator()
    load_network(network, "operator")
    task = OperatorTask(altitude_odds=(1.0, 0.0, 0.0))
    batch = task.batch(load_links(data, "T2"), windows, np.random.default_rng(3), augment=False)
    with torch.inference_mode():
        parts = [network(part) for part in batch["inputs"].split(8)]
    mean, log_variance = (torch.cat(p).numpy() for p in zip(*parts, strict=True))
    mask = batch["mask"].numpy()
    z = np.clip((batch["truth"].numpy() - mean) * np.exp(-0.5 * log_variance), -4, 4) * mask
    variance = (z[mask] ** 2).mean()
    for d in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64):
        rows = (z[:, d:] * z[:, :-d]).sum() / (mask[:, d:] & mask[:, :-d]).sum()
        cols = (z[:, :, d:] * z[:, :, :-d]).sum() / (mask[:, :, d:] & mask[:, :, :-d]).sum()
        yield 4.0 * d, float((rows + cols) / 2 / variance)


def surveys(data: Path, count: int) -> Iterator[tuple]:
    """Per survey and step: cells, z and s of every position ``[n, k]``, prior and distance from the truth ``[k]``, index of step."""
    model, dataset = PathModel.load(find_weights("path-model")), ChannelDataset.open(data)
    for split in ("T2", "T3"):
        for case in survey_cases(dataset, split, max_surveys=count, seed=5):
            scenario = case.scenario()
            paths = RandomWaypointPlanner().paths(Swarm.deployed(scenario, case.start_cells, STEPS[-1]), STEPS[-1], case.rng(0))
            squares = coarse_squares(scenario, 102.0, 8.0, 4000)
            position = np.array([(*square.position, 1.5) for square in squares])
            prior = np.array([square.prior for square in squares])
            x, y, _ = scenario.transmitter_m
            away = np.hypot(*(4.0 * position[:, :2] - (y, x)).T)
            for i, step in enumerate(STEPS):
                cells = np.unique(paths[:, : step + 1].reshape(-1, 2), axis=0)
                mean, std = model.gain(scenario.city.height_m, 4.0, position, cells, case.altitude_m)
                yield cells, (case.truth_db[cells[:, 0], cells[:, 1]][:, None] - mean) / std, std, prior, away, i


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--surveys", default=40, type=int, help="per split")
    options = parser.parse_args()
    for distance, value in residual_correlation(options.data):
        print(f"{distance:5.0f} m  {value:.3f}")
    powers = {f"{k}/√n": (lambda n, k=k: k / np.sqrt(n)) for k in (0.5, 0.85, 1.4, 2.0)} | {
        f"{t}": (lambda n, t=t: t) for t in (0.05, 0.1, 0.2)
    }
    found: dict[tuple[str, str], list[tuple[int, float, float]]] = {}
    for cells, z, std, prior, away, i in surveys(options.data, options.surveys):
        for name, (correlation, degrees, soften) in LIKELIHOODS.items():
            factor, _ = Factor.empty(correlation, 4.0).grown(cells, np.zeros(len(cells)))
            likelihood = Evidence.solved(z, std, factor, soften).log_likelihood(degrees)
            for label, power in powers.items():
                weight = posterior_weights(prior, likelihood, power(len(cells)))
                found.setdefault((name, label), []).append((i, np.log(weight[away < 25].sum() + 1e-4), weight @ away))
    print(
        "\n| likelihood | power | log probability near the truth, T = 50, 100, 200 | mean | distance, m |\n|---|---|---|---|---|"
    )
    for (name, label), rows in found.items():
        step, log_mass, distance = np.array(rows).T
        parts = [log_mass[step == i].mean() for i in range(3)], [distance[step == i].mean() for i in range(3)]
        print(f"| {name} | {label} | {parts[0][0]:.2f}, {parts[0][1]:.2f}, {parts[0][2]:.2f} | {log_mass.mean():.3f} | "
              f"{parts[1][0]:.0f}, {parts[1][1]:.0f}, {parts[1][2]:.0f} |")  # fmt: skip


if __name__ == "__main__":
    main()
