"""Many surveys, several methods, one paired table.

Each (case, method) pair is an independent rollout, flown in a worker process or on a cluster. Its
result is a line of the journal ``rollouts.jsonl`` as soon as it is there, and a run that was killed
goes on where it stopped. The journal belongs to the content of the data, the settings, the release
and the weights. Rollouts are deterministic: neither the number of workers nor an interruption
changes the table.
"""

from __future__ import annotations

__all__ = ["JOURNAL", "Comparison", "Watch", "compare", "request_cases"]

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import skygain
from skygain.evaluation.request import EvaluateRequest
from skygain.evaluation.rollout import Observer, rollout
from skygain.ground.errors import InputError
from skygain.ground.executor import units
from skygain.ground.files import file_digest, writable_folder
from skygain.ground.journal import Journal
from skygain.survey.methods import MethodSpec
from skygain.survey.origins import method_files

if TYPE_CHECKING:
    from skygain.datasets.cases import Case
    from skygain.datasets.store import ChannelDataset

JOURNAL = "rollouts.jsonl"
"""name of the file that keeps the rollouts"""
Progress = Callable[[int, int, str], None]
"""told (rollouts done, rollouts in all, label of the last one)"""
Watch = Callable[["Case", MethodSpec], Observer]
"""makes, in the process that flies it, what a rollout shows itself to at every recorded step"""


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
    window: tuple[int, int]
    """rows and columns of the maps that were surveyed"""
    links: NDArray[np.int64]
    """``[case]`` link of each case in the data set"""
    scores: dict[str, dict[str, NDArray[np.float64]]]
    """``scores[method label][score name][case, step]``"""
    delays: dict[str, dict[str, NDArray[np.float64]]]
    """``delays[method label][delay name][case]`` in milliseconds"""
    by_gain: dict[str, dict[str, NDArray[np.float64]]]
    """``by_gain[method label][name][case, bin]``, see `skygain.evaluation.metrics.by_gain`; without
    methods whose rollouts an earlier release flew"""


def request_cases(request: EvaluateRequest) -> tuple[ChannelDataset, list[Case]]:
    """The data set and the surveys of a comparison.

    Raises:
        InputError: unreadable data, or it has no such surveys.
    """
    from skygain.datasets.cases import survey_cases
    from skygain.datasets.sample import open_sample
    from skygain.datasets.store import ChannelDataset

    dataset = open_sample() if request.data == "sample" else ChannelDataset.open(request.data)
    rows, cols = dataset.grid.shape
    side = request.crop or max(rows, cols)
    cases = survey_cases(
        dataset,
        request.split,
        n_uavs=request.uavs,
        start=request.start,
        altitude_m=request.altitude_m,
        max_surveys=request.max_surveys,
        seed=request.seed,
        crop_shape=(min(side, rows), min(side, cols)),
    )
    return dataset, cases


def _run(
    request: EvaluateRequest, case: Case, method: MethodSpec, watch: Watch | None
) -> dict[str, Any]:
    """One rollout, in a worker process."""
    outcome = rollout(
        case,
        method,
        steps=request.steps,
        record_steps=request.record_steps,
        rules=request.rules,
        noise_db=request.noise_db,
        observe=watch(case, method) if watch else None,
    )
    told = {"case": case.link, "city": case.city_index, "method": method.label, **outcome}
    return told | {"files": _files(method)}


_files = cache(method_files)


def _demand_same_files(line: dict[str, Any], files: dict[str, str]) -> None:
    """Another machine may hold other weights."""
    if line["files"] == files:
        return
    names = {*files, *line["files"]}
    changed = sorted(n for n in names if files.get(n) != line["files"].get(n))
    raise InputError(
        f"a worker flew {line['method']!r} with other files than lie here ({', '.join(changed)}); "
        "give every machine the same"
    )


def compare(
    request: EvaluateRequest, progress: Progress | None = None, watch: Watch | None = None
) -> Comparison:
    """Fly every method in every case, going on from ``rollouts.jsonl`` when ``out`` holds it.

    Args:
        request: what is compared.
        progress: see `Progress`.
        watch: sees every rollout that is flown now; it is sent to the workers.

    Raises:
        InputError: unknown names, unreadable data, or rollouts in ``out`` of other data, settings,
            weights or another release.
    """
    methods = request.pairs
    files = {method.label: method_files(method) for method in methods}
    dataset, cases = request_cases(request)
    belongs_to = request.settings | {
        "data": file_digest(dataset.path),
        "skygain": skygain.__version__,
    }
    path = writable_folder(request.out) / JOURNAL
    anew = f"delete {path} or give another `out`"
    with Journal(path, belongs_to, anew=anew) as journal:
        done = _flown_before(journal, files, len(request.record_steps), anew)
        pairs = [(case, method) for case in cases for method in methods]
        missing = [(c, m) for c, m in pairs if (c.link, m.label) not in done]
        count = len(pairs) - len(missing)
        workers = min(request.workers or os.cpu_count() or 1, max(1, len(missing)))
        jobs = [(request, case, method, watch) for case, method in missing]
        with closing(units(_run, jobs, workers=workers, cluster=request.cluster)) as flown:
            for line in flown if jobs else ():
                _demand_same_files(line, files[line["method"]])
                journal.append(line)
                done[line["case"], line["method"]] = line
                count += 1
                if progress:
                    progress(count, len(pairs), line["method"])
    return _collected(request, cases, done)


def _flown_before(
    journal: Journal, files: dict[str, dict[str, str]], n_scores: int, anew: str
) -> dict[tuple[int, str], dict[str, Any]]:
    """The rollouts that the journal holds, by case and method; those of methods that are not asked
    for now may have had other weights."""
    done = {}
    for number, line in enumerate(journal.records, start=2):
        try:
            case, method = int(line["case"]), str(line["method"])
            whole = all(len(values) == n_scores for values in line["scores"].values())
            if not (whole and line["scores"] and line["delays"]):
                raise ValueError
            before = dict(line["files"])
        except (KeyError, TypeError, ValueError, AttributeError):
            raise InputError(
                f"line {number} of {journal.path} is no rollout of this comparison; to begin "
                f"anew, {anew}"
            ) from None
        now = files.get(method, before)
        if now != before:
            changed = sorted(n for n in {*now, *before} if now.get(n) != before.get(n))
            raise InputError(
                f"{journal.path} holds surveys of {method!r} with other files: "
                f"{', '.join(changed)} changed; to begin anew, {anew}"
            )
        done[case, method] = line
    return done


def _collected(
    request: EvaluateRequest, cases: list[Case], done: dict[tuple[int, str], dict[str, Any]]
) -> Comparison:
    scores: dict[str, dict[str, NDArray[np.float64]]] = {}
    delays: dict[str, dict[str, NDArray[np.float64]]] = {}
    by_gain: dict[str, dict[str, NDArray[np.float64]]] = {}
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
        if all("by_gain" in r for r in rows):
            by_gain[method.label] = {
                name: np.array([r["by_gain"][name] for r in rows], dtype=float)
                for name in rows[0]["by_gain"]
            }
    cities, links = (
        np.array([getattr(case, name) for case in cases], dtype=np.int64)
        for name in ("city_index", "link")
    )
    return Comparison(
        request, request.record_steps, cities, cases[0].shape, links, scores, delays, by_gain
    )
