"""Runs a mission's commands and kills them at random moments; a process of its own, without
threads, so that it can fork.

    python killed.py FOLDER SECONDS SEED KILLS COMMAND [LOG ...]
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from skygain.app.progress import SILENT
from skygain.missions.commands import run_ingest, run_plan
from skygain.missions.requests import MissionIngestRequest, MissionPlanRequest


def run(folder: Path, command: str, logs: tuple[Path, ...]) -> None:
    """The command, in this process."""
    if command == "plan":
        run_plan(MissionPlanRequest(folder=folder), SILENT)
    else:
        run_ingest(MissionIngestRequest(folder=folder, files=logs), SILENT)


def forked(folder: Path, command: str, logs: tuple[Path, ...]) -> int:
    child = os.fork()
    if child == 0:
        try:
            run(folder, command, logs)
        finally:
            os._exit(0)
    return child


def main() -> None:
    folder, longest, seed, kills, command, *logs = sys.argv[1:]
    rng = random.Random(int(seed))
    files = tuple(map(Path, logs))
    for _ in range(int(kills)):
        child = forked(Path(folder), command, files)
        time.sleep(rng.uniform(0.0, float(longest)))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    _, status = os.waitpid(forked(Path(folder), command, files), 0)
    sys.exit(status)


if __name__ == "__main__":
    main()
