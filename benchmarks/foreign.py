"""Worlds and measurements that no network was trained on."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.foreign_worlds import MAPS, WORLDS, ForeignWorld, drawn
from benchmarks.measured import Series, open_series
from benchmarks.measured import drawn as split_cells
from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.evaluation.metrics import gof
from skygain.evaluation.rollout import flown
from skygain.flight.starts import start_cells
from skygain.instruments import replay_truth
from skygain.instruments.simulated import PerfectInstrument
from skygain.survey.methods import MethodSpec, predictor

RIVALS = ("kriging-blind", "idw", "sklearn-gp")
"""methods that know no map and no transmitter: the yardstick"""
STEPS = (50, 100, 200)
KEYS = ("rmse_db", "error_ratio", "coverage90")


@lru_cache(maxsize=2)
def _world(name: str, data: Path, split: str, number: int) -> ForeignWorld:
    return drawn(name, data, split, number)


def surveyed(
    world: ForeignWorld, method: MethodSpec, number: int, steps: tuple[int, ...]
) -> list[list[float]]:
    """``[score][step]`` of one survey with three UAVs that start together.

    ``adaptive`` flies as ``adaptive:level=gain`` where readings are gains in dB.
    """
    if method.predictor == "adaptive" and world.level == "gain":
        method = replace(method, predictor="adaptive:level=gain")
    rng = np.random.default_rng([number, 7])
    found = flown(
        world.scenario,
        method,
        PerfectInstrument(world.truth_db),
        world.truth_db,
        start_cells("cluster", world.scenario, 3, rng),
        steps=max(steps),
        record_steps=steps,
        rng=rng,
    )
    return [found["scores"][key] for key in KEYS]


@study(
    "foreign",
    data="DATA",
    predictors=Option(("kriging", *RIVALS, "operator", "adaptive"), "predictors"),
    planners=Option(("random-waypoint", "sequential-greedy"), "planners"),
    worlds=Option(tuple(name.replace(", ", " / ") for name in WORLDS), "kinds of worlds"),
    surveys=Option(2, "surveys of each kind"),
    split=Option("T2", "split of the data set"),
    steps=Option(STEPS, "steps at which scores are taken"),
)
def foreign(run: Run) -> list[Table]:
    """Predictors in worlds of another kind than those that networks were trained on.

    DATA is a data set of version 1, of which a split gives the worlds at home, those with wrong
    maps, sector antennas and random fields. The scenes of Sionna RT give the others. Traced worlds
    are kept in the user's cache.
    """
    o = run.options
    tables = []
    for planner in o.planners:
        rows = []
        for written in o.worlds:
            name = written.replace(" / ", ", ")
            scores = {}
            for number in range(o.surveys):
                for one in o.predictors:
                    found = run.once(
                        (name, number, one, planner, o.split, *o.steps),
                        lambda n=name, k=number, p=one, by=planner: surveyed(
                            _world(n, run.data, o.split, k), MethodSpec(p, by), k, o.steps
                        ),
                    )
                    scores.setdefault(one, []).append(found)
            mean = {one: np.mean(values, axis=0) for one, values in scores.items()}
            rows += _rows(name, MAPS.get(name, "right"), mean)
        title = (
            f"{planner}, surveys of each kind: {o.surveys}; 96 × 96 cells of 4 m at 10 m, 3 UAVs, "
            "cluster start. RMSE in dB over unvisited outdoor cells, mean over surveys; in "
            "brackets against the best of "
            f"{', '.join(one for one in RIVALS if one in o.predictors)}. GoF and cover of the 90 % "
            f"interval at T = {o.steps[-1]}."
        )
        head = ["world", "map", "predictor", *(f"T = {t}" for t in o.steps), "GoF", "90 % cover"]
        tables.append(Table(title, head, rows, part=planner))
    return tables


@lru_cache(maxsize=1)
def _series(path: Path) -> list[Series]:
    return open_series(path)


def campaign_trial(series: Series, test: str, seed: int, name: str) -> list[list[float]]:
    """``[score][step]`` of readings left out, after each number of `STEPS` cells was given, ten at
    a time. Nobody is told where the base station stands."""
    gridded, scenario = series.gridded, series.scenario.without_transmitter()
    order, held_back = split_cells(gridded, test, seed)
    readings, truth = gridded.measurements(), replay_truth(gridded)
    belief, found = predictor(name).begin(scenario), []
    for first in range(0, max(STEPS), 10):
        belief = belief.updated(readings.taken(order[first : first + 10]))
        if first + 10 not in STEPS:
            continue
        asked = held_back if test == "square" else order[first + 10 :]
        cells = tuple(gridded.cell[asked].T)
        posterior = belief.posterior()
        error = posterior.mean_db[cells] - truth[cells]
        variance = posterior.variance_db2[cells] + gridded.noise_std_db[asked] ** 2
        inside = np.abs(error) <= 1.6448536 * np.sqrt(variance)
        found.append([np.sqrt(np.mean(error**2)), np.mean(error**2 / variance), np.mean(inside)])
    return np.transpose(found).tolist()


@study(
    "foreign_campaign",
    data="DUKE_CSV",
    predictors=Option((*RIVALS, "operator", "adaptive"), "predictors"),
    series=Option(("A/Samsung", "B/Pixel", "C/Samsung"), "cells and phones"),
    seeds=Option(2, "draws of the cells"),
)
def foreign_campaign(run: Run) -> list[Table]:
    """A measured campaign without a city map: RSRP of three cells on a campus.

    Some of the recorded cells are given, the others asked for; or a 100 m square is left out.
    """
    o = run.options
    rows = []
    for test, told in (("random", "random cells"), ("square", "square left out")):
        for wanted in o.series:
            scores = {
                one: np.mean(
                    [
                        run.once(
                            (wanted, test, seed, one),
                            lambda w=wanted, t=test, k=seed, p=one: campaign_trial(
                                next(s for s in _series(run.data) if s.name == w), t, k, p
                            ),
                        )
                        for seed in range(o.seeds)
                    ],
                    axis=0,
                )
                for one in o.predictors
            }
            rows += _rows(f"{wanted}, {told}", "none", scores)
    title = (
        f"RSRP in dBm without a city map, {o.seeds} draws. RMSE in dB over the recorded cells not "
        f"given, in brackets against the best of {', '.join(RIVALS)}. GoF and cover of the 90 % "
        f"interval with {STEPS[-1]} cells given."
    )
    head = ["cell and test", "map", "predictor", *(f"{t} cells" for t in STEPS), "GoF"]
    return [Table(title, [*head, "90 % cover"], rows)]


def _rows(world: str, kind: str, scores: dict[str, np.ndarray]) -> list[list[str]]:
    """One row for each predictor, from ``scores[predictor][score, step]``."""
    best = np.min([scores[one][0] for one in RIVALS if one in scores], axis=0)
    return [
        [
            world,
            kind,
            one,
            *(f"{v:.2f} ({v / b:.2f}×)" for v, b in zip(rmse, best, strict=True)),
            f"{gof(float(ratio[-1])):+.2f}",
            f"{100 * cover[-1]:.0f} %",
        ]
        for one, (rmse, ratio, cover) in scores.items()
    ]
