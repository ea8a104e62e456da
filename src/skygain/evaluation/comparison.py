"""Many surveys, several methods, one paired table.

Each (case, method) pair is an independent rollout. They run in worker processes, each result is a
line of ``rollouts.jsonl`` as
soon as it is there, and a run that was killed goes on where it stopped: lines already written are
not flown again. Rollouts are deterministic, so neither the number of workers nor an interruption
changes the table.
"""

from __future__ import annotations

__all__ = ["Comparison", "ComparisonConfig", "compare"]

import hashlib
import json
import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.rollout import rollout
from skygain.flight.swarm import FlightRules
from skygain.ground.errors import InputError
from skygain.ground.executor import process_pool
from skygain.ground.files import writable_folder
from skygain.survey.methods import MethodSpec

if TYPE_CHECKING:
    from skygain.datasets.cases import Case

Progress = Callable[[int, int, str], None]
"""told (rollouts done, rollouts in all, label of the last one)"""


@dataclass(frozen=True)
class ComparisonConfig:
    """What is compared, where, and how."""

    predictors: tuple[str, ...]
    """predictor texts, see `MethodSpec`"""
    planners: tuple[str, ...]
    """planner texts; every predictor flies with every planner"""
    data: str
    """path of the data set, or ``"sample"`` for the one that ships with the package"""
    split: str = "T4"
    """T1, T2, T3 or T4"""
    uavs: int = 3
    """how many UAVs"""
    steps: int = 200
    """steps per UAV"""
    start: str = "cluster"
    """``"cluster"`` or ``"spread"``"""
    altitude_m: float = 10.0
    """altitude of flight and prediction"""
    max_surveys: int | None = None
    """at most this many surveys, spread evenly over the cities; ``None`` flies one per transmitter
    of the split"""
    crop: int = 96
    """side in cells of the random window that is surveyed; 0 takes whole maps"""
    record_every: int = 25
    """score every this many steps, and at the end"""
    noise_db: float = 0.0
    """standard deviation of Gaussian measurement noise"""
    rules: FlightRules = FlightRules()
    """separation, the same for every planner compared"""
    seed: int = 0
    """draws the crops, the starts and the planners' randomness"""
    pairs: tuple[str, ...] = ()
    """further methods, each ``"predictor / planner"`` as in the tables"""

    def __post_init__(self) -> None:
        if not self.methods:
            raise InputError(
                "a comparison needs at least one predictor and one planner; give names separated "
                "by commas"
            )
        if self.steps < 1 or self.record_every < 1:
            raise InputError(
                f"steps and record_every must be 1 or more, got {self.steps} and "
                f"{self.record_every}"
            )
        if self.crop < 0:
            raise InputError(
                f"crop must be a number of cells, or 0 for whole maps, got {self.crop}"
            )
        if self.max_surveys is not None and self.max_surveys < 1:
            raise InputError(
                f"max_surveys must be 1 or more, got {self.max_surveys}; leave it out to fly every "
                "survey"
            )
        if not (self.noise_db >= 0 and np.isfinite(self.noise_db)):
            raise InputError(f"noise must be 0 dB or more, got {self.noise_db}")

    @property
    def methods(self) -> list[MethodSpec]:
        """Every predictor with every planner, predictors first, then the pairs."""
        product = [MethodSpec(p, q) for p in self.predictors for q in self.planners]
        return list(dict.fromkeys([*product, *(MethodSpec.of_label(text) for text in self.pairs)]))

    @property
    def record_steps(self) -> list[int]:
        """Steps at which scores are taken."""
        return sorted({*range(self.record_every, self.steps + 1, self.record_every), self.steps})

    @property
    def fingerprint(self) -> str:
        """Same for runs whose rollouts may be mixed: everything but the list of methods and the
        number of surveys."""
        kept = {
            k: v
            for k, v in asdict(self).items()
            if k not in ("predictors", "planners", "pairs", "max_surveys")
        }
        return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Comparison:
    """The scores of every method in every case; row ``i`` of each array is the same case for every
    method."""

    config: ComparisonConfig
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
def _cases(
    data: str,
    split: str,
    uavs: int,
    start: str,
    altitude_m: float,
    max_surveys: int | None,
    seed: int,
    crop: int,
) -> list[Case]:
    from skygain.datasets.cases import survey_cases
    from skygain.datasets.sample import open_sample
    from skygain.datasets.store import ChannelDataset

    dataset = open_sample() if data == "sample" else ChannelDataset.open(Path(data))
    shape = (crop, crop) if crop else dataset.grid.shape
    return survey_cases(
        dataset,
        split,
        n_uavs=uavs,
        start=start,
        altitude_m=altitude_m,
        max_surveys=max_surveys,
        seed=seed,
        crop_shape=shape,
    )


def _config_cases(config: ComparisonConfig) -> list[Case]:
    return _cases(
        config.data,
        config.split,
        config.uavs,
        config.start,
        config.altitude_m,
        config.max_surveys,
        config.seed,
        config.crop,
    )


def _run(config: ComparisonConfig, index: int, method: MethodSpec) -> dict[str, Any]:
    """One rollout, in a worker process."""
    from skygain.instruments.simulated import NoiseConfig, NoisyInstrument

    case = _config_cases(config)[index]
    noisy = None
    if config.noise_db > 0:
        noise = NoiseConfig(std_db=config.noise_db)

        def noisy(truth, rng):  # type: ignore[no-untyped-def,misc]
            return NoisyInstrument(truth, noise, rng)

    outcome = rollout(
        case,
        method,
        steps=config.steps,
        record_steps=config.record_steps,
        rules=config.rules,
        instrument=noisy,
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


def compare(
    config: ComparisonConfig,
    out: Path,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Fly every method in every case, resuming from ``out/rollouts.jsonl`` when it is there.

    Args:
        config: what to compare.
        out: folder for the journal; made when absent.
        workers: processes, by default one per core.
        progress: told after each rollout.

    Raises:
        InputError: unknown names, unreadable data, or a journal in ``out`` that belongs to another
            comparison.
    """
    for method in config.methods:
        method.build_predictor()
        method.build_planner()
    cases = _config_cases(config)
    if not cases:
        raise InputError(
            f"split {config.split} of {config.data} has no transmitter at {config.altitude_m:g} m; "
            "choose another split"
        )
    if workers is not None and workers < 1:
        raise InputError(f"workers must be 1 or more, got {workers}")
    journal = writable_folder(out) / "rollouts.jsonl"
    done: dict[tuple[int, str], dict[str, Any]] = {}
    for line in _read_lines(journal):
        if line["fingerprint"] != config.fingerprint:
            raise InputError(
                f"{journal} holds rollouts of another comparison; give another --out or delete "
                "that file"
            )
        done[line["case"], line["method"]] = line
    missing = [
        (i, m)
        for i in range(len(cases))
        for m in config.methods
        if (cases[i].link, m.label) not in done
    ]
    total, count = len(cases) * len(config.methods), len(cases) * len(config.methods) - len(missing)
    workers = min(workers or os.cpu_count() or 1, max(1, len(missing)))
    with journal.open("a") as sink:

        def keep(line: dict[str, Any]) -> None:
            nonlocal count
            line = {"fingerprint": config.fingerprint, **line}
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
                        running.add(pool.submit(_run, config, index, method))
                        if len(running) >= 2 * workers:
                            break
                    if not running:
                        break
                    finished, running = wait(running, return_when=FIRST_COMPLETED)
                    for future in finished:
                        keep(future.result())
    return _collected(config, cases, done)


def _collected(
    config: ComparisonConfig, cases: list[Case], done: dict[tuple[int, str], dict[str, Any]]
) -> Comparison:
    scores: dict[str, dict[str, NDArray[np.float64]]] = {}
    delays: dict[str, dict[str, NDArray[np.float64]]] = {}
    for method in config.methods:
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
    return Comparison(config, config.record_steps, cities, scores, delays)
