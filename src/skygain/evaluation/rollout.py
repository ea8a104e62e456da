"""One survey flown against a known truth, with its scores along the way."""

from __future__ import annotations

__all__ = ["Frame", "Observer", "Recorder", "flown", "rollout"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.metrics import by_gain, score
from skygain.flight.swarm import FlightRules, Swarm
from skygain.instruments.base import Instrument
from skygain.predictors.base import Belief
from skygain.scenario import Scenario
from skygain.survey.loop import Survey, delays_ms
from skygain.survey.methods import MethodSpec
from skygain.survey.worlds import simulated_instrument

if TYPE_CHECKING:
    from skygain.datasets.cases import Case

Observer = Callable[[int, Swarm, Belief], None]
"""told the steps flown, the swarm and the belief"""


@dataclass(frozen=True, eq=False)
class Frame:
    """A survey at one moment, for pictures and reports."""

    step: int
    """steps flown"""
    mean_db: NDArray[np.float32]
    """``[row, col]`` predicted gain"""
    std_db: NDArray[np.float32]
    """``[row, col]`` predicted standard deviation"""
    paths: NDArray[np.int64]
    """``[uav, step + 1, (row, col)]`` flown so far"""
    scores: dict[str, float]
    """see `skygain.evaluation.metrics.score`; only ``expected_rmse_db`` when no truth is known"""


@dataclass
class Recorder:
    """An observer that scores the belief at chosen steps and, when asked, keeps the maps as
    well."""

    steps: frozenset[int]
    """steps to record; the last step flown is recorded by calling `take` once more"""
    truth_db: NDArray[np.floating] | None = None
    """``[row, col]``, NaN where unknown; ``None`` when there is no truth at all"""
    ray_traced: NDArray[np.bool_] | None = None
    """``[row, col]`` cells a ray reached, when the truth is ray-traced"""
    keep_maps: bool = False
    """whether frames carry their maps; without, `Frame.mean_db` and `Frame.std_db` are empty"""
    on_step: Callable[[int, dict[str, float]], None] | None = None
    """told every step, with the scores when they were taken (progress displays)"""
    frames: list[Frame] = field(default_factory=list)
    """what was recorded so far"""

    def __call__(self, step: int, swarm: Swarm, belief: Belief) -> None:
        if step in self.steps:
            self.take(step, swarm, belief)
        if self.on_step:
            self.on_step(step, self.frames[-1].scores if self.frames else {})

    def take(self, step: int, swarm: Swarm, belief: Belief) -> None:
        """Record this moment unless it was already."""
        if self.frames and self.frames[-1].step == step:
            return
        posterior, outdoor = belief.posterior(), belief.scenario.outdoor
        visited = swarm.visited | belief.measurements.visited(outdoor.shape)
        if self.truth_db is None:
            scores = {"expected_rmse_db": posterior.expected_rmse_db(outdoor)}
        else:
            scores = score(posterior, self.truth_db, outdoor, visited, self.ray_traced)
        empty = np.empty((0, 0), dtype=np.float32)
        mean = posterior.mean_db.astype(np.float32) if self.keep_maps else empty
        std = posterior.std_db.astype(np.float32) if self.keep_maps else empty
        self.frames.append(Frame(step, mean, std, swarm.history.copy(), scores))


def rollout(
    case: Case,
    method: MethodSpec,
    *,
    steps: int,
    record_steps: Sequence[int],
    rules: FlightRules | None = None,
    noise_db: float = 0.0,
    observe: Observer | None = None,
) -> dict[str, Any]:
    """Fly ``method`` in ``case`` and return plain numbers, ready for JSON; see `flown`.

    Every method flown in the same case gets the same city, transmitter, crop, start cells and
    random stream.
    """
    return flown(
        case.scenario(),
        method,
        simulated_instrument(case.truth_db, noise_db, case.rng(1)),
        case.truth_db,
        case.start_cells,
        steps=steps,
        record_steps=record_steps,
        rng=case.rng(0),
        ray_traced=case.ray_traced,
        rules=rules,
        observe=observe,
    )


def flown(
    scenario: Scenario,
    method: MethodSpec,
    instrument: Instrument,
    truth_db: NDArray[np.floating],
    start_cells: NDArray[np.int64],
    *,
    steps: int,
    record_steps: Sequence[int],
    rng: np.random.Generator,
    ray_traced: NDArray[np.bool_] | None = None,
    rules: FlightRules | None = None,
    observe: Observer | None = None,
) -> dict[str, Any]:
    """Fly ``method`` once against a known truth.

    Args:
        scenario: with the transmitter; methods that do without are not told it.
        method: predictor and planner.
        instrument: gives the readings.
        truth_db: ``[row, col]`` gain that scores are taken against, NaN where unknown.
        start_cells: ``[uav, (row, col)]``.
        steps: of every UAV.
        record_steps: when scores are taken.
        rng: the planner's.
        ray_traced: ``[row, col]`` cells that a ray reached.
        rules: separation.
        observe: called at each of ``record_steps``.

    Returns:
        ``{"scores": {name: [value per recorded step]}, "steps": [...], "delays": {...}, "measured":
        readings taken, "by_gain": see `skygain.evaluation.metrics.by_gain`, at the end}``
    """
    predictor = method.build_predictor()
    scenario = method.visible(scenario, predictor)
    recorder = Recorder(frozenset(record_steps), truth_db, ray_traced)
    swarm = Swarm.deployed(scenario, start_cells, steps, rules)

    def watch(step: int, swarm: Swarm, belief: Belief) -> None:
        recorder(step, swarm, belief)
        if observe and step in recorder.steps:
            observe(step, swarm, belief)

    survey = Survey(scenario, predictor, method.build_planner(), instrument)
    result = survey.fly(swarm, rng, watch)
    names = list(recorder.frames[0].scores) if recorder.frames else []
    visited = result.swarm.visited | result.measurements.visited(scenario.outdoor.shape)
    return {
        "steps": [f.step for f in recorder.frames],
        "scores": {name: [f.scores[name] for f in recorder.frames] for name in names},
        "delays": delays_ms(result.journal),
        "measured": len(result.measurements),
        "by_gain": by_gain(result.posterior, truth_db, scenario.outdoor & ~visited),
        "certificates": [
            [c.certificate.value_nats, c.certificate.upper_bound_nats]
            for c in result.journal
            if c.certificate
        ],
    }
