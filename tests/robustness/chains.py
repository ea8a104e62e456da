"""A command that is killed, given again and killed again until it ends, and then begun anew.

    python -m tests.robustness.chains COMMAND FOLDER SEED KILLS

A process of its own, without threads, so that it can fork: a try costs no start of Python, and no
import of what the first run imported. Every
death has to be a quiet one, what was kept before it has to be there after it, and every end has to
be that of a run left alone. Prints the kills by signal and the ends.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import random
import select
import shutil
import signal
import sys
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections import Counter
from pathlib import Path

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
SHARE = 0.8
"""of a run left alone, within which a kill comes"""


class Killable(ABC):
    """A command whose end is always the same."""

    signals = SIGNALS

    @abstractmethod
    def run(self, folder: Path) -> None:
        """Give the command, in this process: for the first time or again."""

    @abstractmethod
    def result(self, folder: Path) -> object:
        """What has to be the same after any death."""

    def kept(self, folder: Path) -> bytes:
        """What a death must not take away: it may only grow."""
        return b""

    def ended(self, folder: Path) -> bool:
        """Whether the folder shows that nothing is left to do."""
        return False


def given(*words: str | Path) -> None:
    """The command line with these words; ends in `SystemExit`."""
    from skygain.app.cli import main

    sys.argv = ["skygain", *map(str, words)]
    main()


def whole_lines(path: Path) -> bytes:
    """The lines of a journal that are complete."""
    with contextlib.suppress(OSError):
        content = path.read_bytes()
        return content[: content.rfind(b"\n") + 1]
    return b""


class SurveyCommand(Killable):
    asked = (
        "survey", "--city", "sample:9", "--predictor", "kriging-blind", "--planner",
        "random-waypoint", "--steps", "40", "--noise-db", "2",
    )  # fmt: skip

    def run(self, folder: Path) -> None:
        if whole_lines(folder / "flight.jsonl"):
            given("survey", "--resume", folder)
        given(*self.asked, "--out", folder, "--overwrite")

    def result(self, folder: Path) -> object:
        assert not [p for p in folder.iterdir() if p.name.startswith((".", "flight"))]
        scores = json.loads((folder / "results.json").read_text())["scores"]
        return (folder / "measurements.csv").read_bytes(), scores

    def kept(self, folder: Path) -> bytes:
        return whole_lines(folder / "flight.jsonl")

    def ended(self, folder: Path) -> bool:
        return (folder / "results.json").exists() and not (folder / "flight.jsonl").exists()


class EvaluateCommand(Killable):
    asked = (
        "evaluate", "--methods", "idw / lawnmower,knn / random-waypoint", "--max-surveys", "2",
        "--steps", "25", "--workers", "1", "--out",
    )  # fmt: skip

    def run(self, folder: Path) -> None:
        given(*self.asked, folder)

    def result(self, folder: Path) -> object:
        lines = map(json.loads, (folder / "rollouts.jsonl").read_text().splitlines()[1:])
        return {(line["case"], line["method"]): line["scores"] for line in lines}

    def kept(self, folder: Path) -> bytes:
        return whole_lines(folder / "rollouts.jsonl")


class BuildCommand(Killable):
    asked = ("dataset", "build", "--preset", "tiny", "--propagation", "gudmundson", "--out")

    def run(self, folder: Path) -> None:
        given(*self.asked, folder / "cities.zarr.zip")

    def result(self, folder: Path) -> object:
        assert [one.name for one in folder.iterdir()] == ["cities.zarr.zip"]
        return (folder / "cities.zarr.zip").read_bytes()

    def kept(self, folder: Path) -> bytes:
        cities = sorted(path.name for path in folder.glob("*.parts/city-*.zip"))
        return " ".join(cities).encode()

    def ended(self, folder: Path) -> bool:
        return [one.name for one in folder.iterdir()] == ["cities.zarr.zip"]


class Training(Killable):
    recipe: str

    def train(self, folder: Path) -> None:
        raise NotImplementedError

    def run(self, folder: Path) -> None:
        from skygain.app.commands import STOPPING
        from skygain.app.signals import Terminated, stopping
        from skygain.ground.errors import InputError
        from skygain.training.run import stop_runs

        try:
            with stopping(stop_runs, STOPPING):
                self.train(folder)
        except InputError as error:
            sys.exit(f"error: {error}")
        except Terminated as end:
            sys.exit(128 + end.number)
        sys.exit(0)

    def result(self, folder: Path) -> object:
        """Every array; the card of the weights tells the time taken, which is not the same."""
        from safetensors.numpy import load_file

        arrays = load_file(folder / f"{self.recipe}.safetensors")
        return {key: value.tobytes() for key, value in arrays.items()}


class PredictorTraining(Training):
    recipe = "unet"

    def train(self, folder: Path) -> None:
        from skygain.datasets.sample import SAMPLE
        from skygain.training import train_predictor

        train_predictor(
            self.recipe, SAMPLE, folder, finish=6, batch_size=2, workers=1, validation_samples=4,
            checkpoint_seconds=0.0, validate_steps=2, bf16=False,
        )  # fmt: skip


class PolicyTraining(Training):
    recipe = "dqn-rewards-only"

    def train(self, folder: Path) -> None:
        from skygain.datasets.sample import SAMPLE
        from skygain.training.policies.recipes import train_policy

        train_policy(
            self.recipe, SAMPLE, folder, total_steps=60, side=32, predictor="idw", split="T1",
            steps=8, lanes=2, n_uavs=2, warmup=24, capacity=80, batch_size=8, learn_every=2,
            checkpoint_steps=5, log_steps=5, bf16=False,
        )  # fmt: skip


COMMANDS: dict[str, type[Killable]] = {
    "survey": SurveyCommand,
    "evaluate": EvaluateCommand,
    "build": BuildCommand,
    "predictor": PredictorTraining,
    "policy": PolicyTraining,
}


def tried(
    command: Killable,
    folder: Path,
    log: Path,
    kill: tuple[int, float] | None = None,
    modules: Path | None = None,
) -> int | None:
    """Give the command once; ``kill`` is a signal and the seconds until it is sent. The file
    ``modules`` becomes a list of what was imported.

    Returns:
        The signal that was sent before the end, if one was.
    """
    child = os.fork()
    if child == 0:
        code: object = 1
        try:
            with log.open("w") as told:
                os.dup2(told.fileno(), 1)
                os.dup2(told.fileno(), 2)
            command.run(folder)
        except SystemExit as end:
            code = end.code or 0
            if isinstance(code, str):
                print(code, file=sys.stderr, flush=True)
                code = 1
        except KeyboardInterrupt:
            code = 128 + signal.SIGINT
        except BaseException:
            traceback.print_exc()
        finally:
            if modules:
                modules.write_text("\n".join(name for name in sys.modules if "main" not in name))
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(int(code))  # type: ignore[call-overload]
    sent = None
    if kill:
        handle = os.pidfd_open(child)
        if not select.select([handle], [], [], kill[1])[0]:
            os.kill(child, kill[0])
            sent = kill[0]
        os.close(handle)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    text = log.read_text() if log.exists() else ""
    allowed = (0,) if sent is None else (0, -sent, 128 + sent)
    if code not in allowed or "Traceback" in text:
        raise AssertionError(f"ended with {code} after signal {sent}:\n{text[-3000:]}")
    return sent


def main(name: str, place: str, seed: str, kills: str) -> None:
    command, rng = COMMANDS[name](), random.Random(int(seed))
    top, log = Path(place), Path(place) / "log.txt"
    tried(command, made(top / "first"), log, modules=top / "modules.txt")
    for module in (top / "modules.txt").read_text().splitlines():
        with contextlib.suppress(Exception):  # some can only be imported from others
            importlib.import_module(module)
    began = time.monotonic()
    tried(command, made(top / "whole"), log)
    longest = SHARE * (time.monotonic() - began)
    whole = command.result(top / "whole")
    assert command.result(top / "first") == whole, "two runs left alone differ"
    sent, ends, folder = Counter[str](), 0, made(top / "killed")
    while sum(sent.values()) < int(kills) or folder.exists():
        before, kill = command.kept(folder), None
        if sum(sent.values()) < int(kills):
            kill = (rng.choice(command.signals), rng.uniform(0.0, longest))
        number = tried(command, folder, log, kill)
        if number is not None:
            sent[signal.Signals(number).name] += 1
        if number is None or command.ended(folder):
            assert command.result(folder) == whole, "another end than that of a run left alone"
            shutil.rmtree(folder)
            ends += 1
            if sum(sent.values()) < int(kills):
                made(folder)
        else:
            assert command.kept(folder).startswith(before), "what was kept is gone"
    told = ", ".join(f"{count} {one}" for one, count in sorted(sent.items()))
    assert threading.active_count() == 1, threading.enumerate()
    print(f"{name}: {sum(sent.values())} kills ({told}), {ends} ends, all the same")


def made(folder: Path) -> Path:
    folder.mkdir()
    return folder


if __name__ == "__main__":
    main(*sys.argv[1:])
