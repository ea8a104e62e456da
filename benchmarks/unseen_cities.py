"""Predictors in kinds of city they were not trained on: windows of Munich and Paris (Etoile), 4 m
cells, traced by our own simulator.

    python benchmarks/unseen_cities.py --predictors kriging,operator,operator+tx --windows 10

cuts windows of 96 × 96 cells out of Sionna RT's scenes ``munich`` and ``etoile``, puts one
transmitter at 1.5 m on open ground of each, up to 102 m outside the window, traces the gain at 10 m
over window and surroundings, and flies three UAVs by random waypoints (cluster start, 200 steps).
No network is trained again. Traced windows are kept in the user's cache; the table goes to
benchmarks/results/unseen_cities.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from skygain.cities.scenes import scene_city
from skygain.city import City
from skygain.evaluation.rollout import Recorder
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.instruments.simulated import PerfectInstrument
from skygain.networks.weights import runs_folder
from skygain.propagation.truth import trace_truth
from skygain.scenario import Scenario
from skygain.survey.loop import Survey
from skygain.survey.methods import MethodSpec

SCENES = ("munich", "etoile")
SIDE, MARGIN, SPACING_M, ALTITUDE_M = 96, 26, 4.0, 10.0
STEPS = (0, 50, 100, 200)
OPEN_SHARE = 0.3
"""a window with less outdoor ground than this is drawn again"""


def window(scene: str, number: int, samples: int) -> dict[str, Any]:
    """City heights, transmitter and truth of one window, from the cache if it was traced before."""
    path = runs_folder().parent / "unseen" / f"{scene}-{number}-{samples}.npz"
    if path.exists():
        with np.load(path) as found:
            return dict(found)
    whole = scene_city(scene, spacing_m=SPACING_M)
    rng = np.random.default_rng([number, len(scene)])
    wide = SIDE + 2 * MARGIN
    inner = (slice(MARGIN, MARGIN + SIDE),) * 2
    while True:
        row, col = (int(rng.integers(n - wide + 1)) for n in whole.grid.shape)
        height = np.ascontiguousarray(whole.height_m[row : row + wide, col : col + wide])
        if (height[inner] < ALTITUDE_M).mean() >= OPEN_SHARE and (
            height[inner] >= ALTITUDE_M
        ).mean() >= 0.1:
            break
    city = City(Grid((wide, wide), SPACING_M), height, name=scene)
    open_cells = np.argwhere(height <= 0)
    x, y = city.grid.xy_m(open_cells[rng.integers(len(open_cells))])
    transmitter = np.array([float(x), float(y), 1.5])
    truth = trace_truth(city, [transmitter], [ALTITUDE_M], samples=samples, seed=number)
    found = {
        "height_m": height[inner],
        "gain_db": truth.gain_db[0, 0][inner],
        "ray_traced": truth.ray_traced[0, 0][inner],
        "transmitter_m": transmitter - [MARGIN * SPACING_M, MARGIN * SPACING_M, 0.0],
        "seed": np.int64(number),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **found)
    return found


def fly(found: dict[str, Any], name: str) -> dict[str, list[float]]:
    """Scores at `STEPS`."""
    city = City(Grid((SIDE, SIDE), SPACING_M), found["height_m"])
    scenario = Scenario(city, transmitter_m=tuple(found["transmitter_m"].tolist()))
    scenario = replace(scenario, uav_altitude_m=ALTITUDE_M, prediction_altitude_m=ALTITUDE_M)
    rng = np.random.default_rng([int(found["seed"]), 7])
    cells = start_cells("cluster", scenario, 3, rng)
    method = MethodSpec(name, "random-waypoint")
    predictor = method.build_predictor()
    scenario = method.visible(scenario, predictor)
    recorder = Recorder(frozenset(STEPS), found["gain_db"], found["ray_traced"])
    swarm = Swarm.deployed(scenario, cells, STEPS[-1])
    Survey(scenario, predictor, method.build_planner(), PerfectInstrument(found["gain_db"])).fly(
        swarm, rng, recorder
    )
    keys = ("rmse_db", "rmse_ray_traced_db", "gof", "coverage90")
    return {key: [frame.scores[key] for frame in recorder.frames] for key in keys}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--predictors", default="kriging,operator,operator+tx", type=lambda text: text.split(",")
    )
    parser.add_argument("--windows", default=10, type=int, help="per scene")
    parser.add_argument("--samples", default=10_000_000, type=int, help="rays per transmitter")
    options = parser.parse_args()
    lines = [
        f"{options.windows} windows of each scene, 96 × 96 cells of 4 m at 10 m, "
        f"{options.samples / 1e6:g} M rays, random waypoints, "
        "3 UAVs, cluster start; RMSE in dB over unvisited outdoor cells, mean over windows.",
        "",
        "| scene | predictor | T=0 | T=50 | T=100 | T=200 | ray-traced, T=200 | GoF | 90 % cover |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    rows: list[dict[str, Any]] = []
    for scene in SCENES:
        for number in range(options.windows):
            found = window(scene, number, options.samples)
            for name in options.predictors:
                rows.append(
                    {"scene": scene, "window": number, "predictor": name, **fly(found, name)}
                )
            print(
                scene,
                number,
                *(
                    f"{r['predictor']} {r['rmse_db'][-1]:.1f}"
                    for r in rows[-len(options.predictors) :]
                ),
                flush=True,
            )
        for name in options.predictors:
            chosen = [r for r in rows if r["scene"] == scene and r["predictor"] == name]
            mean = {
                key: np.nanmean([r[key] for r in chosen], axis=0)
                for key in ("rmse_db", "rmse_ray_traced_db", "gof", "coverage90")
            }
            lines.append(
                f"| {scene} | {name} | "
                + " | ".join(f"{v:.2f}" for v in mean["rmse_db"])
                + f" | {mean['rmse_ray_traced_db'][-1]:.2f} | "
                f"{mean['gof'][-1]:+.2f} | {100 * mean['coverage90'][-1]:.1f} % |"
            )
    results = Path(__file__).parent / "results"
    (results / "unseen_cities.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (results / "unseen_cities.json").write_text(json.dumps(rows) + "\n", encoding="utf-8")
    print("\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
