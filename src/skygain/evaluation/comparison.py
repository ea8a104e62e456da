"""Many surveys, several methods, one paired table.

Each (case, method) pair is an independent rollout, flown in a worker process. Its result is a line
of ``rollouts.jsonl`` as soon as it is there, and a run that was killed goes on where it stopped.
Rollouts are deterministic: neither the number of workers nor an interruption changes the table.
"""

from __future__ import annotations

__all__ = ["Comparison", "compare"]

import json
import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.rollout import rollout
from skygain.ground.errors import InputError
from skygain.ground.executor import process_pool
from skygain.ground.files import writable_folder
from skygain.survey.methods import MethodSpec

if TYPE_CHECKING:
    from skygain.datasets.cases import Case

Progress = Callable[[int, int, str], None]
"""told (rollouts done, rollouts in all, label of the last one)"""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The scores of every method in every case; row ``i`` of each array is the same case for every
    method."""

    request: EvaluateRequest
    """what was compared"""
    steps: list[int]
    """steps at which scores were taken"""
    cities: NDArray[np.int64]
    """``[case]`` city of each case, for resampling"""
    scores: dict[str, dict[str, NDArray[np.float64]]]
    """``scores[method label][score name][case, step]``"""
    delays: dict[str, dict[str, NDArray[np.float64]]]
    """``delays[method label][delay name][case]`` in milliseconds"""


@lru_cache(maxsize=2)
def _cases(request: EvaluateRequest) -> list[Case]:
    from skygain.datasets.cases import survey_cases
    from skygain.datasets.sample import open_sample
    from skygain.datasets.store import ChannelDataset

    dataset = open_sample() if request.data == "sample" else ChannelDataset.open(request.data)
    return survey_cases(
        dataset,
        request.split,
        n_uavs=request.uavs,
        start=request.start,
        altitude_m=request.altitude_m,
        max_surveys=request.max_surveys,
        seed=request.seed,
        crop_shape=(request.crop, request.crop) if request.crop else dataset.grid.shape,
    )


def _run(request: EvaluateRequest, index: int, method: MethodSpec) -> dict[str, Any]:
    """One rollout, in a worker process."""
    case = _cases(request)[index]
    outcome = rollout(
        case,
        method,
        steps=request.steps,
        record_steps=request.record_steps,
        rules=request.rules,
        noise_db=request.noise_db,
    )
    return {"case": case.link, "city": case.city_index, "method": method.label, **outcome}


def _read_lines(path: Path) -> list[dict[str, Any]]:
    """The complete lines of a journal; a last line cut off by a kill is dropped from the file
    too."""
    if not path.exists():
        return []
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    return [json.loads(line) for line in whole.splitlines()]


def compare(request: EvaluateRequest, progress: Progress | None = None) -> Comparison:
    """Fly every method in every case, going on from ``rollouts.jsonl`` when ``out`` holds it.

    Raises:
        InputError: unknown names, unreadable data, or rollouts in ``out`` that belong to another
            comparison.
    """
    methods = request.pairs
    for method in methods:
        method.build_predictor()
        method.build_planner()
    cases = _cases(request)
    journal = writable_folder(request.out) / "rollouts.jsonl"
    done: dict[tuple[int, str], dict[str, Any]] = {}
    for line in _read_lines(journal):
        if line["fingerprint"] != request.fingerprint:
            raise InputError(
                f"{journal} holds rollouts of another comparison; give another `out` or delete "
                "that file"
            )
        done[line["case"], line["method"]] = line
    missing = [
        (i, m) for i in range(len(cases)) for m in methods if (cases[i].link, m.label) not in done
    ]
    total, count = len(cases) * len(methods), len(cases) * len(methods) - len(missing)
    workers = min(request.workers or os.cpu_count() or 1, max(1, len(missing)))
    with journal.open("a") as sink:

        def keep(line: dict[str, Any]) -> None:
            nonlocal count
            line = {"fingerprint": request.fingerprint, **line}
            sink.write(json.dumps(line) + "\n")
            sink.flush()
            done[line["case"], line["method"]] = line
            count += 1
            if progress:
                progress(count, total, line["method"])

        if missing:
            with process_pool(workers) as pool:
                queue = iter(missing)
                running: set[Future[dict[str, Any]]] = set()
                while True:
                    for index, method in queue:
                        running.add(pool.submit(_run, request, index, method))
                        if len(running) >= 2 * workers:
                            break
                    if not running:
                        break
                    finished, running = wait(running, return_when=FIRST_COMPLETED)
                    for future in finished:
                        keep(future.result())
    return _collected(request, cases, done)


def _collected(
    request: EvaluateRequest, cases: list[Case], done: dict[tuple[int, str], dict[str, Any]]
) -> Comparison:
    scores: dict[str, dict[str, NDArray[np.float64]]] = {}
    delays: dict[str, dict[str, NDArray[np.float64]]] = {}
    for method in request.pairs:
        rows = [done[case.link, method.label] for case in cases]
        scores[method.label] = {
            name: np.array([r["scores"][name] for r in rows], dtype=float)
            for name in rows[0]["scores"]
        }
        delays[method.label] = {
            name: np.array([r["delays"][name] for r in rows], dtype=float)
            for name in rows[0]["delays"]
        }
    cities = np.array([case.city_index for case in cases], dtype=np.int64)
    return Comparison(request, request.record_steps, cities, scores, delays)
