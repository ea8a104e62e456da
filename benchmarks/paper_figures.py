"""The paper's figures on predictors: RMSE and goodness of fit by true gain, and RMSE against flown
steps per altitude.

    python benchmarks/paper_figures.py DATA.zarr.zip --predictors
    kriging,paper-unet,paper-unet-mapblind,operator --split T2 --surveys 25

flies random waypoints (three UAVs, cluster start, 200 steps) with every predictor at every altitude
the data set holds, pools the errors at the end over unvisited outdoor cells in bins of 10 dB of
true gain, and draws both figures. Rollouts are kept in benchmarks/results/paper_figures.jsonl and
continued; the figures are docs/images/gain_bins.png and docs/images/altitudes.png, the tables
benchmarks/results/paper_figures.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from skygain.datasets import ChannelDataset, survey_cases
from skygain.evaluation.metrics import VARIANCE_FLOOR_DB2, gof
from skygain.evaluation.rollout import Recorder
from skygain.flight.swarm import Swarm
from skygain.ground.errors import InputError
from skygain.instruments.simulated import PerfectInstrument
from skygain.survey.loop import Survey
from skygain.survey.methods import MethodSpec

STEPS = 200
LOWEST_M = 10.0
EDGES = np.arange(-190.0, -39.0, 10.0)
HERE = Path(__file__).parent
Rows = dict[tuple[str, float], list[dict[str, Any]]]


def one(case: Any, name: str) -> dict[str, Any]:
    """Fly ``case`` and return RMSE along the way and sums by gain at the end."""
    if name == "paper-unet" and case.altitude_m != LOWEST_M:  # one model per altitude
        name = f"paper-unet:weights=paper-unet-{case.altitude_m:g}m"
    method = MethodSpec(name, "random-waypoint")
    predictor = method.build_predictor()
    scenario = method.visible(case.scenario(), predictor)
    recorder = Recorder(
        frozenset(range(0, STEPS + 1, 25)), case.truth_db, case.ray_traced, keep_maps=True
    )
    swarm = Swarm.deployed(scenario, case.start_cells, STEPS)
    Survey(scenario, predictor, method.build_planner(), PerfectInstrument(case.truth_db)).fly(
        swarm, case.rng(0), recorder
    )
    last = recorder.frames[-1]
    unseen = scenario.outdoor & np.isfinite(case.truth_db)
    unseen[last.paths[..., 0], last.paths[..., 1]] = False
    truth = case.truth_db[unseen].astype(float)
    square = (last.mean_db[unseen] - truth) ** 2
    ratio = square / np.maximum(last.std_db[unseen].astype(float) ** 2, VARIANCE_FLOOR_DB2)
    index = np.digitize(truth, EDGES)
    sums = [
        np.bincount(index, w, minlength=len(EDGES) + 1).tolist()
        for w in (np.ones_like(truth), square, ratio)
    ]
    return {
        "steps": [f.step for f in recorder.frames],
        "rmse_db": [f.scores["rmse_db"] for f in recorder.frames],
        "bins": sums,
    }


def fly(options: argparse.Namespace) -> Rows:
    """All rollouts, those of an earlier call included."""
    log = HERE / "results" / "paper_figures.jsonl"
    done = {}
    if log.exists():
        for line in log.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            done[row["predictor"], row["altitude_m"], row["split"], row["link"]] = row
    rows: Rows = {}
    data = ChannelDataset.open(options.data)
    for altitude in options.altitudes:
        cases = survey_cases(
            data, options.split, n_uavs=3, altitude_m=altitude, max_surveys=options.surveys
        )
        for number, case in enumerate(cases, 1):
            for name in options.predictors:
                key = (name, altitude, options.split, case.link)
                if key not in done:
                    found = {
                        "predictor": name,
                        "altitude_m": altitude,
                        "split": options.split,
                        "link": case.link,
                        **one(case, name),
                    }
                    done[key] = found
                    with log.open("a", encoding="utf-8") as out:
                        out.write(json.dumps(found) + "\n")
                rows.setdefault((name, altitude), []).append(done[key])
            print(f"{altitude:g} m: {number}/{len(cases)}", flush=True)
    return rows


def binned(rows: list[dict[str, Any]]) -> Iterator[tuple[float, float, float, float]]:
    """(middle of the bin in dB, share of the cells, RMSE, goodness of fit) of bins with at least
    0.2 % of the cells."""
    count, square, ratio = np.sum([row["bins"] for row in rows], axis=0)
    for k in range(1, len(EDGES)):
        if count[k] >= 0.002 * count.sum():
            yield (
                EDGES[k] - 5.0,
                count[k] / count.sum(),
                float(np.sqrt(square[k] / count[k])),
                gof(ratio[k] / count[k]),
            )


def draw(rows: Rows, options: argparse.Namespace) -> None:
    """Both figures."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    images = HERE.parent / "docs" / "images"
    lowest = min(options.altitudes)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for name in options.predictors:
        middle, _, rmse, fit = zip(*binned(rows[name, lowest]), strict=True)
        left.plot(middle, rmse, marker="o", markersize=3, label=name)
        right.plot(middle, fit, marker="o", markersize=3, label=name)
    left.set(
        xlabel="true gain, dB",
        ylabel="RMSE, dB",
        title=f"error by gain, {lowest:g} m, {STEPS} steps",
        ylim=(0, None),
    )
    right.set(
        xlabel="true gain, dB",
        ylabel="goodness of fit (0 is ideal)",
        title="above 0: too sure, below 0: too timid",
    )
    right.axhline(0, color="0.6", linewidth=0.8)
    left.legend(fontsize=8)
    figure.savefig(images / "gain_bins.png", dpi=110)
    figure, axes = plt.subplots(
        1,
        len(options.altitudes),
        figsize=(3.2 * len(options.altitudes), 3.2),
        sharey=True,
        layout="constrained",
        squeeze=False,
    )
    for axis, altitude in zip(axes[0], options.altitudes, strict=True):
        for name in options.predictors:
            rmse = np.mean([row["rmse_db"] for row in rows[name, altitude]], axis=0)
            axis.plot(rows[name, altitude][0]["steps"], rmse, label=name)
        axis.set(
            xlabel="steps per UAV",
            title=f"{altitude:g} m ({len(rows[name, altitude])} surveys)",
            ylim=(0, 30),
        )
    axes[0, 0].set_ylabel("RMSE over unvisited outdoor cells, dB")
    axes[0, 0].legend(fontsize=8)
    figure.savefig(images / "altitudes.png", dpi=110)


def markdown(rows: Rows, options: argparse.Namespace) -> str:
    """Both tables."""
    lines = [
        f"{options.split}, random waypoints, 3 UAVs, cluster start. RMSE in dB over unvisited "
        "outdoor cells.",
        "",
        "| predictor | altitude | surveys | T=0 | T=50 | T=100 | T=200 |",
        "|---|---|---|---|---|---|---|",
    ]
    for (name, altitude), found in rows.items():
        rmse = np.mean([row["rmse_db"] for row in found], axis=0)
        at = [rmse[found[0]["steps"].index(t)] for t in (0, 50, 100, 200)]
        lines.append(
            f"| {name} | {altitude:g} m | {len(found)} | "
            + " | ".join(f"{v:.2f}" for v in at)
            + " |"
        )
    lines += [
        "",
        f"By true gain at {min(options.altitudes):g} m and T = {STEPS}: RMSE in dB / goodness of "
        "fit.",
        "",
    ]
    tables = {
        name: {m: (r, f) for m, _, r, f in binned(rows[name, min(options.altitudes)])}
        for name in options.predictors
    }
    share = {m: s for m, s, _, _ in binned(rows[options.predictors[0], min(options.altitudes)])}
    lines += [
        "| gain, dB | share | " + " | ".join(tables) + " |",
        "|---|---|" + "---|" * len(tables),
    ]
    for middle, part in share.items():
        cells = [
            f"{t[middle][0]:.1f} / {t[middle][1]:+.2f}" if middle in t else "–"
            for t in tables.values()
        ]
        lines.append(
            f"| {middle - 5:g} to {middle + 5:g} | {100 * part:.1f} % | " + " | ".join(cells) + " |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument(
        "--predictors", default="kriging,operator", type=lambda text: text.split(",")
    )
    parser.add_argument(
        "--altitudes", default="10,20,30", type=lambda text: [float(a) for a in text.split(",")]
    )
    parser.add_argument("--split", default="T2")
    parser.add_argument("--surveys", default=25, type=int)
    options = parser.parse_args()
    try:
        rows = fly(options)
    except InputError as error:
        parser.error(str(error))
    table = markdown(rows, options)
    (HERE / "results" / "paper_figures.md").write_text(table, encoding="utf-8")
    draw(rows, options)
    print("\n" + table)


if __name__ == "__main__":
    main()
