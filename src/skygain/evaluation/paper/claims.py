"""The paper's claims, each held against the rollouts.

A claim says that a number is above or below something. It holds if the number's 95 % interval over
cities lies on that side, does not hold if it lies on the other, and is undecided in between, and
always where there are fewer than `LEAST_CITIES`.
"""

from __future__ import annotations

__all__ = ["LEAST_CITIES", "VERDICTS", "Claim", "Flown", "claims_of"]

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.comparison import Comparison
from skygain.evaluation.paper.gain import gain_curves
from skygain.evaluation.paper.settings import Setting
from skygain.evaluation.statistics import Interval, bootstrap_mean

HOLDS, FAILS, OPEN, NOT_FLOWN = "holds", "does not hold", "undecided", "not flown"
VERDICTS = (HOLDS, FAILS, OPEN, NOT_FLOWN)
"""what a claim may turn out to be"""
LEAST_CITIES = 5
"""resampling fewer cities gives intervals that are too narrow to decide anything"""
_NEAR_GOF = 0.5
_SAME_DELAY = 1.25
"""delays whose ratio is within this are the same"""

Differences = tuple[NDArray[np.float64], NDArray[np.int64]]
"""(``[case]`` values, ``[case]`` cities)"""


@dataclass(frozen=True)
class Claim:
    """What the paper says, and what was found."""

    text: str
    """the paper's claim in one sentence"""
    measured: str
    """what stands for it here, in words"""
    interval: Interval | None
    """what was found"""
    style: str
    """how it is printed"""
    verdict: str
    """one of `VERDICTS`"""

    @property
    def found(self) -> str:
        """The number with its interval."""
        return "–" if self.interval is None else self.interval.text(self.style)


@dataclass(frozen=True)
class Flown:
    """The comparisons of one figure, with the part that each method plays."""

    comparisons: Mapping[str, Comparison]
    """by setting"""
    roles: Mapping[str, Mapping[str, str]]
    """setting → role → label of the method that was flown; one's own are their own role"""
    settings: Mapping[str, Setting]
    """by name"""

    def of_paper(self, setting: str) -> list[str]:
        """The roles that the paper speaks of."""
        roles = self.roles.get(setting, {})
        return [role for role in roles if role != "ours" and " / " not in role]

    def values(self, setting: str, role: str, score: str = "rmse_db") -> Differences | None:
        """A score at the end, survey by survey; ``None`` where the role was not flown."""
        label = self.roles.get(setting, {}).get(role)
        if label is None or setting not in self.comparisons:
            return None
        comparison = self.comparisons[setting]
        if score.endswith("_median"):
            return comparison.delays[label][score], comparison.cities
        return comparison.scores[label][score][:, -1], comparison.cities

    def minus(self, setting: str, role: str, other: str) -> Differences | None:
        """Difference of the errors of two roles, survey by survey."""
        ours, theirs = self.values(setting, role), self.values(setting, other)
        if ours is None or theirs is None:
            return None
        return ours[0] - theirs[0], ours[1]

    def across(
        self, one: str, other: str, of: Callable[[str], Differences | None]
    ) -> Differences | None:
        """``of(one) - of(other)`` over the links that both settings were flown at."""
        first, second = of(one), of(other)
        if first is None or second is None:
            return None
        links, i, k = np.intersect1d(
            self.comparisons[one].links, self.comparisons[other].links, return_indices=True
        )
        if len(links) == 0:
            return None
        return first[0][i] - second[0][k], first[1][i]


def claims_of(figure: str, flown: Flown) -> list[Claim]:
    """The claims of a figure, in the paper's order."""
    return list(_CLAIMS[figure](flown))


def _altitudes(flown: Flown) -> Iterable[Claim]:
    settings = [s for s in ("three", "altitude-20", "altitude-30") if s in flown.settings]
    who = {"network": "the paper's network", "ours": "operator"}
    for role, name in who.items():
        for setting in settings:
            yield _negative(
                "The network is better than Kriging, which is told the transmitter, at each height",
                f"{name} minus Kriging, {flown.settings[setting].title}",
                flown.minus(setting, role, "kriging"),
            )
    for role, name in who.items():
        gap = _gap(flown, "kriging", role)
        yield _positive(
            "The gap to Kriging becomes smaller with height",
            f"gap of {name} at 10 m minus that at 30 m",
            flown.across("three", "altitude-30", gap),
        )
    yield _positive(
        "Without the map of the buildings the error is far larger at 10 m",
        "map-blind minus the paper's network",
        flown.minus("three", "map-blind", "network"),
    )


def _gain_bins(flown: Flown) -> Iterable[Claim]:
    comparison = flown.comparisons["three"]
    cities = len(np.unique(comparison.cities))
    curves = {}
    for role, name in (("network", "the paper's network"), ("ours", "operator")):
        sums = comparison.by_gain.get(flown.roles["three"].get(role, ""))
        curves[name] = None if sums is None else gain_curves(sums, comparison.cities)
    for name, c in curves.items():
        yield _judged(
            "The error is lower where the gain is higher",
            f"change of the RMSE of {name} per 10 dB of gain",
            None if c is None else c.slope(c.rmse_db),
            cities,
            below=0.0,
        )
    for name, c in curves.items():
        yield _judged(
            "Goodness of fit is close to 0",
            f"goodness of fit of {name}, within ±{_NEAR_GOF:g}",
            None if c is None else c.interval(c.gof_all),
            cities,
            below=_NEAR_GOF,
            above=-_NEAR_GOF,
        )
    for name, c in curves.items():
        yield _judged(
            "Goodness of fit is generally positive",
            f"goodness of fit of {name}",
            None if c is None else c.interval(c.gof_all),
            cities,
            above=0.0,
        )
    for name, c in curves.items():
        yield _judged(
            "Goodness of fit is closer to 0 where the gain is lower",
            f"change of its absolute value, {name}, per 10 dB of gain",
            None if c is None else c.slope(np.abs(c.gof)),
            cities,
            above=0.0,
        )


def _delay(flown: Flown) -> Iterable[Claim]:
    pairs = (
        ("The learned policy plans faster than greedy", "learned", "greedy", False),
        ("Greedy takes as long with Kriging as with the network", "greedy kriging", "greedy", True),
        ("Entropy planning takes longer than greedy", "greedy kriging", "entropy kriging", False),
    )
    for setting in ("two", "three"):
        for text, one, other, same in pairs:
            for per, name in (("decision", "decision"), ("planned_step", "planned step")):
                interval = _ratio(flown, setting, one, other, f"{per}_ms_median")
                bounds = (1 / _SAME_DELAY, _SAME_DELAY) if same else (None, 1.0)
                yield _judged(
                    text,
                    f"{one} over {other}, delay per {name}, {flown.settings[setting].uavs} UAVs",
                    interval,
                    len(np.unique(flown.comparisons[setting].cities)) if interval else 0,
                    above=bounds[0],
                    below=bounds[1],
                    style=".3g",
                )


def _order(flown: Flown, setting: str, kriging: bool = True) -> Iterable[Claim]:
    rows = [
        ("The learned policy is better than greedy", "learned", "greedy"),
        ("Greedy is better than random waypoints, with the network", "greedy", "random"),
    ]
    if kriging:
        entropy, greedy, random = "entropy kriging", "greedy kriging", "random kriging"
        rows.append(("Entropy planning is better than greedy", entropy, greedy))
        rows.append(("Greedy is better than random waypoints, with Kriging", greedy, random))
    for text, one, other in rows:
        yield _negative(text, f"{one} minus {other}", flown.minus(setting, one, other))
    if kriging:
        text = "The network with the learned policy is the best of the paper's methods"
        rivals = [role for role in flown.of_paper(setting) if role != "learned"]
        yield _all(
            text,
            [
                (
                    f"learned minus its nearest rival, {rival}",
                    flown.minus(setting, "learned", rival),
                )
                for rival in rivals
            ],
        )


def _cluster3(flown: Flown) -> Iterable[Claim]:
    return _order(flown, "three")


def _spread3(flown: Flown) -> Iterable[Claim]:
    yield from _order(flown, "spread")
    yield _all_fall(flown, "spread", "All errors are smaller than from one place")
    yield _positive(
        "The gap between learned and random becomes smaller",
        "gap from one place minus gap from anywhere",
        flown.across("three", "spread", _gap(flown, "random", "learned")),
    )


def _cluster5(flown: Flown) -> Iterable[Claim]:
    yield from _order(flown, "five", kriging=False)
    yield _all_fall(flown, "five", "All errors are smaller than with three UAVs")
    yield _positive(
        "The gap between learned and greedy becomes smaller",
        "gap of three UAVs minus gap of five",
        flown.across("three", "five", _gap(flown, "greedy", "learned")),
    )


_CLAIMS: dict[str, Callable[[Flown], Iterable[Claim]]] = {
    "altitudes": _altitudes,
    "gain-bins": _gain_bins,
    "delay": _delay,
    "cluster3": _cluster3,
    "spread3": _spread3,
    "cluster5": _cluster5,
}


def _gap(flown: Flown, worse: str, better: str) -> Callable[[str], Differences | None]:
    return lambda setting: flown.minus(setting, worse, better)


def _all_fall(flown: Flown, setting: str, text: str) -> Claim:
    """Every method's error is smaller in ``setting`` than with three UAVs from one place."""

    def error_of(role: str) -> Callable[[str], Differences | None]:
        return lambda setting: flown.values(setting, role)

    return _all(
        text,
        [
            (f"change of the method that gains least, {role}", pair)
            for role in flown.of_paper(setting)
            if (pair := flown.across(setting, "three", error_of(role))) is not None
        ],
    )


def _all(text: str, parts: list[tuple[str, Differences | None]]) -> Claim:
    """The claim that every difference is below 0, told by the one that is nearest to not being
    so."""
    claims = [_negative(text, measured, found) for measured, found in parts]
    claims = [claim for claim in claims if claim.interval is not None]
    if not claims:
        return Claim(text, "all methods", None, "+.2f", NOT_FLOWN)

    def nearest(claim: Claim) -> tuple[int, float]:
        assert claim.interval is not None
        return (FAILS, OPEN, HOLDS).index(claim.verdict), -claim.interval.mean

    return min(claims, key=nearest)


def _ratio(flown: Flown, setting: str, one: str, other: str, delay: str) -> Interval | None:
    """Ratio of two mean delays; cities are drawn for the mean of the logarithm."""
    ours, theirs = flown.values(setting, one, delay), flown.values(setting, other, delay)
    if ours is None or theirs is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = bootstrap_mean(np.log(ours[0]) - np.log(theirs[0]), ours[1])
    return Interval(*(float(np.exp(v)) for v in (logs.mean, logs.low, logs.high)))


def _negative(text: str, measured: str, found: Differences | None) -> Claim:
    return _difference(text, measured, found, below=0.0)


def _positive(text: str, measured: str, found: Differences | None) -> Claim:
    return _difference(text, measured, found, above=0.0)


def _difference(
    text: str,
    measured: str,
    found: Differences | None,
    *,
    below: float | None = None,
    above: float | None = None,
) -> Claim:
    interval = None if found is None else bootstrap_mean(*found)
    cities = 0 if found is None else len(np.unique(found[1]))
    return _judged(text, f"{measured}, dB", interval, cities, below=below, above=above)


def _judged(
    text: str,
    measured: str,
    interval: Interval | None,
    cities: int,
    *,
    below: float | None = None,
    above: float | None = None,
    style: str = "+.2f",
) -> Claim:
    """The claim that a number is below and above the bounds that are given."""
    if interval is None or np.isnan(interval.mean):
        return Claim(text, measured, None, style, NOT_FLOWN)
    low = -np.inf if above is None else above
    high = np.inf if below is None else below
    if np.isnan(interval.low) or cities < LEAST_CITIES:
        verdict = OPEN
    elif low < interval.low and interval.high < high:
        verdict = HOLDS
    elif interval.high < low or interval.low > high:
        verdict = FAILS
    else:
        verdict = OPEN
    return Claim(text, measured, interval, style, verdict)
