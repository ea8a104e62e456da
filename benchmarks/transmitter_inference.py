"""How much of the gain from knowing the transmitter Kriging keeps when it has to find the
transmitter itself.

    python benchmarks/transmitter_inference.py DATA.zarr.zip [--split T2] [--surveys 50] [--workers
    2] [--folder FOLDER]

Three UAVs from a cluster start fly by random waypoints and by sequential greedy with Kriging that
is told the transmitter, Kriging that weighs all places where it may stand, and Kriging around a
constant. The share recovered is

    (RMSE_blind − RMSE_inferred) / (RMSE_blind − RMSE_known),

of mean RMSEs over surveys, with a 95 % bootstrap interval over cities. The rollouts are kept in
FOLDER, so that a run that was interrupted goes on. Writes
benchmarks/results/transmitter_inference.md and .json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from skygain.evaluation.comparison import Comparison, compare
from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.statistics import bootstrap_mean, city_weights

KNOWN, INFERRED, BLIND = "kriging", "kriging-inferred", "kriging-blind"
PLANNERS = ("random-waypoint", "sequential-greedy")
STEPS = (50, 100, 200)


def recovered(comparison: Comparison, planner: str, step: int) -> dict[str, object]:
    """Mean RMSE of the three and the share recovered, at one step."""
    k = comparison.steps.index(step)
    known, inferred, blind = (
        comparison.scores[f"{p} / {planner}"]["rmse_db"][:, k] for p in (KNOWN, INFERRED, BLIND)
    )
    weights = city_weights(comparison.cities)
    shares = (weights @ (blind - inferred)) / (weights @ (blind - known))
    share = float((blind - inferred).mean() / (blind - known).mean())
    low, high = np.quantile(shares, [0.025, 0.975]).tolist()
    gain = bootstrap_mean(blind - known, comparison.cities)
    means = {
        "known_db": float(known.mean()),
        "inferred_db": float(inferred.mean()),
        "blind_db": float(blind.mean()),
    }
    return {
        "planner": planner,
        "step": step,
        **means,
        "gain_db": str(gain),
        "share": share,
        "share_low": low,
        "share_high": high,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data")
    parser.add_argument("--split", default="T2")
    parser.add_argument("--surveys", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("surveys/transmitter-inference"))
    options = parser.parse_args()
    request = EvaluateRequest(
        predictors=(KNOWN, INFERRED, BLIND),
        planners=PLANNERS,
        data=options.data,
        split=options.split,
        max_surveys=options.surveys,
        record_every=50,
        workers=options.workers,
        out=options.folder,
    )
    comparison = compare(
        request,
        progress=lambda done, total, _: print(f"{done}/{total}", flush=True),
    )
    rows = [recovered(comparison, planner, step) for planner in PLANNERS for step in STEPS]
    lines = [
        f"{len(comparison.cities)} surveys in {len(np.unique(comparison.cities))} cities of "
        f"{options.split}, three UAVs, cluster start, "
        "exact readings. RMSE in dB over unvisited outdoor cells; brackets: 95 % bootstrap "
        "interval over cities.",
        "",
        "| planner | T | transmitter known | inferred | blind | gain from knowing it, dB | share "
        "recovered |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r['planner']} | {r['step']} | {r['known_db']:.2f} | {r['inferred_db']:.2f} | "
        f"{r['blind_db']:.2f} | {r['gain_db']} "
        f"| {r['share']:.0%} [{r['share_low']:.0%}, {r['share_high']:.0%}] |"
        for r in rows
    ]
    text = "# Kriging that finds the transmitter\n\n" + "\n".join(lines) + "\n"
    print(text)
    results = Path(__file__).parent / "results"
    (results / "transmitter_inference.md").write_text(text, encoding="utf-8")
    (results / "transmitter_inference.json").write_text(
        json.dumps(rows, indent=1) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
