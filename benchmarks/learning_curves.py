"""Learning curves of the predictors and policies, from the logs of their runs.

    python benchmarks/learning_curves.py [RUNS]

reads ``RUNS/*/log.jsonl`` (by default the user's cache), adds what it finds to
benchmarks/results/learning_curves.json, and draws all runs
known there: validation error and likelihood of predictors against samples seen
(docs/images/learning_curves.png), and what policies in training reached at the end of their surveys
against updates (docs/images/policy_curves.png). The table of the newest scores is printed and goes
to benchmarks/results/learning_curves.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from skygain.networks.weights import runs_folder

HERE = Path(__file__).parent
KEPT = (
    "step",
    "samples",
    "seconds",
    "rate",
    "updates",
    "return",
    "rmse_db",
    "q",
    "loss",
    "agreement",
    "transitions",
)
Curve = list[dict[str, float]]


def read(log: Path) -> Curve:
    """The records of a log that hold scores; of those made twice, after a kill, the later one."""
    records: dict[int, dict[str, float]] = {}
    for line in log.read_text(encoding="utf-8").splitlines():
        try:
            record = json.loads(line)
        except json.JSONDecodeError:  # the line that a kill cut off
            continue
        if any("@" in key for key in record) or "return" in record:
            records[record["step"]] = {k: v for k, v in record.items() if k in KEPT or "@" in k}
    return [records[step] for step in sorted(records)]


def draw_predictors(curves: dict[str, Curve], image: Path) -> None:
    """Error and likelihood on the validation cities against samples."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11.5, 3.8), layout="constrained")
    colours = plt.get_cmap("tab20").colors
    for colour, (name, curve) in zip(colours, curves.items(), strict=False):
        key = next(k for k in curve[0] if k.startswith("rmse_db@")).removeprefix("rmse_db@")
        samples = [r["samples"] / 1000 for r in curve]
        for axis, score in zip(axes, ("rmse_db", "nll"), strict=True):
            axis.plot(
                samples,
                [r[f"{score}@{key}"] for r in curve],
                label=f"{name}, {key} m",
                color=colour,
                linewidth=1.2,
                marker=".",
                markersize=4,
            )
    axes[0].set(xlabel="samples seen, thousands", ylabel="RMSE on T2, dB", title="error")
    axes[1].set(
        xlabel="samples seen, thousands", ylabel="NLL per cell on T2, nats", title="likelihood"
    )
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=7, loc="outside right upper")
    figure.savefig(image, dpi=110)


def draw_policies(curves: dict[str, Curve], image: Path) -> None:
    """Error at the end of the surveys flown in training, and their return."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
    for name, curve in curves.items():
        ended = [r for r in curve if "rmse_db" in r]
        if not ended:
            continue
        for axis, score in zip(axes, ("rmse_db", "return"), strict=True):
            values = np.array([r[score] for r in ended])
            width = max(1, len(values) // 15)
            smooth = np.convolve(values, np.ones(width) / width, mode="valid")
            axis.plot([r["updates"] for r in ended][width - 1 :], smooth, label=name)
    axes[0].set(
        xlabel="updates", ylabel="RMSE at T, dB", title="error at the end of surveys in training"
    )
    axes[1].set(
        xlabel="updates", ylabel="return of a UAV", title="return (recipes reward differently)"
    )
    axes[0].legend(fontsize=7)
    figure.savefig(image, dpi=110)


def markdown(curves: dict[str, Curve]) -> str:
    """The newest scores of every predictor's run."""
    lines = [
        "| run | altitude | samples | minutes | RMSE dB | ray-traced | rest | NLL | GoF | 90 % "
        "cover |",
        "|" + "---|" * 10,
    ]
    for name, curve in sorted(curves.items()):
        last = curve[-1]
        for key in (k.removeprefix("rmse_db@") for k in last if k.startswith("rmse_db@")):
            scores = [
                last[f"{s}@{key}"]
                for s in ("rmse_db", "rmse_traced_db", "rmse_rest_db", "nll", "gof", "cover90")
            ]
            lines.append(
                f"| {name} | {key} m | {last['samples']:,} | {last['seconds'] / 60:.0f} | "
                f"{scores[0]:.2f} | {scores[1]:.2f} | "
                f"{scores[2]:.2f} | {scores[3]:.3f} | {scores[4]:+.2f} | {100 * scores[5]:.1f} % |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="?", default=runs_folder(), type=Path)
    options = parser.parse_args()
    kept = HERE / "results" / "learning_curves.json"
    curves: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    for log in sorted(options.runs.glob("*/log.jsonl")):
        if curve := read(log):
            curves[log.parent.name] = curve
    lines = [f" {json.dumps(name)}: {json.dumps(curve)}" for name, curve in sorted(curves.items())]
    kept.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    predictors = {
        name: c
        for name, c in curves.items()
        if "samples" in c[0] and any(k.startswith("rmse_db@") for k in c[0])
    }
    policies = {name: c for name, c in curves.items() if "return" in c[0]}
    images = HERE.parent / "docs" / "images"
    if predictors:
        draw_predictors(predictors, images / "learning_curves.png")
    if policies:
        draw_policies(policies, images / "policy_curves.png")
    table = markdown(predictors)
    (HERE / "results" / "learning_curves.md").write_text(table, encoding="utf-8")
    print(table)


if __name__ == "__main__":
    main()
