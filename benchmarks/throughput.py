"""How many surveys `skygain evaluate` flies a minute, and what a second process adds."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.evaluations import COMMAND_LINE
from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.ground.errors import InputError
from skygain.survey.methods import MethodSpec

METHODS = ("kriging / sequential-greedy", "operator / lookahead", "paper-unet / dqn")
WORKERS = (1, 2)
SHORT = 20
"""steps of the survey that compiles"""


@study(
    "throughput",
    data="DATA",
    methods=Option(METHODS, "methods, each by itself"),
    split=Option("T4", "split of the data"),
    surveys=Option(8, "surveys of each method"),
    steps=Option(200, "steps of a survey"),
    rounds=Option(2, "times that one process and two take turns"),
)
def throughput(run: Run) -> list[Table]:
    """Surveys per minute of `skygain evaluate`, and CPU seconds per survey, with one process and
    two.

    Whole commands are timed: start, surveys, tables and figure, after a short one that compiles.
    One process and two take turns; medians. What the wall clock says holds for an idle machine
    alone; so the other processes' load is told, and CPU seconds stand beside it.
    """
    o, rows, loads = run.options, [], []
    if min(o.surveys, o.steps, o.rounds) < 1:
        raise InputError("--surveys, --steps and --rounds must be 1 or more")
    for label in (MethodSpec.of_label(text).label for text in o.methods):
        found = []
        for turn in range(o.rounds):
            for workers in WORKERS:
                command = label, o.split, o.surveys, o.steps, workers
                found.append(
                    run.once(
                        (*command, turn), lambda c=command, t=turn: timed(run.data, *c, t == 0)
                    )
                )
        wall, cpu, load = np.array(found).reshape(o.rounds, len(WORKERS), 3).transpose(2, 0, 1)
        loads.append(load)
        wall, cpu = np.median(wall, axis=0), np.median(cpu, axis=0)  # [workers]
        rate = 60.0 * o.surveys / wall
        row = [label, *(f"{c / o.surveys:.2f}" for c in cpu), f"{cpu[1] / cpu[0]:.2f}"]
        rows.append([*row, *(f"{a:.1f}" for a in rate), f"{rate[1] / rate[0]:.2f}"])
    title = (
        f"{o.surveys} surveys of {o.split}, T = {o.steps}, N = 3; {np.max(loads):.1f} other "
        "processes were waiting for a core at the most when a command began."
    )
    head = ["predictor / planner", "CPU s per survey, 1 process", "2 processes", "2 over 1"]
    head += ["surveys a minute, 1 process", "2 processes", "2 over 1"]
    return [Table(title, head, rows)]


def timed(
    data: Path, method: str, split: str, surveys: int, steps: int, workers: int, first: bool
) -> list[float]:
    """(wall seconds, CPU seconds, load of the machine before) of one command with all its
    processes; the first of a method follows one that compiles."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["evaluate", "--methods", method, "--data", str(data), "--split", split]
        if first:
            _fly([*words, "--max-surveys", "1", "--steps", str(SHORT), "--out", f"{folder}/short"])
        words += ["--max-surveys", str(surveys), "--steps", str(steps)]
        load, used, begun = os.getloadavg()[0], _children_s(), time.perf_counter()
        _fly([*words, "--workers", str(workers), "--out", f"{folder}/long"])
        return [time.perf_counter() - begun, _children_s() - used, load]


def _fly(words: list[str]) -> None:
    command = [sys.executable, "-c", COMMAND_LINE, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"skygain {' '.join(words)} failed: {done.stderr.strip()[-400:]}")


def _children_s() -> float:
    """CPU seconds of all processes that this one has waited for, and of theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
