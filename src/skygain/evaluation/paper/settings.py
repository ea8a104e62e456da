"""What is flown for each figure of the paper.

A setting is one comparison with a journal of its own; figures share settings, so that no rollout is
flown twice. Methods stand under the roles that the paper's claims speak of.
"""

from __future__ import annotations

__all__ = ["FIGURES", "SETTINGS", "Figure", "Setting", "installed"]

from collections.abc import Sequence
from dataclasses import dataclass

from skygain.ground.errors import InputError
from skygain.networks.weights import weight_file
from skygain.survey.methods import MethodSpec

_UNET, _OURS, _KRIGING = "paper-unet", "operator", "kriging"
_RANDOM, _GREEDY, _LEARNED = "random-waypoint", "greedy-variance", "dqn"
_ENTROPY = "entropy-vi:horizon=8:commit_steps=8"
"""for three UAVs; the planner is exact, its work grows with the horizon as 4^(2N)"""


@dataclass(frozen=True)
class Setting:
    """Surveys that methods are flown in."""

    uavs: int = 3
    """how many"""
    start: str = "cluster"
    """cluster or spread"""
    altitude_m: float = 10.0
    """of flight and map"""

    @property
    def title(self) -> str:
        """In words."""
        return f"{self.uavs} UAVs, {self.start} start, {self.altitude_m:g} m"


SETTINGS = {
    "three": Setting(),
    "altitude-20": Setting(altitude_m=20.0),
    "altitude-30": Setting(altitude_m=30.0),
    "two": Setting(uavs=2),
    "spread": Setting(start="spread"),
    "five": Setting(uavs=5),
}
"""every comparison, by the name of its folder"""

Methods = dict[str, tuple[str, ...]]
"""role → labels of methods, of which the first that is installed is flown"""


@dataclass(frozen=True)
class Figure:
    """One figure of the paper."""

    title: str
    """headline"""
    methods: dict[str, Methods]
    """setting → role → methods"""


def _label(predictor: str, planner: str) -> tuple[str, ...]:
    return (f"{predictor} / {planner}",)


def _predictors(altitude: int) -> Methods:
    """Flown at random; the paper has a network for each altitude, ours is one for all."""
    weights = "" if altitude == 10 else f":weights={_UNET}-{altitude}m"
    return {
        "network": _label(_UNET + weights, _RANDOM),
        "kriging": _label(_KRIGING, _RANDOM),
        **({"map-blind": _label(f"{_UNET}-mapblind", _RANDOM)} if altitude == 10 else {}),
        "ours": _label(_OURS, _RANDOM),
    }


def _planners(weights: str = "", entropy: bool = True, ours: bool = True) -> Methods:
    """The paper's curves, and today's best. Weights for another swarm may be missing; then those
    for three UAVs are flown."""

    def unet(planner: str) -> tuple[str, ...]:
        other = _label(f"{_UNET}:weights={weights}", planner) if weights else ()
        return (*other, *_label(_UNET, planner))

    return {
        "learned": unet(_LEARNED),
        "greedy": unet(_GREEDY),
        "random": unet(_RANDOM),
        **({"entropy kriging": _label(_KRIGING, _ENTROPY)} if entropy else {}),
        "greedy kriging": _label(_KRIGING, _GREEDY),
        "random kriging": _label(_KRIGING, _RANDOM),
        **({"ours": _label(_OURS, "lookahead")} if ours else {}),
    }


def _timed(entropy: str) -> Methods:
    return {
        "learned": _label(_UNET, _LEARNED),
        "greedy": _label(_UNET, _GREEDY),
        "greedy kriging": _label(_KRIGING, _GREEDY),
        "entropy kriging": _label(_KRIGING, entropy),
    }


FIGURES = {
    "altitudes": Figure(
        "Error at three altitudes",
        {
            "three": _predictors(10),
            "altitude-20": _predictors(20),
            "altitude-30": _predictors(30),
        },
    ),
    "gain-bins": Figure(
        "Error and goodness of fit by true gain",
        {"three": {k: v for k, v in _predictors(10).items() if k != "map-blind"}},
    ),
    "delay": Figure(
        "Planning delay",
        {"two": _timed("entropy-vi"), "three": _timed(_ENTROPY)},
    ),
    "cluster3": Figure("Methods, three UAVs from one place", {"three": _planners()}),
    "spread3": Figure(
        "Methods, three UAVs from anywhere", {"spread": _planners(), "three": _planners()}
    ),
    "cluster5": Figure(
        "Methods, five UAVs from one place",
        {
            "five": _planners(f"{_UNET}-5", entropy=False),
            "three": _planners(entropy=False),
        },
    ),
}
"""the figures by their names; the first setting of the method figures is the one that is drawn"""


def installed(labels: Sequence[str]) -> tuple[str | None, str]:
    """The first of the methods whose weights are there, and why the first one is not flown.

    >>> installed(["kriging / lawnmower"])
    ('kriging / lawnmower', '')
    """
    why = ""
    for label in labels:
        method = MethodSpec.of_label(label)
        try:
            for made in (method.build_predictor(), method.build_planner()):
                if weights := getattr(made, "weights", None):
                    weight_file(weights)
        except InputError as error:
            why = why or str(error)
            continue
        return label, why
    return None, why
