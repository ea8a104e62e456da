"""The paper's claims: verdicts follow the intervals, pairs are of the same link, and every claim
speaks of methods that are flown."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from skygain.evaluation.comparison import Comparison
from skygain.evaluation.metrics import GAIN_EDGES_DB, by_gain, score
from skygain.evaluation.paper.claims import Flown, claims_of
from skygain.evaluation.paper.gain import gain_curves
from skygain.evaluation.paper.request import NAMES, ReproduceRequest
from skygain.evaluation.paper.settings import FIGURES, SETTINGS, installed
from skygain.evaluation.request import EvaluateRequest
from skygain.ground.errors import InputError
from skygain.posterior import Posterior

LEVEL = {
    "learned": 8.0,
    "ours": 7.0,
    "greedy": 10.0,
    "random": 14.0,
    "entropy kriging": 11.0,
    "greedy kriging": 12.0,
    "random kriging": 13.0,
    "network": 9.0,
    "kriging": 12.0,
    "map-blind": 16.0,
}
"""an error for each role, in the paper's order"""
EASIER = {"spread": 0.8, "five": 0.8, "altitude-20": 0.9, "altitude-30": 0.8}


def flown_figure(figure: str, n: int = 8, cities: int = 8) -> Flown:
    """A figure as if the paper were right: errors by role, times what makes the setting easier."""
    comparisons, roles = {}, {}
    for name, methods in FIGURES[figure].methods.items():
        roles[name] = {role: labels[0] for role, labels in methods.items()}
        comparisons[name] = comparison(roles[name], EASIER.get(name, 1.0), n, cities)
    return Flown(comparisons, roles, dict(SETTINGS))


def comparison(roles: dict[str, str], times: float, n: int, cities: int) -> Comparison:
    rng = np.random.default_rng(0)
    steps = [2, 4, 8]
    noise = rng.normal(scale=0.1, size=(n, len(steps)))
    request = EvaluateRequest(methods=tuple(roles.values()), steps=8, record_every=2)
    scores, delays, gains = {}, {}, {}
    middle = (np.arange(len(GAIN_EDGES_DB) + 1) - 0.5) * 10 + GAIN_EDGES_DB[0]
    for role, label in roles.items():
        rmse = times * LEVEL[role] + noise
        names = ("rmse_db", "rmse_all_db", "nll", "crps_db", "coverage50", "coverage90", "gof")
        scores[label] = dict.fromkeys(names, rmse) | {"error_ratio": np.exp(0.1 + noise)}
        slow = {"learned": 1.0, "greedy": 5.0, "greedy kriging": 5.0}.get(role, 50.0)
        parts = (f"{p}_ms_{q}" for p in ("decision", "planned_step", "update")
                 for q in ("median", "p95"))  # fmt: skip
        delays[label] = {part: slow * np.exp(noise[:, 0]) for part in parts}
        cells = np.full((n, len(middle)), 100.0)
        error = 10.0 - (middle + 140) / 20  # falls by half a dB per 10 dB
        gains[label] = {
            "cells": cells,
            "square_db2": cells * error**2,
            "ratio": cells * np.exp((middle + 250) / 1000),
        }
    return Comparison(
        request, steps, np.arange(n) % cities, (9, 9), np.arange(n), scores, delays, gains
    )


@pytest.mark.parametrize("figure", NAMES)
def test_claims_hold_where_the_paper_is_right(figure: str) -> None:
    """And each speaks of methods that the figure flies."""
    claims = claims_of(figure, flown_figure(figure))
    verdicts = {claim.measured: claim.verdict for claim in claims}
    assert set(verdicts.values()) == {"holds"}, verdicts


@pytest.mark.parametrize("figure", NAMES)
def test_few_cities_decide_nothing(figure: str) -> None:
    found = {claim.verdict for claim in claims_of(figure, flown_figure(figure, cities=4))}
    assert found == {"undecided"}
    single = {claim.found for claim in claims_of(figure, flown_figure(figure, cities=1))}
    assert all("[–]" in text for text in single)


def test_what_contradicts_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVEL, "learned", 13.5)
    claims = {claim.text: claim for claim in claims_of("cluster3", flown_figure("cluster3"))}
    assert claims["The learned policy is better than greedy"].verdict == "does not hold"
    best = claims["The network with the learned policy is the best of the paper's methods"]
    assert best.verdict == "does not hold"
    assert "greedy" in best.measured, "the rival that contradicts most is named"
    entropy = claims["Entropy planning is better than greedy"]
    assert entropy.verdict == "holds"


def test_what_was_not_flown_is_said() -> None:
    flown = flown_figure("altitudes")
    del flown.roles["three"]["map-blind"]
    verdicts = [claim.verdict for claim in claims_of("altitudes", flown)]
    assert verdicts.count("not flown") == 1


def test_settings_are_paired_by_link() -> None:
    flown = flown_figure("spread3")
    spread = flown.comparisons["spread"]
    order = np.array([3, 0, 2, 1, 7])

    def picked(scores: dict) -> dict:
        return {label: {k: v[order] for k, v in named.items()} for label, named in scores.items()}

    fewer = Comparison(
        spread.request,
        spread.steps,
        spread.cities[order],
        spread.window,
        spread.links[order],
        picked(spread.scores),
        picked(spread.delays),
        picked(spread.by_gain),
    )
    some = Flown({**flown.comparisons, "spread": fewer}, flown.roles, flown.settings)

    def error(setting: str) -> Callable:
        return lambda s: some.values(s, "learned")

    values, cities = some.across("spread", "three", error("spread"))
    assert cities.tolist() == sorted(order.tolist())
    assert values == pytest.approx(-0.2 * LEVEL["learned"]), "the noise of a link cancels"


def test_sums_by_gain_are_those_of_the_scores(rng: np.random.Generator) -> None:
    truth = rng.uniform(-300, -20, size=(30, 30))
    truth[0, :3] = np.nan
    belief = Posterior(truth + rng.normal(size=truth.shape), rng.uniform(0.5, 2, truth.shape))
    belief = Posterior(np.nan_to_num(belief.mean_db), belief.variance_db2)
    cells = rng.random(truth.shape) < 0.5
    sums, whole = by_gain(belief, truth, cells), score(belief, truth, cells, ~cells)
    n = sum(sums["cells"])
    assert n == (cells & np.isfinite(truth)).sum()
    assert np.sqrt(sum(sums["square_db2"]) / n) == pytest.approx(whole["rmse_db"])
    assert sum(sums["ratio"]) / n == pytest.approx(whole["error_ratio"])


def test_a_straight_line_has_its_slope() -> None:
    made = comparison({"network": "kriging / lawnmower"}, 1.0, 6, 6)
    curves = gain_curves(made.by_gain["kriging / lawnmower"], made.cities)
    slope = curves.slope(curves.rmse_db)
    assert slope.mean == pytest.approx(-0.5)
    assert slope.low <= slope.mean <= slope.high
    assert curves.share.sum() == pytest.approx(1.0)


def test_a_method_without_weights_gives_way_and_says_why() -> None:
    label, why = installed(["paper-unet:weights=no-such / dqn", "kriging / lawnmower"])
    assert label == "kriging / lawnmower"
    assert "no weights 'no-such'" in why
    assert installed(["paper-unet:weights=no-such / dqn"])[0] is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"figure": "clutser3"}, "no `figure` 'clutser3'; did you mean 'cluster3'"),
        ({"max_surveys": 0}, "`max_surveys` must be 1 or more"),
        ({"crop": -1}, "`crop` must be 0 or more"),
    ],
)
def test_requests_that_cannot_be_flown(values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ReproduceRequest(**values)
