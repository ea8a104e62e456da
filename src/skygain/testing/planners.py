"""Is this planner one? The contract of `skygain.planners.base.Planner`, as a check anyone can run
on their own planner."""

from __future__ import annotations

__all__ = ["check_planner", "fly", "planner_scenarios"]

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from skygain.city import City
from skygain.flight.starts import start_cells
from skygain.flight.swarm import FlightRules, Swarm
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.planners.base import Plan, Planner
from skygain.predictors.base import Belief, Predictor
from skygain.scenario import Scenario


@dataclass(frozen=True)
class PlannerScenario:
    """One setting a planner must cope with."""

    name: str
    """what is special about it"""
    scenario: Scenario
    """where"""
    n_uavs: int
    """how many UAVs"""
    steps: int | tuple[int, ...]
    """battery, one for all or one per UAV"""
    rules: FlightRules
    """what is forbidden besides obstacles"""
    start: str = "cluster"
    """how the UAVs are placed"""


def _scenario(
    flyable: ArrayLike, spacing_m: float = 4.0, no_fly: ArrayLike | None = None
) -> Scenario:
    free = np.asarray(flyable, dtype=bool)
    city = City(Grid(free.shape, spacing_m), np.where(free, 0.0, 30.0).astype(np.float32))  # type: ignore[arg-type]
    return Scenario(
        city, no_fly=None if no_fly is None else np.asarray(no_fly, dtype=bool), transmitter_m=None
    )


def _blocks(size: int, block: int, street: int) -> np.ndarray:
    along = np.arange(size) % (block + street) < street
    return along[:, None] | along[None, :]


def planner_scenarios() -> list[PlannerScenario]:
    """Small settings from an open field to a one-cell corridor; small enough that a whole survey
    takes a moment."""
    open_field = _scenario(np.ones((16, 20)))
    streets = _scenario(_blocks(24, 5, 2))
    corridor = np.zeros((5, 22))
    corridor[2] = 1
    forbidden = np.zeros((18, 18))
    forbidden[5:12, 8:11] = 1
    alone = np.zeros((7, 7))
    alone[3, 3] = 1
    maze = np.ones((13, 13))
    maze[1::4, :-1] = 0
    maze[3::4, 1:] = 0
    return [
        PlannerScenario("open field, one UAV", open_field, 1, 45, FlightRules()),
        PlannerScenario("open field, three UAVs", open_field, 3, 60, FlightRules()),
        PlannerScenario("streets, five UAVs spread", streets, 5, 50, FlightRules(), "spread"),
        PlannerScenario("streets, batteries of 0, 7 and 40", streets, 3, (0, 7, 40), FlightRules()),
        PlannerScenario(
            "one-cell corridor, three UAVs", _scenario(corridor), 3, 30, FlightRules(), "spread"
        ),
        PlannerScenario(
            "no-fly zone, 12 m apart",
            _scenario(np.ones((18, 18)), no_fly=forbidden),
            3,
            40,
            _apart(12.0),
            "spread",
        ),
        PlannerScenario(
            "streets, everyone returns", streets, 3, (30, 31, 44), FlightRules(return_to_start=True)
        ),
        PlannerScenario("maze, two UAVs", _scenario(maze), 2, 50, FlightRules()),
        PlannerScenario("shared cells allowed", streets, 3, 30, FlightRules(separate=False)),
        PlannerScenario("no move at all", _scenario(alone), 1, 5, FlightRules()),
    ]


def _apart(metres: float) -> FlightRules:
    return FlightRules(min_distance_m=metres)


def fly(
    planner: Planner,
    predictor: Predictor,
    setting: PlannerScenario,
    seed: int,
    gain_db: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Iterator[tuple[Swarm, Belief, int, Plan]]:
    """Fly a whole survey; yields (swarm, belief, horizon, plan) at every decision, not yet checked.

    ``gain_db(cells)`` answers what is measured; by default a smooth field.
    """
    rng = np.random.default_rng(seed)
    gain_db = gain_db or _smooth_gain
    cells = _start(setting, rng)
    swarm = Swarm.deployed(setting.scenario, cells, setting.steps, setting.rules)
    belief = predictor.begin(setting.scenario).updated(Measurements.at(cells, gain_db(cells)))
    horizon = int(np.max(setting.steps))
    while horizon > 0:
        plan = planner.plan(swarm, belief, horizon, rng)
        yield swarm, belief, horizon, plan
        for step in range(1, plan.commit_steps + 1):
            flying = swarm.flying
            swarm = swarm.advanced(plan.paths[:, step])
            belief = belief.updated(
                Measurements.at(swarm.cells[flying], gain_db(swarm.cells[flying]))
            )
        horizon -= plan.commit_steps


def _smooth_gain(cells: np.ndarray) -> np.ndarray:
    return -100.0 + 10.0 * np.sin(cells[:, 0] / 5.0) * np.cos(cells[:, 1] / 7.0)


def _start(setting: PlannerScenario, rng: np.random.Generator) -> np.ndarray:
    for _ in range(200):
        cells = start_cells(setting.start, setting.scenario, setting.n_uavs, rng)
        gaps = (
            np.hypot(*(cells[:, None] - cells[None]).T)[np.triu_indices(setting.n_uavs, 1)]
            * setting.scenario.grid.spacing_m
        )
        if (gaps >= setting.rules.min_distance_m).all():
            return cells
    raise AssertionError(
        f"{setting.name}: no start respects the distance of {setting.rules.min_distance_m} m"
    )


def check_planner(
    planner: Planner,
    predictor: Predictor,
    *,
    settings: Sequence[PlannerScenario] | None = None,
    seed: int = 0,
    max_uavs: int | None = None,
) -> None:
    """Raise `AssertionError` unless ``planner`` keeps its contract with the beliefs of
    ``predictor``.

    Over whole surveys in `planner_scenarios` (or ``settings``): plans are legal, begin where the
    UAVs stand, hold 1 to horizon steps and commit to a number of them; the same arguments give the
    same plan; the arguments stay as they were; a horizon of 1 is obeyed; a certificate's bound is
    not below its value. Settings with more than ``max_uavs`` UAVs are left out.
    """
    for setting in settings if settings is not None else planner_scenarios():
        if max_uavs is not None and setting.n_uavs > max_uavs:
            continue
        for swarm, belief, horizon, plan in fly(planner, predictor, setting, seed):
            _check_plan(setting.name, swarm, horizon, plan)
            if swarm.steps_flown == 0:
                _check_pure(setting.name, planner, swarm, belief, horizon)
                _check_plan(
                    setting.name,
                    swarm,
                    1,
                    planner.plan(swarm, belief, 1, np.random.default_rng(seed)),
                )


def _check_plan(where: str, swarm: Swarm, horizon: int, plan: Plan) -> None:
    paths = np.asarray(plan.paths)
    assert np.issubdtype(paths.dtype, np.integer), (
        f"{where}: paths must be integers, got {paths.dtype}"
    )
    assert 1 <= plan.n_steps <= horizon, (
        f"{where}: a plan holds 1 to {horizon} steps, got {plan.n_steps}"
    )
    assert 1 <= plan.commit_steps <= plan.n_steps, (
        f"{where}: commit_steps must lie in 1..{plan.n_steps}, got {plan.commit_steps}"
    )
    try:
        swarm.check(paths)
    except ValueError as error:
        raise AssertionError(
            f"{where}: illegal plan after {swarm.steps_flown} steps: {error}"
        ) from error
    if plan.certificate is not None:
        value, bound = plan.certificate.value_nats, plan.certificate.upper_bound_nats
        assert np.isfinite([value, bound]).all(), (
            f"{where}: the certificate holds {value} and {bound}; both must be finite"
        )
        assert bound >= value - 1e-9 * max(1.0, abs(value)), (
            f"{where}: the certificate's bound {bound} is below its value {value}"
        )


def _check_pure(where: str, planner: Planner, swarm: Swarm, belief: Belief, horizon: int) -> None:
    before = (swarm.flyable.copy(), swarm.history.copy(), swarm.steps_left.copy())
    variance, measured = np.array(belief.posterior().variance_db2), len(belief.measurements)
    first = planner.plan(swarm, belief, horizon, np.random.default_rng(7))
    again = planner.plan(replace(swarm), belief, horizon, np.random.default_rng(7))
    assert np.array_equal(first.paths, again.paths), (
        f"{where}: the same seed gave two different plans"
    )
    assert first.commit_steps == again.commit_steps, (
        f"{where}: the same seed gave two values of commit_steps"
    )
    for name, old, new in zip(
        ("flyable", "history", "steps_left"),
        before,
        (swarm.flyable, swarm.history, swarm.steps_left),
        strict=True,
    ):
        assert np.array_equal(old, new), f"{where}: planning changed swarm.{name}"
    assert len(belief.measurements) == measured, (
        f"{where}: planning changed the belief's measurements"
    )
    assert np.array_equal(variance, belief.posterior().variance_db2), (
        f"{where}: planning changed the belief's variance"
    )
