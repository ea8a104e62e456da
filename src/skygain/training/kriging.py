"""Training of the Kriging parameters: the trend, the covariance of the shadowing, and how both vary
among transmitters.

For each trend and each altitude, over all links of a split:

1. θ₀ by least squares over all outdoor cells of a random crop of every link (for the log-distance
   trend: the paper's α and β);
2. φ, δ, ν by maximum likelihood and the spread Σ of θ among links by expectation maximisation, in
   turns, on the cells of random flights and some scattered ones, about as a survey would see them
   (the paper: "negative log-likelihood minimization");
3. each link's own φ, δ, ν; the standard deviation of their logarithms over the links is the prior
   of the per-survey fit.
"""

from __future__ import annotations

__all__ = ["KrigingConfig", "train_kriging"]

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from skygain.datasets.crops import random_crop
from skygain.datasets.link import Link
from skygain.datasets.origin import origin
from skygain.datasets.store import ChannelDataset
from skygain.ground.errors import InputError
from skygain.ground.files import atomic_write
from skygain.ground.strict_json import plain
from skygain.predictors.kriging.parameters import TRENDS, KrigingParameters, trend_columns
from skygain.predictors.kriging.survey_fit import likelihood_loss, map_estimate
from skygain.training.run import Report, Run
from skygain.training.trajectories import random_waypoints, scattered_cells

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KrigingConfig:
    """One fit."""

    split: str = "T1"
    """split whose links are used"""
    crop: int = 96
    """side of the random crops in cells"""
    flight_cells: int = 120
    """cells of each link taken from random flights of three UAVs"""
    scattered_cells: int = 60
    """cells of each link scattered over the crop"""
    rounds: int = 4
    """turns of the likelihood fit and the expectation maximisation"""
    seed: int = 0
    """of crops, flights and scattered cells"""


@dataclass(frozen=True, eq=False)
class _Sample:
    """What the likelihood sees of one link."""

    gain_db: Array
    columns: Array
    distance_m: Array


def _cells(link: Link, config: KrigingConfig, rng: np.random.Generator) -> NDArray[np.int64]:
    """Raveled cells of random flights and scattered ones, distinct."""
    lengths = np.full(3, config.flight_cells // 3 + rng.integers(1, config.flight_cells))
    flown = random_waypoints(link.outdoor, lengths, rng).transpose(1, 0, 2).reshape(-1, 2)
    flat = link.city.grid.flat(flown)
    distinct = flat[np.sort(np.unique(flat, return_index=True)[1])][: config.flight_cells]
    return np.union1d(
        distinct, link.city.grid.flat(scattered_cells(link.outdoor, config.scattered_cells, rng))
    )


def _least_squares(columns: list[Array], gains: list[Array]) -> Array:
    """θ₀ over all cells of all links."""
    normal = np.sum([h.T @ h for h in columns], axis=0)
    right = np.sum([h.T @ y for h, y in zip(columns, gains, strict=True)], axis=0)
    return np.linalg.solve(normal, right)


def _trend_spread(
    samples: list[_Sample], theta: Array, logs: Array, sigma: Array, turns: int = 30
) -> Array:
    """Σ, the covariance of θ among links around ``theta``, by expectation maximisation with the
    field's covariance given."""
    phi, delta, nu = np.exp(logs)
    information, score = [], []
    for s in samples:
        covariance = phi * np.exp(-s.distance_m / delta) + nu * np.eye(len(s.gain_db))
        solved = np.linalg.solve(covariance, s.columns)
        information.append(s.columns.T @ solved)
        score.append(solved.T @ (s.gain_db - s.columns @ theta))
    M, b = np.stack(information), np.stack(score)
    for _ in range(turns):
        posterior = np.linalg.solve(np.eye(len(theta)) + sigma @ M, np.broadcast_to(sigma, M.shape))
        mean = np.einsum("lij,lj->li", posterior, b)
        sigma = (posterior + mean[:, :, None] * mean[:, None, :]).mean(axis=0)
        sigma = (sigma + sigma.T) / 2
    return sigma


def _covariance(
    samples: list[_Sample], theta: Array, logs: Array, sigma: Array
) -> tuple[Array, float]:
    """log φ, log δ, log ν of highest likelihood over all links for given θ₀ and Σ, and the loss per
    observation."""
    size = sum(len(s.gain_db) for s in samples)
    noise = [np.zeros(len(s.gain_db)) for s in samples]

    def loss(x: Array) -> tuple[float, Array]:
        value, gradient = 0.0, np.zeros(3)
        for s, none in zip(samples, noise, strict=True):
            part, slope = likelihood_loss(
                x,
                s.distance_m,
                s.gain_db - s.columns @ theta,
                none,
                s.columns @ sigma @ s.columns.T,
            )
            value, gradient = value + part, gradient + slope
        return value / size, gradient / size

    bounds = [
        (np.log(10.0), np.log(3000.0)),
        (np.log(5.0), np.log(1000.0)),
        (np.log(0.05), np.log(100.0)),
    ]
    found = minimize(
        loss, logs, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 25}
    )
    return found.x, float(found.fun)


def _trained(
    samples: list[_Sample], theta: Array, rounds: int, report: Callable[..., None]
) -> dict[str, Any]:
    """Parameters of one trend at one altitude."""
    logs = np.log([400.0, 60.0, 3.0])
    sigma = np.diag(np.full(len(theta), 100.0))
    loss = np.nan
    for turn in range(rounds):
        logs, loss = _covariance(samples, theta, logs, sigma)
        sigma = _trend_spread(samples, theta, logs, sigma)
        sill, range_, nugget = np.exp(logs)
        report(
            round=turn + 1,
            sill_db2=round(sill, 1),
            range_m=round(range_, 1),
            nugget_db2=round(nugget, 2),
            loss=round(loss, 4),
        )
    rows = tuple(tuple(row) for row in sigma.tolist())
    phi, delta, nu = np.exp(logs).tolist()
    common = KrigingParameters(tuple(theta.tolist()), rows, phi, delta, nu, (4.0, 4.0, 4.0))
    own = []
    for s in samples:
        _, fit = map_estimate(common, s.distance_m, s.gain_db, np.zeros(len(s.gain_db)), s.columns)
        own.append(np.log([fit.sill_db2, fit.range_m, fit.nugget_db2]))
    spread = np.std(own, axis=0)
    return {
        "trend": _rounded(theta),
        "trend_covariance": _rounded(sigma),
        "sill_db2": _rounded(phi),
        "range_m": _rounded(delta),
        "nugget_db2": _rounded(nu),
        "log_spread": _rounded(spread),
        "loss_per_cell": _rounded(loss),
        "links": len(samples),
    }


def _rounded(values: Any) -> Any:
    """Five significant digits, as nested lists."""
    return np.vectorize(lambda v: float(f"{v:.5g}"))(np.asarray(values)).tolist()


def train_kriging(
    dataset_path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    config: KrigingConfig = KrigingConfig(),
    report: Report = lambda record: None,
) -> dict[str, Any]:
    """Train on a data set and write the parameters to ``out`` as JSON, in the form of the ones that
    ship with Skygain.

    What is done stands in the folder ``out`` + ``.run``, so that a fit that was stopped goes on.

    Raises:
        InputError: the file is no data set or lacks the split.
    """
    dataset = ChannelDataset.open(dataset_path)
    data = Path(dataset_path).name
    of = {"data": data, "origin": origin(dataset.attributes), **plain(config)}
    run = Run(f"{out}.run", config, {}, report, of=of, trends={trend: {} for trend in TRENDS})
    if run.state["of"] != of:
        raise InputError(
            f"{run.folder} holds a fit to other data or with other settings; remove it, or choose "
            "another file as `out`"
        )
    table = run.state["trends"]
    for altitude in dataset.altitudes_m:
        at = f"{altitude:g}"
        missing = [trend for trend in TRENDS if at not in table[trend]]
        links = _links(dataset, altitude, config) if missing else []
        for trend in missing if links else []:
            samples, theta = _samples(links, trend, altitude)
            table[trend][at] = _trained(
                samples, theta, config.rounds, partial(run.record, trend=trend, altitude_m=altitude)
            )
            run.step += 1
            run.save()
    result = {
        "trained_on": {
            "data": data,
            "split": config.split,
            "frequency_hz": dataset.frequency_hz,
        },
        "config": asdict(config),
        "trends": table,
    }
    with atomic_write(out) as file:
        file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _links(
    dataset: ChannelDataset, altitude: float, config: KrigingConfig
) -> list[tuple[Link, NDArray[np.int64]]]:
    """A random crop of every link, and the raveled cells that the likelihood sees."""
    links = []
    for index in dataset.links(config.split, altitude):
        rng = np.random.default_rng([config.seed, index])
        side = min(config.crop, *dataset.grid.shape)
        link = random_crop(dataset.link(index, altitude), rng, (side, side), augment=True)
        links.append((link, _cells(link, config, rng)))
    return links


def _samples(
    links: list[tuple[Link, NDArray[np.int64]]], trend: str, altitude: float
) -> tuple[list[_Sample], Array]:
    """What the likelihood sees of every link, and θ₀."""
    samples, columns, gains = [], [], []
    for link, cells in links:
        grid = link.city.grid
        h = trend_columns(trend, grid, altitude, link.transmitter_m)
        y = link.truth_db.ravel().astype(float)
        outdoor = link.outdoor.ravel()
        columns.append(h[outdoor])
        gains.append(y[outdoor])
        xy = grid.xy_m(grid.cells[cells])
        distance_m = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
        samples.append(_Sample(y[cells], h[cells], distance_m))
    return samples, _least_squares(columns, gains)
