"""What one decision of the learned planners and of look-ahead costs, N = 3, in the middle of a
survey.

    python benchmarks/decision_delay.py [--predictors kriging,operator] [--decisions 8]

Flies 40 random steps in the sample city, then decides again and again from there. Wall time is what
a pilot waits; CPU time is what it would be on an idle machine with one thread. A policy without
trained weights is timed with random ones. The belief's maps are part of the time. Table and numbers
go to benchmarks/results/decision_delay.*, beside those measured before.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import platform
import tempfile
import time
from dataclasses import is_dataclass, replace
from pathlib import Path

import numpy as np

from skygain.environments.worlds import LinkWorlds
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.planners import Planner, create_planner
from skygain.survey.methods import MethodSpec

RESULTS = Path(__file__).parent / "results"
RANDOM_POLICIES = {
    "dqn": {"network": "centred", "atoms": 40, "side": 96, "dueling": True},
    "paper-dqn": {"network": "paper", "atoms": 40, "side": 96, "dueling": False},
    "imitation": {"network": "centred", "atoms": 1, "side": 0, "dueling": False},
}


def planner_of(name: str) -> Planner:
    """The planner, with random weights where none are trained."""
    if name not in RANDOM_POLICIES:
        return create_planner(name)
    from skygain.networks.policies.network import policy_network
    from skygain.networks.policies.weights import export_policy, load_policy

    try:
        load_policy(name)
    except InputError:
        file = Path(tempfile.mkdtemp()) / "random.safetensors"
        shape = RANDOM_POLICIES[name]
        export_policy(
            policy_network(shape).state_dict(),
            file,
            {"policy": {**shape, "v_min": -20.0, "v_max": 5.0}},
        )
        return create_planner("dqn", weights=str(file))
    return create_planner("dqn", weights=name)


def delays_ms(predictor: str, planner: str, decisions: int) -> tuple[float, float]:
    """Median wall and CPU time of a decision."""
    world = LinkWorlds(split="T2").draw(np.random.default_rng(0), 3)
    method = MethodSpec(predictor, planner)
    scenario = method.visible(world.scenario, method.build_predictor())
    swarm = Swarm.deployed(scenario, world.start, 200)
    belief = method.build_predictor().begin(scenario)
    rng = np.random.default_rng(1)
    for cells in (
        create_planner("random-waypoint").plan(swarm, belief, 40, rng).paths.transpose(1, 0, 2)
    ):
        belief = belief.updated(
            Measurements.at(cells, world.truth_db[cells[:, 0], cells[:, 1]].astype(float))
        )
        swarm = (
            swarm
            if swarm.steps_flown == 0 and (cells == swarm.cells).all()
            else swarm.advanced(cells)
        )
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
    return 1e3 * float(np.median(wall)), 1e3 * float(np.median(cpu))


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--predictors", default="kriging,operator")
    parser.add_argument("--planners", default="imitation,dqn,paper-dqn,lookahead,sequential-greedy")
    parser.add_argument("--decisions", type=int, default=8)
    options = parser.parse_args()
    python = platform.python_version()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {python}, one thread"
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / "decision_delay.json"
    found = json.loads(file.read_text())["wall_cpu_ms"] if file.exists() else {}
    for predictor in options.predictors.split(","):
        for planner in options.planners.split(","):
            found[f"{predictor} / {planner}"] = delays_ms(predictor, planner, options.decisions)
    table = [
        f"Milliseconds per decision after 40 steps, N = 3, median of several; {machine}, shared "
        "with other work.",
        "",
        "| predictor / planner | CPU | wall |",
        "|---|---|---|",
        *(f"| {name} | {cpu:.0f} | {wall:.0f} |" for name, (wall, cpu) in found.items()),
    ]
    (RESULTS / "decision_delay.md").write_text("\n".join(table) + "\n")
    file.write_text(json.dumps({"machine": machine, "wall_cpu_ms": found}, indent=2) + "\n")
    print("\n".join(table))


if __name__ == "__main__":
    main()
