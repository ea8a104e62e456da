"""Runs a mission's command and kills it at random moments, then lets it end; a process of its own,
without threads, so that it can fork.

    python -m tests.robustness.killed FOLDER SHORTEST LONGEST SEED KILLS COMMAND [WORD ...]

COMMAND is plan, ingest (WORDs are logs), fly (links) or serve (a port, and at the end it is not let
to end but left to serve). Each line of the output is the wall time of a kill.
"""

from __future__ import annotations

import builtins
import os
import random
import signal
import sys
import time
from pathlib import Path

from skygain.app.progress import SILENT
from skygain.missions.commands import run_fly, run_ingest, run_plan, run_serve
from skygain.missions.requests import (
    MissionFlyRequest,
    MissionIngestRequest,
    MissionPlanRequest,
    MissionServeRequest,
)

PACE = 20.0
"""of the vehicles of a live flight"""


def run(folder: Path, command: str, words: tuple[str, ...]) -> None:
    """The command, in this process."""
    paths = tuple(map(Path, words))
    if command == "plan":
        run_plan(MissionPlanRequest(folder=folder), SILENT)
    elif command == "ingest":
        run_ingest(MissionIngestRequest(folder=folder, files=paths), SILENT)
    elif command == "fly":
        builtins.input = lambda *_: "yes"
        asked = MissionFlyRequest(folder=folder, link=paths, arm=True, pace=PACE)
        print(run_fly(asked, SILENT), flush=True)
    else:
        run_serve(MissionServeRequest(folder=folder, port=int(words[0])), SILENT)


def forked(folder: Path, command: str, words: tuple[str, ...]) -> int:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            run(folder, command, words)
            code = 0
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        finally:
            os._exit(code)
    return child


def main() -> None:
    folder, shortest, longest, seed, kills, command, *words = sys.argv[1:]
    rng = random.Random(int(seed))
    asked = (Path(folder), command, tuple(words))
    for _ in range(int(kills)):
        child = forked(*asked)
        time.sleep(rng.uniform(float(shortest), float(longest)))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        print(time.time(), flush=True)
    child = forked(*asked)
    if command == "serve":
        sys.stdin.read()  # until who started this has seen enough
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return
    _, status = os.waitpid(child, 0)
    sys.exit(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    main()
