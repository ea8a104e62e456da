"""How far from the recorded cells should UAVs fly when a campaign is flown over again? The default
of `replay_scenario` rests on this.

Near the recording every step finds a reading, but the way along the streets is long; far from it
UAVs move freely and find little.

    python benchmarks/replay_reach.py PATH/TO/duke_cbrs_abc.csv

flies the six series of benchmarks/duke_cbrs.py (constant-trend Kriging, 3 UAVs, 200 steps, cluster
start) and writes benchmarks/results/replay_reach.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from duke_cbrs import PHONE_HEIGHT_M, box_grid, open_series

from skygain.evaluation.metrics import score
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.instruments import GriddedRecording, ReplayInstrument, replay_scenario, replay_truth
from skygain.planners import create_planner
from skygain.predictors import create_predictor
from skygain.survey.loop import Survey

REACHES_M = (4.0, 8.0, 20.0, 40.0, None)
PLANNERS = ("random-waypoint", "greedy-variance")
UAVS, STEPS = 3, 200


def flown(
    gridded: GriddedRecording, reach_m: float | None, planner: str, seed: int
) -> tuple[float, float]:
    """(distinct recorded cells measured, RMSE in dB over the recorded cells not measured) of one
    survey."""
    scenario = replay_scenario(gridded, uav_altitude_m=PHONE_HEIGHT_M, reach_m=reach_m)
    rng = np.random.default_rng(seed)
    swarm = Swarm.deployed(scenario, start_cells("cluster", scenario, UAVS, rng), STEPS)
    survey = Survey(
        scenario,
        create_predictor("kriging-blind"),
        create_planner(planner),
        ReplayInstrument(gridded),
    )
    result = survey.fly(swarm, rng)
    visited = result.measurements.visited(gridded.grid.shape)
    return float(visited.sum()), score(
        result.belief.posterior(), replay_truth(gridded), scenario.outdoor, visited
    )["rmse_db"]


def main() -> None:
    """Fly all of them, print the table, write it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="duke_cbrs_abc.csv")
    parser.add_argument("--seeds", type=int, default=6)
    options = parser.parse_args()
    series = [gridded for gridded, _ in open_series(options.data, box_grid()).values()]
    header = " | ".join(
        f"{p}: cells measured | {p}: RMSE, dB | {p}: difference to {REACHES_M[0]:g} m"
        for p in PLANNERS
    )
    lines = [f"| reach | flyable cells | {header} |", "|---|---|" + "---|---|---|" * len(PLANNERS)]
    first: dict[str, np.ndarray] = {}
    for reach_m in REACHES_M:
        flyable = np.mean(
            [
                replay_scenario(g, uav_altitude_m=PHONE_HEIGHT_M, reach_m=reach_m).flyable.sum()
                for g in series
            ]
        )
        parts = ["whole map" if reach_m is None else f"{reach_m:g} m", f"{flyable:.0f}"]
        for planner in PLANNERS:
            cells, rmse = np.array(
                [flown(g, reach_m, planner, seed) for g in series for seed in range(options.seeds)]
            ).T
            gap = rmse - first.setdefault(planner, rmse)
            parts += [
                f"{cells.mean():.0f}",
                f"{rmse.mean():.2f}",
                f"{gap.mean():+.2f} ± {gap.std(ddof=1) / np.sqrt(len(gap)):.2f}",
            ]
        lines.append("| " + " | ".join(parts) + " |")
        print(lines[-1], flush=True)
    note = (
        f"Means over {len(series)} series and {options.seeds} seeds, {UAVS} UAVs, {STEPS} steps, "
        "cluster start; "
        "± is the standard error of the paired difference."
    )
    (Path(__file__).parent / "results" / "replay_reach.md").write_text(
        "\n".join([note, "", *lines]) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
