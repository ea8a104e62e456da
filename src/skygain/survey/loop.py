"""The loop: plan, fly, measure, believe, until the steps are spent or the map is certain enough."""

from __future__ import annotations

__all__ = ["Observer", "StepRecord", "Survey", "SurveyConfig", "SurveyResult", "delays_ms"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from skygain.flight.swarm import Swarm
from skygain.ground.compiling import Stopwatch
from skygain.ground.errors import InputError
from skygain.ground.shown import Shown
from skygain.instruments.base import Instrument
from skygain.measurements import Measurements
from skygain.planners.base import Certificate, Plan, Planner
from skygain.posterior import Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.scenario import Scenario
from skygain.survey.memory import demand_memory
from skygain.survey.tape import Tape

if TYPE_CHECKING:
    import xarray as xr

Observer = Callable[[int, Swarm, Belief], None]
"""called after every step with the steps flown, the swarm and the belief; step 0 is the start"""


@dataclass(frozen=True)
class SurveyConfig:
    """When a survey ends, and how long a step takes."""

    stop_std_db: float | None = None
    """end early once the error expected over outdoor cells (`Posterior.expected_rmse_db`) is below
    this; ``None`` flies every step"""
    stop_every: int = 5
    """look at that error every this many steps"""
    step_duration_s: float = 1.0
    """time stamp between steps"""

    def __post_init__(self) -> None:
        if self.stop_std_db is not None and not self.stop_std_db > 0:
            raise InputError(
                f"the stopping standard deviation must be above 0 dB, got {self.stop_std_db}; "
                "leave it out to fly every step"
            )


@dataclass(frozen=True)
class StepRecord:
    """One step of the journal."""

    step: int
    """steps flown when it was written"""
    readings: int
    """readings taken at this step"""
    planning_s: float
    """wall time of the decision made before this step, without compiling; 0 when an earlier plan
    was still being flown"""
    planned_steps: int
    """steps that decision planned, 0 when none was made"""
    updating_s: float
    """wall time of the belief's update, without compiling"""
    certificate: Certificate | None = None
    """of the plan made before this step"""


def delays_ms(journal: Sequence[StepRecord]) -> dict[str, float]:
    """Planning delay per decision and per planned step, and update delay per step, in milliseconds
    (median and 95th percentile)."""
    decisions = [(r.planning_s, r.planned_steps) for r in journal if r.planned_steps]
    per_decision = np.array([s for s, _ in decisions]) * 1e3
    per_step = np.array([s / n for s, n in decisions]) * 1e3
    update = np.array([r.updating_s for r in journal]) * 1e3
    named = {"decision": per_decision, "planned_step": per_step, "update": update}
    return {
        f"{name}_ms_{label}": float(np.quantile(values, q)) if len(values) else float("nan")
        for name, values in named.items()
        for label, q in (("median", 0.5), ("p95", 0.95))
    }


@dataclass(frozen=True, eq=False, repr=False)
class SurveyResult(Shown):
    """All there is to know about a finished survey."""

    scenario: Scenario
    """what was known before"""
    swarm: Swarm
    """where everybody has been"""
    measurements: Measurements
    """every reading, in order"""
    belief: Belief
    """what is believed at the end"""
    stopped: str
    """``"steps"`` when they were spent, ``"stop-std"`` when the map was certain enough,
    ``"interrupted"`` by the user"""
    journal: tuple[StepRecord, ...] = field(repr=False, default=())
    """one record per step, the start included"""

    def __repr__(self) -> str:
        cells = int(self.measurements.visited(self.scenario.grid.shape).sum())
        lines = [
            f"{self.ending}: {self.swarm.steps_flown} steps, {len(self.measurements)} readings in "
            f"{cells} cells"
        ]
        took = self.timings
        if took["decisions"]:
            lines.append(
                f"planning {took['decision_ms_median']:.1f} ms per decision, belief update "
                f"{took['update_ms_median']:.1f} ms (median)"
            )
        return "\n".join(lines)

    @property
    def posterior(self) -> Posterior:
        """What is believed at the end, at every cell."""
        return self.belief.posterior()

    def to_xarray(self) -> xr.Dataset:
        """``mean_db`` and ``std_db`` over (y, x) in metres, NaN indoors."""
        grid, maps = self.scenario.grid, self.posterior.to_xarray()
        maps = maps.where(self.scenario.outdoor).rename(row="y", col="x")
        return maps.assign_coords(
            y=("y", grid.y_m, {"units": "m"}), x=("x", grid.x_m, {"units": "m"})
        )

    @property
    def timings(self) -> dict[str, float]:
        """Seconds spent planning and updating, the decisions made, and the delays of
        `delays_ms`."""
        return {
            "planning_s": sum(r.planning_s for r in self.journal),
            "updating_s": sum(r.updating_s for r in self.journal),
            "decisions": float(sum(r.planned_steps > 0 for r in self.journal)),
            **delays_ms(self.journal),
        }

    @property
    def ending(self) -> str:
        """Why it ended, in words."""
        return {
            "steps": "all steps flown",
            "stop-std": "stopped early, the map was certain enough",
            "interrupted": "interrupted, with all that was measured so far",
        }.get(self.stopped, self.stopped)


@dataclass(frozen=True)
class Survey:
    """A predictor, a planner and an instrument at work in one scenario."""

    scenario: Scenario
    """the setting"""
    predictor: Predictor
    """how measurements become a belief"""
    planner: Planner
    """how a belief becomes a flight"""
    instrument: Instrument
    """how a flight becomes measurements"""
    config: SurveyConfig = SurveyConfig()
    """when to stop"""

    @threadpool_limits.wrap(limits=1, user_api="blas")
    def fly(
        self,
        swarm: Swarm,
        rng: np.random.Generator,
        observer: Observer | None = None,
        tape: Tape | None = None,
    ) -> SurveyResult:
        """Fly until no UAV has steps left.

        Linear algebra runs on one thread, so that the same seeds give the same map on any machine.
        The starting cells are measured first. An interrupt from the keyboard ends the survey after
        the step under way and returns what has been learnt.

        Args:
            swarm: the UAVs as deployed.
            rng: randomness of the planner; the instrument brings its own.
            observer: see `Observer`.
            tape: keeps plans and readings, so that the flight can go on after any death.

        Raises:
            InputError: there is not enough memory for it.
            ValueError: the planner returned an illegal path.
        """
        tape = Tape() if tape is None else tape
        demand_memory(self.predictor, self.scenario, int((swarm.steps_left + 1).sum()))
        belief, readings, record = self._measured(
            self.predictor.begin(self.scenario), Measurements.none(), swarm, tape, 0.0, 0, None
        )
        journal = [record]
        stopped = "steps"
        try:
            if observer:
                observer(0, swarm, belief)
            while swarm.flying.any():
                if self._certain(belief, swarm.steps_flown):
                    stopped = "stop-std"
                    break
                plan, planning_s = tape.plan(partial(self._planned, swarm, belief, rng))
                certificate = plan.certificate
                planned = plan.n_steps
                if not 1 <= plan.commit_steps <= planned:
                    raise ValueError(
                        f"a plan of {planned} steps commits to {plan.commit_steps}; it must fly 1 "
                        f"to {planned} of them"
                    )
                for cells in plan.paths.transpose(1, 0, 2)[1 : plan.commit_steps + 1]:
                    swarm = swarm.advanced(cells)
                    belief, readings, record = self._measured(
                        belief, readings, swarm, tape, planning_s, planned, certificate
                    )
                    journal.append(record)
                    planning_s, planned, certificate = 0.0, 0, None
                    if observer:
                        observer(swarm.steps_flown, swarm, belief)
                    if self._certain(belief, swarm.steps_flown):
                        break
        except KeyboardInterrupt:
            stopped = "interrupted"
        belief.posterior()  # on the same one thread
        return SurveyResult(self.scenario, swarm, readings, belief, stopped, tuple(journal))

    def _measured(
        self,
        belief: Belief,
        readings: Measurements,
        swarm: Swarm,
        tape: Tape,
        planning_s: float,
        planned_steps: int,
        certificate: Certificate | None,
    ) -> tuple[Belief, Measurements, StepRecord]:
        """The belief and the readings after measuring where the swarm is; only UAVs that moved (or
        just started) measure."""
        step = swarm.steps_flown
        moved = (
            np.ones(swarm.n_uavs, dtype=bool)
            if step == 0
            else (swarm.history[:, -1] != swarm.history[:, -2]).any(axis=1)
        )
        uav = np.flatnonzero(moved)
        time_s = step * self.config.step_duration_s
        new = tape.readings(
            lambda: self.instrument.measure(swarm.cells[uav], uav=uav, time_s=time_s)
        )
        watch = Stopwatch()
        belief = belief.updated(new)
        record = StepRecord(step, len(new), planning_s, planned_steps, watch.seconds, certificate)
        return belief, readings.extended(new), record

    def _planned(
        self, swarm: Swarm, belief: Belief, rng: np.random.Generator
    ) -> tuple[Plan, float]:
        watch = Stopwatch()
        plan = self.planner.plan(swarm, belief, int(swarm.steps_left.max()), rng)
        return plan, watch.seconds

    def _certain(self, belief: Belief, step: int) -> bool:
        if self.config.stop_std_db is None or step % self.config.stop_every:
            return False
        expected_db = belief.posterior().expected_rmse_db(self.scenario.outdoor)
        return expected_db < self.config.stop_std_db
