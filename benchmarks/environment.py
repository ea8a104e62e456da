"""Joint steps per second of the vectorised environment: 1 to 32 surveys together, with and without
a predictor.

    python benchmarks/environment.py [--predictors none,idw,kriging,paper-unet] [--seconds 6]

A joint step moves all UAVs of one survey once (N = 3, 96 × 96 cells, T = 200), takes their
readings, asks the predictor for its maps and builds what every UAV observes. A network predictor
without trained weights is timed with random ones. Table and numbers go to
benchmarks/results/environment.*, beside those of predictors measured before.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import platform
import tempfile
import time
from pathlib import Path

import numpy as np

from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.environments.worlds import LinkWorlds
from skygain.ground.errors import InputError
from skygain.predictors import Predictor, create_predictor

RESULTS = Path(__file__).parent / "results"
LANES = (1, 2, 4, 8, 16, 32)


def predictor_of(name: str) -> Predictor | None:
    """The predictor, with random weights where none are trained."""
    if name == "none":
        return None
    if name != "paper-unet":
        return create_predictor(name)
    from skygain.networks.weights import find_weights

    try:
        find_weights(name)
    except InputError:
        from skygain.networks.checkpoints import save_checkpoint
        from skygain.networks.unets.paper import PaperUNets

        file = Path(tempfile.mkdtemp()) / "random.safetensors"
        save_checkpoint(file, PaperUNets().state_dict(), {})
        return create_predictor(name, weights=str(file))
    return create_predictor(name)


def joint_steps_per_second(name: str, lanes: int, seconds: float) -> float:
    """Measured over at least ``seconds`` after the first step."""
    surveys = SurveyBatch(
        LinkWorlds(split="T1"), predictor_of(name), EnvironmentConfig(3, 200), lanes
    )
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


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--predictors", default="none,idw,kriging,paper-unet")
    parser.add_argument("--seconds", type=float, default=6.0)
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / "environment.json"
    found = json.loads(file.read_text())["rates"] if file.exists() else {}
    for name in options.predictors.split(","):
        found[name] = [
            round(joint_steps_per_second(name, lanes, options.seconds), 1) for lanes in LANES
        ]
    python = platform.python_version()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {python}, one thread"
    table = [
        "Joint steps per second (N = 3, 96 × 96 cells, T = 200; the first steps of a survey), "
        f"{machine}.",
        "",
        "| predictor | "
        + " | ".join(f"{lanes} surveys" if lanes > 1 else "1 survey" for lanes in LANES)
        + " |",
        "|---" * (len(LANES) + 1) + "|",
        *(
            f"| {name} | "
            + " | ".join(f"{rate:.0f}" if rate >= 20 else f"{rate:.1f}" for rate in rates)
            + " |"
            for name, rates in found.items()
        ),
    ]
    (RESULTS / "environment.md").write_text("\n".join(table) + "\n")
    file.write_text(
        json.dumps({"machine": machine, "lanes": LANES, "rates": found}, indent=2) + "\n"
    )
    print("\n".join(table))


if __name__ == "__main__":
    main()
