"""Planners: speed of the exact joint planner and of sequential greedy, its quality against
exhaustion, and its certificates.

    python benchmarks/planning.py DATA.zarr.zip [--quick] [--only SECTION]

measures
1. entropy value iteration (P3) against the dense NumPy reference of `dense_value_iteration.py`, and
   at its own sizes;
2. sequential greedy per decision at horizon 20 for 3, 10 and 50 UAVs;
3. sequential greedy against exhaustive joint search, two UAVs, 100 random settings;
4. certificates along surveys.

Everything runs in one thread and is timed in CPU seconds after a warm-up call (compilation): what
the wall clock shows on an idle machine, whatever else is running. DATA gives the cities (split T2).
Tables and numbers go to benchmarks/results/planning.md and .json. ``--only`` measures one section
again and keeps the others.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"  # before NumPy loads

import numpy as np
from dense_value_iteration import dense_value
from numba import njit

from skygain.city import City
from skygain.datasets import ChannelDataset, survey_cases
from skygain.fields.planning import planning_field
from skygain.flight.moves import MOVES
from skygain.flight.starts import start_cells
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.planners.search.certificate import information
from skygain.planners.search.joint_paths import state_count
from skygain.predictors import Belief
from skygain.predictors.kriging.known_source import KrigingPredictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario

PARAMETERS = KrigingParameters.known_trend(27.0, 72.0, sill_db2=380.0, range_m=57.0)
KRIGING = KrigingPredictor(parameters=PARAMETERS, refit=False)
RESULTS = Path(__file__).parent / "results"


def setting(free: np.ndarray, cells: np.ndarray, steps: int) -> tuple[Swarm, Belief]:
    """UAVs at ``cells`` on a map with the given free cells, and what Kriging knows there."""
    scenario = Scenario(
        City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32)),
        transmitter_m=(2.0, 2.0, 40.0),
    )
    return Swarm.deployed(scenario, cells, steps), measured(KRIGING.begin(scenario), cells)


def measured(belief: Belief, cells: np.ndarray) -> Belief:
    """The belief after readings at ``cells``; their values do not matter to the planners measured
    here."""
    return belief.updated(Measurements.at(cells, -110.0 + 5 * np.sin(cells.sum(axis=-1))))


def value_iteration(quick: bool) -> list[dict[str, Any]]:
    """P3: our times, transitions per second and the reference's."""
    rows = []
    cluster = np.array([[0, 0], [2, -1], [-1, 4]])
    runs = [(2, 20, 24), (2, 20, 40), (2, 40, 96), (3, 12, 96), (3, 16, 96)]
    runs += [] if quick else [(3, horizon, 96) for horizon in (18, 20, 22)]
    for n, horizon, side in runs:
        free = np.ones((side, side), dtype=bool)
        cells = cluster[:n] + side // 2
        swarm, belief = setting(free, cells, horizon)
        planner = create_planner("entropy-vi", horizon=horizon)
        small = create_planner("entropy-vi", horizon=2)
        small.plan(swarm, belief, 2, np.random.default_rng(0))
        began = time.process_time()
        plan = planner.plan(swarm, belief, horizon, np.random.default_rng(0))
        seconds = time.process_time() - began
        transitions = 4**n * state_count(n, horizon)
        row: dict[str, Any] = {"uavs": n, "side": side, "horizon": plan.n_steps, "seconds": seconds}
        row |= {"transitions": transitions, "transitions_per_s": transitions / seconds}
        row["peak_gib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        if n == 2 and side <= (24 if quick else 40):
            began = time.process_time()
            reference = dense_value(
                free, cells, horizon, PARAMETERS.sill_db2, PARAMETERS.range_m, 4.0
            )
            row |= {"dense_seconds": time.process_time() - began, "dense_nats": reference}
            row["nats"] = path_entropy(plan.paths)
            assert abs(row["nats"] - reference) < 1e-3 * horizon, (row["nats"], reference)
        rows.append(row)
        print(row, flush=True)
        if seconds > 90:
            break
    return rows


def path_entropy(paths: np.ndarray) -> float:
    """Σ H(y_{t+1} | y_t) of ``paths[uav, step, 2]`` in double precision."""
    total = 0.0
    for t in range(paths.shape[1] - 1):
        old = np.unique(paths[:, t], axis=0)
        new = np.array(
            [c for c in np.unique(paths[:, t + 1], axis=0) if not (c == old).all(axis=1).any()]
        )
        both = np.concatenate([old, new.reshape(-1, 2)])

        def log_det(cells: np.ndarray) -> float:
            gap = np.hypot(*(cells[:, None] - cells[None]).transpose(2, 0, 1)) * 4.0
            return float(
                np.linalg.slogdet(
                    2 * np.pi * np.e * PARAMETERS.sill_db2 * np.exp(-gap / PARAMETERS.range_m)
                )[1]
            )

        total += 0.5 * (log_det(both) - log_det(old))
    return total


def tiled_city(data: str, repeats: int, rng: np.random.Generator) -> np.ndarray:
    """Free cells of a large map made of several Manhattan cities of the data set side by side."""
    dataset = ChannelDataset.open(data)
    links = dataset.links("T2")
    tile = [
        [dataset.link(int(rng.choice(links))).city.height_m < 10.0 for _ in range(repeats)]
        for _ in range(repeats)
    ]
    return np.block(tile)


def decisions(data: str, quick: bool) -> list[dict[str, Any]]:
    """Sequential greedy: seconds per decision at horizon 20."""
    rows = []
    for objective in ("variance", "entropy", "mutual-information"):
        planner = create_planner(
            "sequential-greedy", objective=objective, horizon=20, commit_steps=10
        )
        for n in (3, 10, 50):
            rng = np.random.default_rng(n)
            if n == 3:
                case = survey_cases(ChannelDataset.open(data), "T2", n_uavs=3, max_surveys=1)[0]
                scenario, cells = case.scenario(), case.start_cells
            else:
                free = tiled_city(data, 2 if n == 10 else 3, rng)
                city = City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32))
                scenario = Scenario(city, transmitter_m=(2.0, 2.0, 40.0))
                cells = start_cells("spread", scenario, n, rng)
            steps = 100 if n < 50 and not quick else 60
            swarm = Swarm.deployed(scenario, cells, steps)
            belief = measured(KRIGING.begin(scenario), cells)
            planner.plan(swarm, belief, steps, rng)
            seconds = []
            for left in range(steps, 0, -10):
                belief.posterior()  # belongs to the predictor's time
                began = time.process_time()
                plan = planner.plan(swarm, belief, left, rng)
                seconds.append(time.process_time() - began)
                for step in range(1, plan.commit_steps + 1):
                    swarm = swarm.advanced(plan.paths[:, step])
                belief = measured(belief, plan.paths[:, 1 : plan.commit_steps + 1].reshape(-1, 2))
            row = {
                "objective": objective,
                "uavs": n,
                "shape": scenario.grid.shape,
                "decisions": len(seconds),
            }
            row |= {
                "median_s": float(np.median(seconds)),
                "p95_s": float(np.quantile(seconds, 0.95)),
            }
            rows.append(row)
            print(row, flush=True)
    return rows


@njit(cache=True)
def _exhausted(first, second, among, noise):
    """Best and mean information over all pairs of legal paths ``[path, step]`` (cell numbers), as
    (best, mean, pairs)."""
    steps = first.shape[1] - 1
    factor = np.zeros((2 * steps, 2 * steps))
    cells = np.empty(2 * steps, dtype=np.int64)
    best, total, pairs = 0.0, 0.0, 0
    for p in range(len(first)):
        settled, settled_value = 0, 0.0
        for t in range(1, steps + 1):
            settled, settled_value = _appended(
                first[p, t], cells, settled, settled_value, factor, among, noise
            )
        for q in range(len(second)):
            clash = False
            for t in range(1, steps + 1):
                same = first[p, t] == second[q, t]
                swap = first[p, t] == second[q, t - 1] and first[p, t - 1] == second[q, t]
                if same or swap:
                    clash = True
                    break
            if clash:
                continue
            count, value = settled, settled_value
            for t in range(1, steps + 1):
                count, value = _appended(second[q, t], cells, count, value, factor, among, noise)
            best = max(best, value)
            total += value
            pairs += 1
    return best, total / max(pairs, 1), pairs


@njit(cache=True)
def _appended(cell, cells, count, value, factor, among, noise):
    for j in range(count):
        if cells[j] == cell:
            return count, value
    left = among[cell, cell] + noise
    for j in range(count):
        entry = among[cell, cells[j]]
        for i in range(j):
            entry -= factor[count, i] * factor[j, i]
        factor[count, j] = entry / factor[j, j]
        left -= factor[count, j] ** 2
    factor[count, count] = np.sqrt(left)
    cells[count] = cell
    return count + 1, value + 0.5 * np.log(left / noise)


def all_paths(swarm: Swarm, uav: int, steps: int, number: np.ndarray) -> np.ndarray:
    """``[path, step]`` cell numbers of every path of one UAV that obstacles allow."""
    paths = [[tuple(swarm.cells[uav].tolist())]]
    for _ in range(steps):
        paths = [
            [*path, to]
            for path in paths
            for to in ((path[-1][0] + int(m[0]), path[-1][1] + int(m[1])) for m in MOVES)
            if 0 <= to[0] < number.shape[0] and 0 <= to[1] < number.shape[1] and swarm.flyable[to]
        ]
    return np.array([[number[cell] for cell in path] for path in paths])


def exhaustion(quick: bool) -> dict[str, Any]:
    """(F − F_random)/(F_optimal − F_random) of sequential greedy, entropy objective, two UAVs,
    horizon 5, random settings."""
    shares, ratios, sound = [], [], True
    planner = create_planner("sequential-greedy", objective="entropy")
    for trial in range(25 if quick else 125):
        rng = np.random.default_rng(trial)
        free = rng.random((12, 12)) > rng.uniform(0, 0.3)
        reachable = np.argwhere(free)
        cells = reachable[rng.choice(len(reachable), 2, replace=False)]
        near = reachable[np.abs(reachable - cells[0]).sum(axis=1) <= 3]
        cells[1] = near[rng.integers(len(near))]
        if (cells[0] == cells[1]).all() or len(shares) == (20 if quick else 100):
            continue
        swarm, belief = setting(free, cells, 5)
        belief = measured(belief, reachable[rng.choice(len(reachable), 8, replace=False)])
        number = np.arange(free.size).reshape(free.shape)
        source = planning_field(belief).conditioned()
        everything = np.argwhere(np.ones_like(free))
        first, second = (all_paths(swarm, uav, 5, number) for uav in range(2))
        if not (len(first) and len(second)):  # walled in
            continue
        best, mean, pairs = _exhausted(
            first, second, source.covariance(everything, everything), 1.0
        )
        if pairs == 0:
            continue
        plan = planner.plan(swarm, belief, 5, rng)
        value = information(source, np.unique(plan.paths[:, 1:].reshape(-1, 2), axis=0), 1.0)
        assert plan.certificate is not None
        sound &= best <= plan.certificate.upper_bound_nats + 1e-9 and value <= best + 1e-6
        shares.append((value - mean) / (best - mean) if best > mean else 1.0)
        ratios.append(value / best)
    found = {
        "cases": len(shares),
        "mean_share": float(np.mean(shares)),
        "worst_share": float(np.min(shares)),
    }
    found |= {
        "mean_ratio": float(np.mean(ratios)),
        "worst_ratio": float(np.min(ratios)),
        "certificates_hold": bool(sound),
    }
    print(found, flush=True)
    return found


def certificates(data: str, quick: bool) -> list[dict[str, Any]]:
    """Certificates of the entropy objective along surveys of T2."""
    rows = []
    for horizon in (10, 20, 40):
        planner = create_planner(
            "sequential-greedy", objective="entropy", horizon=horizon, commit_steps=horizon
        )
        found = []
        for case in survey_cases(
            ChannelDataset.open(data), "T2", n_uavs=3, max_surveys=3 if quick else 10
        ):
            swarm = Swarm.deployed(case.scenario(), case.start_cells, 80)
            belief = measured(KRIGING.begin(case.scenario()), case.start_cells)
            rng = case.rng()
            for left in range(80, 0, -horizon):
                plan = planner.plan(swarm, belief, left, rng)
                if plan.certificate is not None and plan.certificate.share is not None:
                    proof = plan.certificate
                    found.append((proof.gap_nats, proof.ratio, proof.share, proof.value_nats))
                for step in range(1, plan.commit_steps + 1):
                    swarm = swarm.advanced(plan.paths[:, step])
                belief = measured(belief, plan.paths[:, 1:].reshape(-1, 2))
        gap, ratio, share, value = np.median(np.array(found), axis=0)
        row = {
            "horizon": horizon,
            "plans": len(found),
            "value_nats": value,
            "gap_nats": gap,
            "ratio": ratio,
            "share": share,
        }
        rows.append({k: float(v) for k, v in row.items()})
        print(rows[-1], flush=True)
    return rows


def table(rows: list[list[str]]) -> str:
    """Markdown, the first row being the head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def report(found: dict[str, Any]) -> str:
    """The tables."""
    p3 = [
        [
            "UAVs",
            "map",
            "horizon",
            "CPU s",
            "transitions",
            "transitions/s",
            "dense NumPy, CPU s",
            "times faster",
        ]
    ]
    for r in found["value_iteration"]:
        dense = r.get("dense_seconds")
        numbers = [
            f"{r['seconds']:.2f}",
            f"{r['transitions']:.1e}",
            f"{r['transitions_per_s']:.1e}",
        ]
        against = [f"{dense:.1f}", f"{dense / r['seconds']:.0f}"] if dense else ["–", "–"]
        p3.append([str(r["uavs"]), f"{r['side']}²", str(r["horizon"]), *numbers, *against])
    speed = [["objective", "UAVs", "map", "decisions", "median, CPU s", "95 %, CPU s"]]
    for r in found["decisions"]:
        shape = f"{r['shape'][0]} × {r['shape'][1]}"
        speed.append(
            [
                r["objective"],
                str(r["uavs"]),
                shape,
                str(r["decisions"]),
                f"{r['median_s']:.3f}",
                f"{r['p95_s']:.3f}",
            ]
        )
    e = found["exhaustion"]
    proofs = [
        [
            "horizon",
            "plans",
            "F, nats",
            "gap, nats",
            "F / bound",
            "share of the way from random to the bound",
        ]
    ]
    for r in found["certificates"]:
        numbers = [
            f"{r['value_nats']:.1f}",
            f"{r['gap_nats']:.1f}",
            f"{r['ratio']:.3f}",
            f"{r['share']:.3f}",
        ]
        proofs.append([f"{r['horizon']:.0f}", f"{r['plans']:.0f}", *numbers])
    peak = max(r["peak_gib"] for r in found["value_iteration"])
    return "\n\n".join(
        [
            f"Machine: {found['machine']}.",
            "## Entropy value iteration (P3)\n\nOpen terrain, peak memory of the process "
            f"{peak:.1f} GiB.",
            table(p3),
            "## Sequential greedy, CPU seconds per decision, horizon 20",
            table(speed),
            "## Sequential greedy against exhaustive joint search",
            f"Two UAVs, horizon 5, {e['cases']} random settings: (F − F_random)/(F_optimal − "
            f"F_random) is {e['mean_share']:.4f} on "
            f"average and {e['worst_share']:.4f} at worst; F/F_optimal {e['mean_ratio']:.4f} and "
            f"{e['worst_ratio']:.4f}. "
            f"All certificates {'hold' if e['certificates_hold'] else 'DO NOT HOLD'}.",
            "## Certificates, medians along surveys of three UAVs",
            table(proofs),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data")
    parser.add_argument("--quick", action="store_true", help="smaller sizes, to see that it runs")
    sections: dict[str, Callable[[], Any]] = {
        "exhaustion": lambda: exhaustion(options.quick),
        "certificates": lambda: certificates(options.data, options.quick),
        "decisions": lambda: decisions(options.data, options.quick),
        "value_iteration": lambda: value_iteration(options.quick),
    }
    parser.add_argument("--only", choices=sections)
    options = parser.parse_args()
    file = RESULTS / "planning.json"
    found = json.loads(file.read_text()) if options.only and file.exists() else {}
    found["machine"] = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    for name in [options.only] if options.only else sections:
        found[name] = sections[name]()
        if not options.quick:
            file.write_text(json.dumps(found, indent=1) + "\n")
    if sections.keys() <= found.keys():
        text = report(found)
        if not options.quick:
            (RESULTS / "planning.md").write_text(f"# Planning\n\n{text}\n")
        print(text)


if __name__ == "__main__":
    main()
