"""A comparison as a table for people (Markdown) and for programs (JSON)."""

from __future__ import annotations

__all__ = ["comparison_json", "comparison_markdown", "curve_intervals"]

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from skygain.evaluation.comparison import Comparison
from skygain.evaluation.statistics import Interval, bootstrap_mean, flight_saved


def _milestones(steps: list[int]) -> list[int]:
    """Indices of the columns to print: the steps nearest to a quarter, half and all of the
    survey."""
    wanted = [steps[-1] / 4, steps[-1] / 2, steps[-1]]
    return sorted({int(np.argmin([abs(s - w) for s in steps])) for w in wanted})


def curve_intervals(
    comparison: Comparison, score: str = "rmse_db"
) -> dict[str, tuple[list[int], list[float], list[float], list[float]]]:
    """``{label: (steps, mean, low, high)}`` of a score over the recorded steps, for the figure."""
    curves = {}
    for label, named in comparison.scores.items():
        at = [
            bootstrap_mean(named[score][:, k], comparison.cities)
            for k in range(len(comparison.steps))
        ]
        curves[label] = (
            comparison.steps,
            [i.mean for i in at],
            [i.low for i in at],
            [i.high for i in at],
        )
    return curves


def _final(comparison: Comparison, label: str, score: str) -> Interval:
    return bootstrap_mean(comparison.scores[label][score][:, -1], comparison.cities)


def _final_text(comparison: Comparison, label: str, score: str) -> str:
    """Mean of a score at the end, or a dash where no survey has cells to take it over."""
    values = comparison.scores[label].get(score)
    known = values is not None and np.isfinite(values[:, -1]).any()
    return f"{_final(comparison, label, score).mean:.2f}" if known else "–"


def _paired(
    comparison: Comparison, label: str, reference: str, k: int, score: str = "rmse_db"
) -> Interval:
    """Difference of a score, ``label`` minus ``reference``, survey by survey."""
    difference = comparison.scores[label][score][:, k] - comparison.scores[reference][score][:, k]
    return bootstrap_mean(difference, comparison.cities)


def _mean_curve(comparison: Comparison, label: str) -> np.ndarray:
    return np.nanmean(comparison.scores[label]["rmse_db"], axis=0)


def _flight_rows(comparison: Comparison) -> list[tuple[str, str, str, float]]:
    """(predictor, planner, rival planner, flight saved) for planners that share a predictor."""
    rows = []
    for predictor, planners in _planners_of(comparison).items():
        for ours in planners:
            for rival in planners:
                if ours != rival:
                    mine, theirs = (
                        _mean_curve(comparison, f"{predictor} / {p}") for p in (ours, rival)
                    )
                    rows.append(
                        (predictor, ours, rival, flight_saved(comparison.steps, mine, theirs))
                    )
    return rows


def _planners_of(comparison: Comparison) -> dict[str, list[str]]:
    """The planners that each predictor was flown by."""
    planners: dict[str, list[str]] = {}
    for method in comparison.request.pairs:
        planners.setdefault(method.predictor, []).append(method.planner)
    return planners


def _gof(comparison: Comparison, label: str) -> float:
    """Log of the error ratio averaged over all surveys."""
    ratio = float(np.nanmean(comparison.scores[label]["error_ratio"][:, -1]))
    return math.log(ratio) if ratio > 0 else math.nan


def comparison_markdown(comparison: Comparison) -> str:
    """The tables: error along the way, error and calibration at the end, paired differences, flight
    saved, delays."""
    asked, labels, steps = comparison.request, list(comparison.scores), comparison.steps
    shown = _milestones(steps)
    n, n_cities = len(comparison.cities), len(np.unique(comparison.cities))
    rows, cols = comparison.window
    window = f"{'windows' if asked.crop else 'whole maps'} of {rows} × {cols} cells"
    lines = [
        f"{n} surveys in {n_cities} cities of {asked.split}, {window}, {asked.uavs} UAVs, start "
        f"{asked.start}, {asked.steps} steps, "
        f"altitude {asked.altitude_m:g} m, noise {asked.noise_db:g} dB, seed {asked.seed}. "
        "RMSE in dB over unvisited outdoor cells; brackets: 95 % bootstrap interval over cities.",
        "",
        "| predictor / planner | "
        + " | ".join(f"RMSE T={steps[k]}" for k in shown)
        + " | all cells | ray-traced | rest |",
        "|---|" + "---|" * (len(shown) + 3),
    ]
    for label in labels:
        cells = [
            str(bootstrap_mean(comparison.scores[label]["rmse_db"][:, k], comparison.cities))
            for k in shown
        ]
        extra = [
            _final_text(comparison, label, name)
            for name in ("rmse_all_db", "rmse_ray_traced_db", "rmse_rest_db")
        ]
        lines.append(f"| {label} | " + " | ".join(cells + extra) + " |")
    lines += [
        "",
        f"Calibration at T={steps[-1]}, and delay (median / 95th percentile, ms, mean over "
        "surveys).",
        "",
        "| predictor / planner | GoF | NLL | CRPS dB | cover 50 % | cover 90 % | per decision | "
        "per planned step | belief update |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for label in labels:
        values = [
            _final(comparison, label, name).mean
            for name in ("nll", "crps_db", "coverage50", "coverage90")
        ]
        delay = comparison.delays[label]
        lines.append(
            f"| {label} | {_gof(comparison, label):+.2f} | {values[0]:.2f} | {values[1]:.2f} | "
            f"{values[2]:.1%} | {values[3]:.1%} | "
            + " | ".join(
                f"{np.nanmean(delay[f'{part}_ms_median']):.2f} / "
                f"{np.nanmean(delay[f'{part}_ms_p95']):.2f}"
                for part in ("decision", "planned_step", "update")
            )
            + " |"
        )
    if len(labels) > 1:
        lines += [
            "",
            f"Paired difference of RMSE (row minus {labels[0]}), dB; below 0 is better.",
            "",
            "| predictor / planner | " + " | ".join(f"T={steps[k]}" for k in shown) + " |",
            "|---|" + "---|" * len(shown),
        ]
        for label in labels[1:]:
            cells = [_signed(_paired(comparison, label, labels[0], k)) for k in shown]
            lines.append(f"| {label} | " + " | ".join(cells) + " |")
    several = {
        predictor: planners
        for predictor, planners in _planners_of(comparison).items()
        if len(planners) > 1
    }
    for predictor, planners in several.items():
        lines += _paired_planners(
            comparison,
            predictor,
            planners,
            sorted({shown[-2], shown[-1]}) if len(shown) > 1 else shown,
        )
    if several:
        lines += [
            "",
            f"Flight saved: {steps[-1]} steps divided by the steps a planner needs for the error "
            f"its rival (column) has at T={steps[-1]}.",
        ]
        for predictor, planners in several.items():
            saved = {(a, b): ratio for p, a, b, ratio in _flight_rows(comparison) if p == predictor}
            lines += [
                "",
                f"| {predictor} | " + " | ".join(planners) + " |",
                "|---|" + "---|" * len(planners),
            ]
            for ours in planners:
                row = ["–" if ours == b else _times(saved[ours, b]) for b in planners]
                lines.append(f"| {ours} | " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"


def _paired_planners(
    comparison: Comparison, predictor: str, planners: list[str], steps: list[int]
) -> list[str]:
    """Tables of the paired differences between planners of one predictor, at the recorded
    ``steps``."""
    lines: list[str] = []
    for k in steps:
        lines += [
            "",
            f"Paired difference of RMSE at T={comparison.steps[k]} between planners (row minus "
            "column), dB.",
            "",
        ]
        lines += [
            f"| {predictor} | " + " | ".join(planners[:-1]) + " |",
            "|---|" + "---|" * (len(planners) - 1),
        ]
        for i, planner in enumerate(planners[1:], 1):
            cells = [
                _signed(_paired(comparison, f"{predictor} / {planner}", f"{predictor} / {p}", k))
                for p in planners[:i]
            ]
            lines.append(
                f"| {planner} | " + " | ".join(cells + [""] * (len(planners) - 1 - i)) + " |"
            )
    return lines


def _signed(interval: Interval) -> str:
    return interval.text("+.2f")


def _times(ratio: float) -> str:
    return f"{ratio:.2f}×" if math.isfinite(ratio) else "not reached"


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Everything in the tables, and the paired difference of every two methods, as plain data."""
    labels, steps = list(comparison.scores), comparison.steps
    methods = {}
    for label in labels:
        curve = {
            name: [
                asdict(bootstrap_mean(values[:, k], comparison.cities)) for k in range(len(steps))
            ]
            for name, values in comparison.scores[label].items()
        }
        delay = {
            name: float(np.nanmean(values)) for name, values in comparison.delays[label].items()
        }
        methods[label] = {"scores": curve, "gof": _gof(comparison, label), "delays": delay}
    kinds = [
        name
        for name in ("rmse_db", "rmse_ray_traced_db", "rmse_rest_db")
        if all(name in comparison.scores[a] for a in labels)
    ]
    paired = [
        {"method": a, "minus": b}
        | {n: [asdict(_paired(comparison, a, b, k, n)) for k in range(len(steps))] for n in kinds}
        for i, a in enumerate(labels)
        for b in labels[:i]
    ]
    saved = [
        {"predictor": p, "planner": a, "rival": b, "flight_saved": ratio}
        for p, a, b, ratio in _flight_rows(comparison)
    ]
    return {
        "config": {
            **comparison.request.stored(),
            "data": Path(comparison.request.data).name,
        },  # no folder of this machine
        "surveys": len(comparison.cities),
        "cities": len(np.unique(comparison.cities)),
        "steps": steps,
        "methods": methods,
        "paired": paired,
        "flight_saved": saved,
    }
