"""How fast decisions and environments are. CPU seconds where a study says so: what the wall clock
shows on an idle machine."""

from __future__ import annotations

import resource
import tempfile
import time
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planning import KRIGING, measured, setting
from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.city import City
from skygain.datasets.cases import survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.environments.worlds import LinkWorlds
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.planners import Planner, create_planner
from skygain.planners.search.joint_paths import state_count
from skygain.predictors import Predictor, create_predictor
from skygain.scenario import Scenario
from skygain.survey.methods import MethodSpec


@study(
    "value_iteration",
    sizes=Option(("2:40:96", "3:12:96", "3:16:96", "3:20:96", "3:22:96"), "UAVs:horizon:side"),
)
def value_iteration(run: Run) -> list[Table]:
    """Entropy value iteration (P3), exact, in open terrain: CPU seconds of a decision.

    Compiled before it is timed.
    """
    rows = []
    for size in run.options.sizes:
        n, horizon, side = map(int, size.split(":"))
        seconds, steps, peak = run.once((size,), lambda a=n, b=horizon, c=side: decide(a, b, c))
        transitions = 4**n * state_count(n, steps)
        rows.append(
            [
                f"{n}",
                f"{side}²",
                f"{steps}",
                f"{seconds:.2f}",
                f"{transitions:.1e}",
                f"{transitions / seconds:.1e}",
                f"{peak:.1f}",
            ]
        )
    head = ["UAVs", "map", "horizon", "CPU s", "transitions", "transitions/s", "peak memory, GiB"]
    return [Table("Open terrain.", head, rows)]


def decide(n: int, horizon: int, side: int) -> list[float]:
    """(CPU seconds, steps planned, peak memory of the process in GiB)."""
    cells = np.array([[0, 0], [2, -1], [-1, 4]])[:n] + side // 2
    swarm, belief = setting(np.ones((side, side), dtype=bool), cells, horizon)
    rng = np.random.default_rng(0)
    create_planner("entropy-vi", horizon=2).plan(swarm, belief, 2, rng)
    planner = create_planner("entropy-vi", horizon=horizon)
    began = time.process_time()
    plan = planner.plan(swarm, belief, horizon, rng)
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return [seconds, plan.n_steps, peak]


@study(
    "greedy_decisions",
    data="DATA",
    swarms=Option((3, 10, 50), "UAVs"),
    steps=Option(60, "steps of a survey"),
)
def greedy_decisions(run: Run) -> list[Table]:
    """Sequential greedy: CPU seconds per decision at horizon 20, on cities of T2 side by side."""
    rows = []
    for objective in ("variance", "entropy", "mutual-information"):
        for n in run.options.swarms:
            shape, seconds = run.once(
                (objective, n, run.options.steps),
                lambda o=objective, n=n: decisions(run.data, o, n, run.options.steps),
            )
            median, p95 = np.quantile(seconds, [0.5, 0.95])
            rows.append(
                [
                    objective,
                    f"{n}",
                    f"{shape[0]} × {shape[1]}",
                    f"{len(seconds)}",
                    f"{median:.3f}",
                    f"{p95:.3f}",
                ]
            )
    head = ["objective", "UAVs", "map", "decisions", "median, CPU s", "95 %, CPU s"]
    return [Table("Horizon 20, ten steps flown.", head, rows)]


def decisions(data: Path, objective: str, n: int, steps: int) -> tuple[Any, list[float]]:
    """Shape of the map and CPU seconds of every decision along one survey."""
    planner = create_planner("sequential-greedy", objective=objective, horizon=20, commit_steps=10)
    dataset, rng = ChannelDataset.open(data), np.random.default_rng(n)
    if n == 3:
        case = survey_cases(dataset, "T2", n_uavs=3, max_surveys=1)[0]
        scenario, cells = case.scenario(), case.start_cells
    else:
        links, side = dataset.links("T2"), range(2 if n <= 10 else 3)
        tiles = [[dataset.link(int(rng.choice(links))).city for _ in side] for _ in side]
        height = np.block([[np.where(c.height_m < 10.0, 0, 30) for c in row] for row in tiles])
        city = City(Grid(height.shape, 4.0), height.astype(np.float32))
        scenario = Scenario(city, transmitter_m=(2.0, 2.0, 40.0))
        cells = start_cells("spread", scenario, n, rng)
    swarm = Swarm.deployed(scenario, cells, steps)
    belief = measured(KRIGING.begin(scenario), cells)
    planner.plan(swarm, belief, steps, rng)  # compiles
    seconds = []
    for left in range(steps, 0, -10):
        belief.posterior()  # belongs to the predictor's time
        began = time.process_time()
        plan = planner.plan(swarm, belief, left, rng)
        seconds.append(time.process_time() - began)
        for step in range(1, plan.commit_steps + 1):
            swarm = swarm.advanced(plan.paths[:, step])
        belief = measured(belief, plan.paths[:, 1 : plan.commit_steps + 1].reshape(-1, 2))
    return scenario.grid.shape, seconds


RANDOM_POLICIES = {
    "dqn": {"network": "centred", "atoms": 40, "side": 96, "dueling": True},
    "paper-dqn": {"network": "paper", "atoms": 40, "side": 96, "dueling": False},
    "imitation": {"network": "centred", "atoms": 1, "side": 0, "dueling": False},
}


def planner_of(name: str) -> Planner:
    """The planner; a policy without trained weights gets random ones."""
    if name not in RANDOM_POLICIES:
        return create_planner(name)
    from skygain.networks.policies.weights import policy_file

    try:
        policy_file(name)
    except InputError:
        from skygain.networks.policies.network import policy_network
        from skygain.networks.policies.weights import export_policy

        shape = RANDOM_POLICIES[name]
        file = Path(tempfile.mkdtemp()) / "random.safetensors"
        card = {"policy": {**shape, "v_min": -20.0, "v_max": 5.0}}
        export_policy(policy_network(shape).state_dict(), file, card)
        return create_planner("dqn", weights=str(file))
    return create_planner("dqn", weights=name)


@study(
    "decision_delay",
    predictors=Option(("kriging", "paper-unet", "operator"), "predictors"),
    planners=Option(("imitation", "dqn", "lookahead", "sequential-greedy"), "planners"),
    decisions=Option(8, "decisions of each"),
)
def decision_delay(run: Run) -> list[Table]:
    """What one decision of the learned planners and of look-ahead costs in the middle of a survey.

    Three UAVs fly 40 random steps in the sample city, then decide again and again from there. Wall
    time is what a pilot waits; CPU time is what it would be on an idle machine. The belief's maps
    are part of the time.
    """
    o = run.options
    rows = []
    for predictor in o.predictors:
        for planner in o.planners:
            wall, cpu = run.once(
                (predictor, planner, o.decisions),
                lambda p=predictor, q=planner: delays_ms(p, q, o.decisions),
            )
            rows.append([f"{predictor} / {planner}", f"{cpu:.0f}", f"{wall:.0f}"])
    title = "Milliseconds per decision after 40 steps, N = 3, median of several, one thread."
    return [Table(title, ["predictor / planner", "CPU", "wall"], rows)]


def delays_ms(predictor: str, planner: str, decisions: int) -> list[float]:
    """Median wall and CPU time of a decision."""
    world = LinkWorlds(split="T2").draw(np.random.default_rng(0), 3)
    method = MethodSpec(predictor, planner)
    scenario = method.visible(world.scenario, method.build_predictor())
    swarm = Swarm.deployed(scenario, world.start, 200)
    belief = method.build_predictor().begin(scenario)
    rng = np.random.default_rng(1)
    paths = create_planner("random-waypoint").plan(swarm, belief, 40, rng).paths
    for step, cells in enumerate(paths.transpose(1, 0, 2)):
        truth = world.truth_db[cells[:, 0], cells[:, 1]].astype(float)
        belief = belief.updated(Measurements.at(cells, truth))
        swarm = swarm.advanced(cells) if step else swarm
    chosen = planner_of(planner)
    chosen.plan(swarm, belief, 160, rng)  # compiles
    wall, cpu = [], []
    for _ in range(decisions):
        # without the maps worked out before
        fresh = replace(belief) if is_dataclass(belief) else belief.updated(Measurements.none())
        begun, used = time.perf_counter(), time.process_time()
        chosen.plan(swarm, fresh, 160, rng)
        wall.append(time.perf_counter() - begun)
        cpu.append(time.process_time() - used)
    return [1e3 * float(np.median(wall)), 1e3 * float(np.median(cpu))]


def predictor_of(name: str) -> Predictor | None:
    """The predictor; the U-Nets get random weights where none are trained."""
    if name == "none":
        return None
    if name != "paper-unet":
        return create_predictor(name)
    from skygain.networks.weights import find_weights

    try:
        find_weights(name)
    except InputError:
        from skygain.networks.unets.paper import PaperUNets
        from skygain.networks.weights import write_weights

        file = Path(tempfile.mkdtemp()) / "random.safetensors"
        write_weights(file, PaperUNets().state_dict(), {})
        return create_predictor(name, weights=str(file))
    return create_predictor(name)


@study(
    "environment",
    predictors=Option(("none", "idw", "kriging", "paper-unet"), "predictors"),
    lanes=Option((1, 2, 4, 8, 16, 32), "surveys side by side"),
    seconds=Option(6.0, "measured at least so long"),
)
def environment(run: Run) -> list[Table]:
    """Joint steps per second of the reinforcement-learning environment.

    A joint step moves all UAVs of one survey once, takes their readings, asks the predictor for its
    maps and builds what every UAV observes.
    """
    o = run.options
    rows = []
    for name in o.predictors:
        rates = [
            run.once((name, n, o.seconds), lambda p=name, n=n: joint_steps_per_s(p, n, o.seconds))
            for n in o.lanes
        ]
        rows.append([name, *(f"{rate:.0f}" if rate >= 20 else f"{rate:.1f}" for rate in rates)])
    title = (
        "Joint steps per second (N = 3, 96 × 96 cells, T = 200; the first steps of a survey), one "
        "thread."
    )
    head = [f"{n} surveys" if n > 1 else "1 survey" for n in o.lanes]
    return [Table(title, ["predictor", *head], rows)]


def joint_steps_per_s(name: str, lanes: int, seconds: float) -> float:
    """Measured over at least ``seconds`` after the first step."""
    worlds, config = LinkWorlds(split="T1"), EnvironmentConfig(3, 200)
    surveys = SurveyBatch(worlds, predictor_of(name), config, lanes)
    rng = np.random.default_rng(0)

    def step() -> None:
        masks = surveys.masks()
        surveys.step(np.argmax(masks * (0.5 + rng.random(masks.shape)), axis=-1))
        surveys.observations()

    step()
    count, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        step()
        count += 1
    return count * lanes / (time.perf_counter() - begun)
