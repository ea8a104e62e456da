"""The paper's figures on predictors, and the learning curves of the runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import RESULTS, Table
from benchmarks.study import Option, Run, study
from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.evaluation.metrics import VARIANCE_FLOOR_DB2, gof
from skygain.evaluation.rollout import rollout
from skygain.flight.swarm import Swarm
from skygain.networks.weights import runs_folder
from skygain.predictors import Belief
from skygain.survey.methods import MethodSpec

IMAGES = Path(__file__).parents[1] / "docs" / "images"
EDGES = np.arange(-190.0, -39.0, 10.0)
LOWEST_M = 10.0
Found = list[dict[str, Any]]


def by_gain(case: Case, name: str, steps: int) -> dict[str, Any]:
    """RMSE along one survey by random waypoints, and at its end (count, squared error, ratio) by
    true gain."""
    if name == "paper-unet" and case.altitude_m != LOWEST_M:  # one model per altitude
        name = f"paper-unet:weights=paper-unet-{case.altitude_m:g}m"
    bins: list[Any] = []

    def observe(step: int, swarm: Swarm, belief: Belief) -> None:
        if step < steps:
            return
        unseen = belief.scenario.outdoor & np.isfinite(case.truth_db) & ~swarm.visited
        truth, posterior = case.truth_db[unseen].astype(float), belief.posterior()
        square = (posterior.mean_db[unseen] - truth) ** 2
        ratio = square / np.maximum(posterior.variance_db2[unseen], VARIANCE_FLOOR_DB2)
        index = np.digitize(truth, EDGES)
        bins.extend(
            np.bincount(index, weights, minlength=len(EDGES) + 1)
            for weights in (np.ones_like(truth), square, ratio)
        )

    steps_seen = sorted({*range(0, steps, 25), steps})
    found = rollout(
        case,
        MethodSpec(name, "random-waypoint"),
        steps=steps,
        record_steps=steps_seen,
        observe=observe,
    )
    return {"steps": found["steps"], "rmse_db": found["scores"]["rmse_db"], "bins": bins}


def binned(found: Found) -> Iterator[tuple[float, float, float, float]]:
    """(middle of the bin in dB, share of the cells, RMSE, goodness of fit) of bins with at least
    0.2 % of the cells."""
    count, square, ratio = np.sum([row["bins"] for row in found], axis=0)
    for k in range(1, len(EDGES)):
        if count[k] >= 0.002 * count.sum():
            rmse = float(np.sqrt(square[k] / count[k]))
            yield EDGES[k] - 5.0, count[k] / count.sum(), rmse, gof(ratio[k] / count[k])


@study(
    "paper_figures",
    data="DATA",
    predictors=Option(("kriging", "paper-unet", "operator"), "predictors"),
    altitudes=Option((10.0, 20.0, 30.0), "metres"),
    split=Option("T2", "split of the data set"),
    surveys=Option(25, "surveys"),
    steps=Option(200, "steps of a survey"),
)
def paper_figures(run: Run) -> list[Table]:
    """RMSE and goodness of fit by true gain, and RMSE against flown steps per altitude.

    Random waypoints, three UAVs, cluster start; unvisited outdoor cells. Draws
    docs/images/gain_bins.png and altitudes.png.
    """
    o = run.options
    data = ChannelDataset.open(run.data)
    found: dict[tuple[str, float], Found] = {}
    for altitude in o.altitudes:
        cases = survey_cases(data, o.split, altitude_m=altitude, max_surveys=o.surveys)
        for name in o.predictors:
            found[name, altitude] = [
                run.once(
                    (name, altitude, o.split, case.link, o.steps),
                    lambda c=case, n=name: by_gain(c, n, o.steps),
                )
                for case in cases
            ]
    if o.results == RESULTS:
        draw_figures(found, o.predictors, o.altitudes, o.steps)
    shown = sorted({0, o.steps // 4, o.steps // 2, o.steps})
    rows = []
    for (name, altitude), surveys in found.items():
        rmse = np.mean([row["rmse_db"] for row in surveys], axis=0)
        at = [f"{rmse[surveys[0]['steps'].index(t)]:.2f}" for t in shown]
        rows.append([name, f"{altitude:g} m", f"{len(surveys)}", *at])
    title = (
        f"{o.split}, random waypoints, 3 UAVs, cluster start. RMSE in dB over unvisited outdoor "
        "cells."
    )
    first = Table(title, ["predictor", "altitude", "surveys", *(f"T={t}" for t in shown)], rows)
    lowest = min(o.altitudes)
    tables = {
        name: {m: (r, f) for m, _, r, f in binned(found[name, lowest])} for name in o.predictors
    }
    share = {m: s for m, s, _, _ in binned(found[o.predictors[0], lowest])}
    rows = [
        [f"{m - 5:g} to {m + 5:g}", f"{100 * s:.1f} %"]
        + [f"{t[m][0]:.1f} / {t[m][1]:+.2f}" if m in t else "–" for t in tables.values()]
        for m, s in share.items()
    ]
    title = f"By true gain at {lowest:g} m and T = {o.steps}: RMSE in dB / goodness of fit."
    return [first, Table(title, ["gain, dB", "share", *tables], rows)]


def draw_figures(
    found: dict[tuple[str, float], Found],
    predictors: tuple[str, ...],
    altitudes: tuple[float, ...],
    steps: int,
) -> None:
    """Both figures."""
    plt = pyplot()
    lowest = min(altitudes)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for name in predictors:
        middle, _, rmse, fit = zip(*binned(found[name, lowest]), strict=True)
        left.plot(middle, rmse, marker="o", markersize=3, label=name)
        right.plot(middle, fit, marker="o", markersize=3, label=name)
    left.set(title=f"error by gain, {lowest:g} m, {steps} steps", ylim=(0, None))
    left.set(xlabel="true gain, dB", ylabel="RMSE, dB")
    right.set(title="above 0: too sure, below 0: too careful")
    right.set(xlabel="true gain, dB", ylabel="goodness of fit (0 is ideal)")
    right.axhline(0, color="0.6", linewidth=0.8)
    left.legend(fontsize=8)
    figure.savefig(IMAGES / "gain_bins.png", dpi=110)
    size = (3.2 * len(altitudes), 3.2)
    figure, axes = plt.subplots(
        1, len(altitudes), figsize=size, sharey=True, layout="constrained", squeeze=False
    )
    for axis, altitude in zip(axes[0], altitudes, strict=True):
        for name in predictors:
            surveys = found[name, altitude]
            rmse = np.mean([row["rmse_db"] for row in surveys], axis=0)
            axis.plot(surveys[0]["steps"], rmse, label=name)
        axis.set(title=f"{altitude:g} m ({len(surveys)} surveys)", ylim=(0, 30))
        axis.set(xlabel="steps per UAV")
    axes[0, 0].set_ylabel("RMSE over unvisited outdoor cells, dB")
    axes[0, 0].legend(fontsize=8)
    figure.savefig(IMAGES / "altitudes.png", dpi=110)


def pyplot() -> Any:
    """Matplotlib without a window."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


SCORES = ("rmse_db", "rmse_traced_db", "rmse_rest_db", "nll", "gof", "cover90")


@study("learning_curves", runs=Option(str(runs_folder()), "folder of the runs"))
def learning_curves(run: Run) -> list[Table]:
    """The newest scores of every run, from its log.

    What a log holds is kept in benchmarks/results/learning_curves.csv, so that the curves of runs
    that are no longer there are drawn too: docs/images/learning_curves.png and policy_curves.png.
    """
    folder = run.options.results
    curves = kept_curves(folder / "learning_curves.csv")
    for log in sorted(Path(run.options.runs).glob("*/log.jsonl")):
        if curve := read_log(log):
            curves[log.parent.name] = curve
    write_curves(folder / "learning_curves.csv", curves)
    predictors = {name: c for name, c in curves.items() if "nll" in c[0]}
    policies = {name: c for name, c in curves.items() if "return" in c[0]}
    if folder == RESULTS:
        draw_predictors(predictors)
        draw_policies(policies)
    rows = []
    for name, curve in sorted(predictors.items()):
        for altitude in sorted({r["altitude"] for r in curve}):
            last = [r for r in curve if r["altitude"] == altitude][-1]
            *rmse, nll, fit, cover = (last[s] for s in SCORES)
            rows.append(
                [
                    name,
                    f"{altitude:g} m",
                    f"{last['samples']:,.0f}",
                    f"{last['seconds'] / 60:.0f}",
                    *(f"{v:.2f}" for v in rmse),
                    f"{nll:.3f}",
                    f"{fit:+.2f}",
                    f"{100 * cover:.1f} %",
                ]
            )
    head = ["run", "altitude", "samples", "minutes", "RMSE dB", "ray-traced", "rest", "NLL", "GoF"]
    return [Table("", [*head, "90 % cover"], rows)]


def read_log(log: Path) -> Found:
    """Rows of the scores in a log, one for each altitude; of records made twice, after a kill, the
    later one."""
    records: dict[int, dict[str, float]] = {}
    for line in log.read_text(encoding="utf-8").splitlines():
        try:
            record = json.loads(line)
        except json.JSONDecodeError:  # the line that a kill cut off
            continue
        if any("@" in key for key in record) or "return" in record:
            records[record["step"]] = record
    rows = []
    for _, record in sorted(records.items()):
        if "return" in record:
            kept = {k: record[k] for k in ("updates", "return", "rmse_db") if k in record}
            rows.append({k: round(float(v), 4) for k, v in kept.items()})
        for altitude in (k.split("@")[1] for k in record if k.startswith("rmse_db@")):
            row = {"altitude": float(altitude)}
            row |= {k: round(float(record[k]), 1) for k in ("samples", "seconds")}
            rows.append(row | {s: round(float(record[f"{s}@{altitude}"]), 4) for s in SCORES})
    return rows


COLUMNS = ("run", "altitude", "samples", "seconds", *SCORES, "updates", "return")


def kept_curves(path: Path) -> dict[str, Found]:
    """The curves of a file that `write_curves` wrote."""
    curves: dict[str, Found] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines()[1:]:
            name, *cells = line.split(",")
            row = {k: float(v) for k, v in zip(COLUMNS[1:], cells, strict=True) if v}
            curves.setdefault(name, []).append(row)
    return curves


def write_curves(path: Path, curves: dict[str, Found]) -> None:
    """One line per record."""
    lines = [",".join(COLUMNS)]
    for name, curve in sorted(curves.items()):
        for row in curve:
            cells = [f"{row[k]:.10g}" if k in row else "" for k in COLUMNS[1:]]
            lines.append(",".join([name, *cells]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def draw_predictors(curves: dict[str, Found]) -> None:
    """Error and likelihood on the validation cities against samples, at a run's lowest altitude."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(11.5, 3.8), layout="constrained")
    colours = plt.get_cmap("tab20").colors
    for colour, (name, curve) in zip(colours, sorted(curves.items()), strict=False):
        lowest = min(r["altitude"] for r in curve)
        rows = [r for r in curve if r["altitude"] == lowest]
        samples = [r["samples"] / 1000 for r in rows]
        for axis, score in zip(axes, ("rmse_db", "nll"), strict=True):
            values = [r[score] for r in rows]
            label = f"{name}, {lowest:g} m"
            axis.plot(samples, values, ".-", label=label, color=colour, linewidth=1.2, markersize=4)
    axes[0].set(xlabel="samples seen, thousands", ylabel="RMSE on T2, dB", title="error")
    axes[1].set(xlabel="samples seen, thousands", title="likelihood")
    axes[1].set_ylabel("NLL per cell on T2, nats")
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=7, loc="outside right upper")
    figure.savefig(IMAGES / "learning_curves.png", dpi=110)


def draw_policies(curves: dict[str, Found]) -> None:
    """Error at the end of the surveys flown in training, and their return."""
    figure, axes = pyplot().subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
    for name, curve in sorted(curves.items()):
        ended = [r for r in curve if "rmse_db" in r]
        if not ended:
            continue
        width = max(1, len(ended) // 15)
        for axis, score in zip(axes, ("rmse_db", "return"), strict=True):
            values = np.array([r[score] for r in ended])
            smooth = np.convolve(values, np.ones(width) / width, mode="valid")
            axis.plot([r["updates"] for r in ended][width - 1 :], smooth, label=name)
    axes[0].set(xlabel="updates", ylabel="RMSE at T, dB")
    axes[0].set_title("error at the end of surveys in training")
    axes[1].set(xlabel="updates", ylabel="return of a UAV")
    axes[1].set_title("return (recipes reward differently)")
    axes[0].legend(fontsize=7)
    figure.savefig(IMAGES / "policy_curves.png", dpi=110)
