"""How long a newcomer waits: from a fresh clone to the page of a first survey."""

from __future__ import annotations

import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.ground.errors import InputError

ROOT = Path(__file__).parents[1]
PAGE = Path("surveys/demo/report.html")
STAGES = (("make", ".venv/demo.stamp"), ("make", "demo"))
"""what is timed apart: the packages, and the flight with all that it compiles for the first time"""
FOREIGN = {"PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "NUMBA_CACHE_DIR", "VIRTUAL_ENV", "DISPLAY"}
FOREIGN |= {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONPYCACHEPREFIX"}
"""variables that a newcomer's shell does not have"""


@study(
    "first_minutes",
    before=Option("36eb975", "commit to compare with"),
    rounds=Option(3, "times that each is set up, in turn"),
)
def first_minutes(run: Run) -> list[Table]:
    """Seconds from a fresh clone to the page of `make demo`, beside an earlier commit.

    Each is cloned anew and fetches every package anew, without pip's cache; the two take turns.
    """
    builds = {name: commit(name) for name in (run.options.before, "HEAD")}
    times: dict[str, list[list[float]]] = {name: [] for name in builds}
    for k in range(run.options.rounds):
        for name, full in builds.items():
            times[name].append(run.once((full, k), lambda full=full: seconds_of(full)))
    medians = {
        name: [median(column) for column in zip(*rows, strict=True)] for name, rows in times.items()
    }
    first, last = medians.values()
    rows = [[name, *(f"{value:.0f}" for value in found)] for name, found in medians.items()]
    rows += [["ratio", *(f"{new / old:.2f}" for new, old in zip(last, first, strict=True))]]
    spread = {name: [wall for wall, *_ in found] for name, found in times.items()}
    title = (
        f"Fresh clone to the page of `make demo`, median of {run.options.rounds}, no package in a "
        "cache. Wall seconds from the least to the most: "
        + "; ".join(
            f"{name} {min(walls):.0f} to {max(walls):.0f}" for name, walls in spread.items()
        )
        + ". The machine did other work besides: CPU seconds are what does not depend on it."
    )
    head = ["build", "wall s", "CPU s", "packages, wall s", "packages, CPU s"]
    return [Table(title, [*head, "flight, wall s", "flight, CPU s"], rows)]


def commit(name: str) -> str:
    """The commit's full name."""
    found = subprocess.run(
        ["git", "rev-parse", "--verify", f"{name}^{{commit}}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if found.returncode:
        raise InputError(f"no commit {name!r} in this checkout; give another `before`")
    return found.stdout.strip()


def seconds_of(full: str) -> list[float]:
    """Wall and CPU seconds of both stages together, then of each."""
    kept = {key: value for key, value in os.environ.items() if key not in FOREIGN}
    plain = kept | {"PIP_NO_CACHE_DIR": "1"}
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "skygain"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        subprocess.run(["git", "checkout", "--quiet", full], cwd=clone, check=True)
        found = []
        for words in STAGES:
            wall, cpu = time.perf_counter(), cpu_of_children_s()
            with (clone / "log.txt").open("a") as log:
                subprocess.run(words, cwd=clone, env=plain, stdout=log, stderr=log, check=True)
            found += [time.perf_counter() - wall, cpu_of_children_s() - cpu]
        if not (clone / PAGE).exists():
            raise RuntimeError(f"{full} left no {PAGE}")
    return [found[0] + found[2], found[1] + found[3], *found]


def cpu_of_children_s() -> float:
    """CPU seconds of every child that has ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
