"""The learning curves of the runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.record import RESULTS, Table
from benchmarks.study import Option, Run, study
from skygain.networks.weights import runs_folder

IMAGES = Path(__file__).parents[1] / "docs" / "images"
Found = list[dict[str, Any]]


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
