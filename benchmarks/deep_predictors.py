"""The deep predictors against Kriging on validation cities: random waypoints, three UAVs, cluster
start, 10 m.

    python benchmarks/deep_predictors.py DATA.zarr.zip --predictors kriging,operator,operator+tx
    --surveys 50

flies every predictor through the same surveys and prints, at 50, 100 and 200 steps, the RMSE over
unvisited outdoor cells (all of them, those a ray reached, the rest), its difference to the first
predictor with a bootstrap interval over cities, the goodness of fit, the cover of the 90 %
interval, and the time of one belief update. Table and numbers go to
benchmarks/results/deep_predictors.*.
A predictor may name a weight file: ``operator:weights=/path/checkpoint.safetensors``.
"""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path
from typing import Any

import numpy as np

from skygain.datasets import ChannelDataset, survey_cases
from skygain.evaluation.rollout import rollout
from skygain.ground.errors import InputError
from skygain.survey.methods import MethodSpec

STEPS = (50, 100, 200)
COLUMNS = ("rmse_db", "rmse_ray_traced_db", "rmse_rest_db", "error_ratio", "coverage90")


def fly(options: argparse.Namespace) -> dict[str, list[dict[str, Any]]]:
    """Rollouts per predictor, in the order of the cases."""
    cases = survey_cases(
        ChannelDataset.open(options.data),
        options.split,
        n_uavs=options.uavs,
        altitude_m=options.altitude,
        max_surveys=options.surveys,
    )
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in options.predictors}
    for number, case in enumerate(cases, 1):
        for name, rows in found.items():
            result = rollout(
                case, MethodSpec(name, "random-waypoint"), steps=STEPS[-1], record_steps=STEPS
            )
            rows.append({"city": case.city_index, "link": case.link, **result})
        print(
            f"{number}/{len(cases)}",
            *(f"{name} {rows[-1]['scores']['rmse_db'][-1]:.2f}" for name, rows in found.items()),
            flush=True,
        )
    return found


def interval(difference: np.ndarray, city: np.ndarray, draws: int = 2000) -> tuple[float, float]:
    """95 % bootstrap interval of the mean over surveys, drawing whole cities."""
    rng = np.random.default_rng(0)
    groups = [difference[city == c] for c in np.unique(city)]
    sums, sizes = np.array([g.sum() for g in groups]), np.array([len(g) for g in groups])
    pick = rng.integers(len(groups), size=(draws, len(groups)))
    low, high = np.quantile(sums[pick].sum(1) / sizes[pick].sum(1), [0.025, 0.975])
    return float(low), float(high)


def markdown(found: dict[str, list[dict[str, Any]]], options: argparse.Namespace) -> str:
    """The table."""
    first = next(iter(found))
    lines = [
        f"{len(found[first])} surveys of {options.split}, {options.uavs} UAVs, cluster start, "
        f"random waypoints, {options.altitude:g} m; "
        f"machine: {platform.processor() or platform.machine()}.",
        "",
        f"| predictor | T | RMSE dB | ray-traced | rest | against {first} | GoF | 90 % cover | "
        "update ms (median, p95) |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    city = np.array([row["city"] for row in found[first]])
    for name, rows in found.items():
        for i, step in enumerate(STEPS):
            scores = {key: np.array([row["scores"][key][i] for row in rows]) for key in COLUMNS}
            base = np.array([row["scores"]["rmse_db"][i] for row in found[first]])
            low, high = interval(scores["rmse_db"] - base, city)
            update = [
                np.median([row["delays"][f"update_ms_{q}"] for row in rows])
                for q in ("median", "p95")
            ]
            mean = {key: np.nanmean(values) for key, values in scores.items()}
            lines.append(
                f"| {name} | {step} | {mean['rmse_db']:.2f} | {mean['rmse_ray_traced_db']:.2f} | "
                f"{mean['rmse_rest_db']:.2f} | "
                f"{mean['rmse_db'] - base.mean():+.2f} [{low:+.2f}, {high:+.2f}] | "
                f"{np.log(mean['error_ratio']):+.2f} | "
                f"{100 * mean['coverage90']:.1f} % | {update[0]:.1f}, {update[1]:.1f} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="data set (.zarr or .zarr.zip)")
    parser.add_argument(
        "--predictors", default="kriging,operator,operator+tx", type=lambda text: text.split(",")
    )
    parser.add_argument("--split", default="T2")
    parser.add_argument("--surveys", default=25, type=int)
    parser.add_argument("--uavs", default=3, type=int)
    parser.add_argument("--altitude", default=10.0, type=float)
    parser.add_argument(
        "--out", default=Path(__file__).parent / "results" / "deep_predictors", type=Path
    )
    options = parser.parse_args()
    try:
        found = fly(options)
    except InputError as error:
        parser.error(str(error))
    table = markdown(found, options)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.with_suffix(".md").write_text(table, encoding="utf-8")
    plain = {
        name: [{k: v for k, v in row.items() if k != "certificates"} for row in rows]
        for name, rows in found.items()
    }
    options.out.with_suffix(".json").write_text(
        json.dumps({"split": options.split, "rollouts": plain}) + "\n", encoding="utf-8"
    )
    print("\n" + table)


if __name__ == "__main__":
    main()
