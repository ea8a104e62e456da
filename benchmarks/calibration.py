"""How far to trust a predictor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.evaluation.metrics import VARIANCE_FLOOR_DB2, gof
from skygain.evaluation.rollout import rollout
from skygain.flight.swarm import Swarm
from skygain.posterior import Posterior
from skygain.predictors import Belief
from skygain.predictors.networks.operator import OperatorBelief
from skygain.survey.methods import MethodSpec

FACTORS = (0.7, 0.8, 0.85, 0.9, 1.0, 1.1, 1.2)
LIMITS = (ndtri(0.75) ** 2, ndtri(0.95) ** 2)
"""squared errors in units of the variance that end the 50 % and the 90 % interval"""


def posteriors(belief: Belief, powers: Sequence[float]) -> Iterator[tuple[float, Posterior]]:
    """The posterior with each power of the judge and the variance as it is; other predictors have
    one."""
    judged = isinstance(belief, OperatorBelief) and belief.search is not None
    if not judged or belief.maps.network.judge is None:
        yield 1.0, belief.posterior()
        return
    for power in powers:
        settings = replace(belief.settings, sharpen=power, variance_factor=1.0)
        yield power, replace(belief, settings=settings).judged().posterior()


def fits(case: Case, method: MethodSpec, steps: Sequence[int], powers: Sequence[float]) -> Any:
    """``[step, power, RMSE, mean ratio, [share inside 50 %, inside 90 %] per factor]`` of one
    survey."""
    outdoor = case.scenario().outdoor & np.isfinite(case.truth_db)
    found: list[list[Any]] = []

    def observe(step: int, swarm: Swarm, belief: Belief) -> None:
        unseen = outdoor & ~swarm.visited
        truth_db = case.truth_db[unseen].astype(float)
        for power, posterior in posteriors(belief, powers):
            square = (posterior.mean_db[unseen] - truth_db) ** 2
            ratio = square / np.maximum(posterior.variance_db2[unseen], VARIANCE_FLOOR_DB2)
            inside = [[(ratio / f <= limit).mean() for limit in LIMITS] for f in FACTORS]
            found.append([step, power, np.sqrt(square.mean()), ratio.mean(), inside])

    rollout(case, method, steps=max(steps), record_steps=steps, observe=observe)
    return found


@study(
    "calibration",
    data="DATA",
    predictor=Option("operator", "predictor"),
    split=Option("T2", "split of the data set"),
    planners=Option(("random-waypoint", "sequential-greedy"), "planners"),
    powers=Option((1.0, 1.25, 1.5), "powers of the operator's judge"),
    surveys=Option(100, "surveys"),
    steps=Option((50, 100, 200), "steps at which the belief is judged"),
    altitude=Option(10.0, "metres"),
)
def calibration(run: Run) -> list[Table]:
    """Error, cover and goodness of fit for factors of a predictor's variance and powers of its
    judge.

    Three UAVs, cluster start. Every power and factor is evaluated on the same beliefs, over
    unvisited outdoor cells. Choose on T2: the operator's judge learned from T3.
    """
    o = run.options
    cases = survey_cases(
        ChannelDataset.open(run.data), o.split, altitude_m=o.altitude, max_surveys=o.surveys
    )
    head = ["planner, T", "power", "RMSE dB", *(f"{f:g}" for f in FACTORS)]
    rows = []
    for planner in o.planners:
        method = MethodSpec(o.predictor, planner)
        found: dict[tuple[int, float], list[Any]] = {}
        for case in cases:
            key = (method.label, o.split, case.link, o.altitude, *o.steps, *o.powers)
            for step, power, *fit in run.once(
                key, lambda c=case, m=method: fits(c, m, o.steps, o.powers)
            ):
                found.setdefault((step, power), []).append(fit)
        for (step, power), surveys in sorted(found.items()):
            ratio = np.mean([fit[1] for fit in surveys])
            inside = 100 * np.mean([fit[2] for fit in surveys], axis=0)
            cells = [
                f"{gof(ratio / factor):+.2f} / {half:.0f} / {most:.1f}"
                for factor, (half, most) in zip(FACTORS, inside, strict=True)
            ]
            rmse = np.mean([fit[0] for fit in surveys])
            rows.append([f"{planner}, {step}", f"{power:g}", f"{rmse:.2f}", *cells])
    title = (
        f"Predictor {o.predictor}, {len(cases)} surveys of {o.split}, three UAVs, cluster start, "
        f"{o.altitude:g} m; unvisited outdoor cells, mean over surveys. Goodness of fit / cover of "
        "the 50 % / of the 90 % interval, by factor of the variance."
    )
    return [Table(title, head, rows)]
