"""Predictors that are not told where the transmitter is, against those that are."""

from __future__ import annotations

import numpy as np

from benchmarks.record import Table
from benchmarks.study import JOURNALS, Option, Run, signed, study
from skygain.datasets.cases import survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.evaluation.comparison import Comparison, compare
from skygain.evaluation.metrics import gof
from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.rollout import rollout
from skygain.evaluation.statistics import bootstrap_mean, city_weights
from skygain.survey.methods import MethodSpec

STEPS = (50, 100, 200)


@study(
    "predictors",
    data="DATA",
    predictors=Option(("kriging", "operator", "operator+tx"), "predictors, the first is the base"),
    split=Option("T2", "split of the data set"),
    surveys=Option(25, "surveys"),
    uavs=Option(3, "UAVs"),
    steps=Option(STEPS, "steps at which scores are taken"),
    altitude=Option(10.0, "metres"),
)
def predictors(run: Run) -> list[Table]:
    """Predictors flown through the same surveys by random waypoints from a cluster start.

    A predictor may name a weight file: operator:weights=/path/checkpoint.safetensors.
    """
    o = run.options
    cases = survey_cases(
        ChannelDataset.open(run.data),
        o.split,
        n_uavs=o.uavs,
        altitude_m=o.altitude,
        max_surveys=o.surveys,
    )
    flown = {
        name: [
            run.once(
                (name, o.split, case.link, o.uavs, o.altitude, *o.steps),
                lambda case=case, name=name: rollout(
                    case,
                    MethodSpec(name, "random-waypoint"),
                    steps=max(o.steps),
                    record_steps=o.steps,
                ),
            )
            for case in cases
        ]
        for name in o.predictors
    }
    base = [row["scores"]["rmse_db"] for row in flown[o.predictors[0]]]
    cities = [case.city_index for case in cases]
    rows = []
    for name, surveys in flown.items():
        update = " / ".join(
            f"{np.median([row['delays'][f'update_ms_{q}'] for row in surveys]):.1f}"
            for q in ("median", "p95")
        )
        for k, step in enumerate(o.steps):

            def mean(score: str, surveys: list = surveys, k: int = k) -> float:
                values = [row["scores"][score][k] for row in surveys]
                return float(np.nanmean(np.array(values, dtype=float)))

            gap = [row["scores"]["rmse_db"][k] - b[k] for row, b in zip(surveys, base, strict=True)]
            rmse = [f"{mean(key):.2f}" for key in ("rmse_db", "rmse_ray_traced_db", "rmse_rest_db")]
            rows.append(
                [
                    name,
                    f"{step}",
                    *rmse,
                    signed(bootstrap_mean(gap, cities)),
                    f"{gof(mean('error_ratio')):+.2f}",
                    f"{100 * mean('coverage90'):.1f} %",
                    update,
                ]
            )
    title = (
        f"{len(cases)} surveys of {o.split}, {o.uavs} UAVs, cluster start, random waypoints, "
        f"{o.altitude:g} m. RMSE in dB over unvisited outdoor cells; brackets: 95 % bootstrap "
        "interval over cities. An update takes in the readings of one step: milliseconds, median / "
        "95 % of a survey, median over surveys."
    )
    head = ["predictor", "T", "RMSE dB", "ray-traced", "rest", f"against {o.predictors[0]}"]
    return [Table(title, [*head, "GoF", "90 % cover", "update ms"], rows)]


KNOWN, INFERRED, BLIND = "kriging", "kriging-inferred", "kriging-blind"


def recovered(comparison: Comparison, planner: str, step: int) -> list[str]:
    """A row: mean RMSE of the three, and the share recovered."""
    k = comparison.steps.index(step)
    known, inferred, blind = (
        comparison.scores[f"{p} / {planner}"]["rmse_db"][:, k] for p in (KNOWN, INFERRED, BLIND)
    )
    weights = city_weights(comparison.cities)
    shares = (weights @ (blind - inferred)) / (weights @ (blind - known))
    low, high = np.quantile(shares, [0.025, 0.975])
    share = (blind - inferred).mean() / (blind - known).mean()
    means = [f"{values.mean():.2f}" for values in (known, inferred, blind)]
    gain = str(bootstrap_mean(blind - known, comparison.cities))
    return [planner, f"{step}", *means, gain, f"{share:.0%} [{low:.0%}, {high:.0%}]"]


@study(
    "transmitter_inference",
    data="DATA",
    split=Option("T2", "split of the data set"),
    surveys=Option(50, "surveys"),
    planners=Option(("random-waypoint", "sequential-greedy"), "planners"),
    steps=Option(200, "steps of a survey"),
    workers=Option(2, "processes"),
)
def transmitter_inference(run: Run) -> list[Table]:
    """How much of the gain from knowing the transmitter Kriging keeps when it has to find it.

    The share recovered is (RMSE_blind − RMSE_inferred) / (RMSE_blind − RMSE_known), of mean RMSEs
    over surveys.
    """
    o = run.options
    comparison = compare(
        EvaluateRequest(
            predictors=(KNOWN, INFERRED, BLIND),
            planners=o.planners,
            data=str(run.data),
            split=o.split,
            steps=o.steps,
            max_surveys=o.surveys,
            record_every=max(1, o.steps // 4),
            workers=o.workers,
            out=JOURNALS / "transmitter_inference",
        )
    )
    steps = [s for s in comparison.steps if s != 3 * (o.steps // 4)]
    title = (
        f"{len(comparison.cities)} surveys in {len(np.unique(comparison.cities))} cities of "
        f"{o.split}, three UAVs, cluster start, exact readings. RMSE in dB over unvisited outdoor "
        "cells; brackets: 95 % bootstrap interval over cities."
    )
    head = ["planner", "T", "transmitter known", "inferred", "blind"]
    head += ["gain from knowing it, dB", "share recovered"]
    rows = [recovered(comparison, planner, step) for planner in o.planners for step in steps]
    return [Table(title, head, rows)]
