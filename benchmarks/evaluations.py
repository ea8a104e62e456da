"""Comparisons of methods that `skygain evaluate` flies; evaluations.toml has their arguments."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.record import RESULTS, Record, Table, parsed
from benchmarks.study import JOURNALS, Option, Run, machine, study

LIST = Path(__file__).with_name("evaluations.toml")
IMAGES = Path(__file__).parents[1] / "docs" / "images"
COMMAND_LINE = "from skygain.app.cli import main; main()"
STEPS = (50, 100, 200)
SCORES = ("rmse_db", "rmse_ray_traced_db", "rmse_rest_db", "coverage90")


def entries() -> dict[str, dict[str, Any]]:
    """What evaluations.toml says, by the name of the record."""
    return tomllib.loads(LIST.read_text(encoding="utf-8"))


def parts(name: str) -> dict[str, list[str]]:
    """Arguments of ``skygain evaluate`` for each part of an evaluation; most have one, called
    ``""``."""
    entry = entries()[name]
    common = shlex.split(entry["arguments"])
    if "methods" in entry:
        common += ["--methods", ", ".join(entry["methods"])]
    return {
        title: common + shlex.split(arguments)
        for title, arguments in entry.get("parts", {"": ""}).items()
    }


def command(name: str) -> str:
    """What prints the tables of an evaluation."""
    return f"python -m benchmarks evaluations DATA --only {name}"


def kept(results: dict[str, Any]) -> dict[str, Any]:
    """Of a comparison's ``results.json``, the numbers that tables of the documents need."""
    at = [k for k, step in enumerate(results["steps"]) if step in STEPS]

    def brief(value: float | None) -> float | None:
        return None if value is None else round(value, 5)

    def short(curve: list[dict[str, float | None]]) -> list[Any]:
        return [[brief(curve[k][name]) for name in ("mean", "low", "high")] for k in at]

    methods = {}
    for label, entry in results["methods"].items():
        scores = {name: short(entry["scores"][name]) for name in SCORES if name in entry["scores"]}
        methods[label] = {"scores": scores, "gof": brief(entry["gof"])}
    paired = [
        {"method": p["method"], "minus": p["minus"]}
        | {name: short(p[name]) for name in SCORES if name in p}
        for p in results["paired"]
    ]
    saved = [row | {"flight_saved": brief(row["flight_saved"])} for row in results["flight_saved"]]
    steps = [results["steps"][k] for k in at]
    return {"steps": steps, "methods": methods, "paired": paired, "flight_saved": saved}


@study(
    "evaluations",
    data="DATA",
    only=Option((), "names in evaluations.toml; all by default"),
    extra=Option("", "arguments added to every comparison, such as '--max-surveys 2'"),
)
def evaluations(run: Run) -> list[Table]:
    """Fly the comparisons of benchmarks/evaluations.toml, each with a record of its own name.

    A comparison that was killed goes on. The figure goes to docs/images where a page shows it.
    """
    for name in run.options.only or entries():
        tables: list[Table] = []
        numbers: dict[str, Any] = {}
        for title, arguments in parts(name).items():
            folder = JOURNALS / name / title.replace(" ", "-").replace(",", "")
            words = [sys.executable, "-c", COMMAND_LINE, "evaluate"]
            words += ["--data", str(run.data), "--out", str(folder), *arguments]
            subprocess.run([*words, *shlex.split(run.options.extra)], check=True)
            found = json.loads((folder / "results.json").read_text(encoding="utf-8"))
            tables += [replace(table, part=title) for table in parsed(found["table"])]
            if not title:
                numbers = kept(found)
                figure = IMAGES / f"{name}.png"
                if figure.exists() and run.options.results == RESULTS:
                    shutil.copy(folder / "rmse_vs_steps.png", figure)
        record = Record(name, command(name), tables, run.data.name, machine(), numbers)
        record.write(run.options.results)
        print(f"{name}: {len(tables)} tables", flush=True)
    return []
