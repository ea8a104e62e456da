"""Fly, submit and be scored in this benchmark. NumPy is all it needs.

    python skygain_benchmark.py SUBMISSION [SUBMISSION ...]

prints the row of each submission, a folder that `Flight.write` filled. See README.md beside it.
``truth.npz`` is there for `Flight.move` and for the scores, not for a method.
"""

from __future__ import annotations

__all__ = [
    "MOVES",
    "Benchmark",
    "BenchmarkError",
    "Flight",
    "Row",
    "Submission",
    "illegal",
    "interval",
    "read_submission",
    "scores",
    "table",
]

import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

MOVES = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
"""``[4, (row, col)]`` north, east, south, west; row 0 is the southern edge"""
VARIANCE_FLOOR_DB2 = 1e-4
"""a predicted variance below this counts as this"""
LARGEST_DB = 1e6
"""a predicted gain beyond this is refused: its square could not be scored"""
HALF_90 = 1.6448536269514722
"""half the width of a central 90 % interval in standard deviations"""
CASES, TRUTH, TRANSMITTERS = "cases.npz", "truth.npz", "transmitters.npz"


class BenchmarkError(ValueError):
    """A file, a move or a map that cannot be used; the text says which and why."""


class Benchmark:
    """The surveys to fly: iterate over it, or take one with ``flight(k)``."""

    def __init__(
        self, folder: str | Path = Path(__file__).parent, *, transmitter: bool = False
    ) -> None:
        """Args:
        folder: where ``cases.npz`` and ``truth.npz`` lie.
        transmitter: whether the method is told where the transmitter is; its row says so.
        """
        self.folder, self.told_transmitter = Path(folder), transmitter
        self.cases = _arrays(self.folder / CASES)
        self.truth = _arrays(self.folder / TRUTH)
        told = _arrays(self.folder / TRANSMITTERS) if transmitter else None
        self.transmitter_m = None if told is None else told["transmitter_m"]
        self.id = str(self.cases["id"])
        if self.id != str(self.truth["id"]):
            raise BenchmarkError(f"{CASES} and {TRUTH} in {self.folder} are not of one export")
        self.steps = int(self.cases["steps"])
        self.record_steps = [int(step) for step in self.cases["record_steps"]]

    def __len__(self) -> int:
        return len(self.cases["height_m"])

    def __iter__(self) -> Iterator[Flight]:
        return (self.flight(k) for k in range(len(self)))

    def flight(self, k: int) -> Flight:
        """Survey ``k`` with its UAVs at their starts, which they have measured."""
        return Flight(self, k)


class Flight:
    """One survey under way."""

    def __init__(self, benchmark: Benchmark, number: int) -> None:
        cases = benchmark.cases
        self.benchmark = benchmark
        self.number = number
        self.height_m: np.ndarray = cases["height_m"][number]
        """``[row, col]`` height of what is built at the cell's centre, 0 on the street"""
        self.free: np.ndarray = cases["free"][number]
        """``[row, col]`` cells outdoors at the altitude of flight: to fly in and to predict"""
        self.spacing_m = float(cases["spacing_m"])
        self.altitude_m = float(cases["altitude_m"])
        self.frequency_hz = float(cases["frequency_hz"])
        self.noise_std_db = float(cases["noise_std_db"])
        self.transmitter_m: np.ndarray | None = None
        """``(x, y, z)``; x = spacing · col, y = spacing · row; it may lie outside the window"""
        if benchmark.transmitter_m is not None:
            self.transmitter_m = benchmark.transmitter_m[number]
        self._truth_db = benchmark.truth["gain_db"][number]
        self._rng = np.random.default_rng([int(benchmark.truth["noise_seed"][number]), 1])
        self.paths: np.ndarray = cases["starts"][number].astype(int)[:, None]
        """``[uav, step + 1, (row, col)]`` flown so far"""
        self.cells: np.ndarray = np.empty((0, 2), dtype=int)
        """``[reading, (row, col)]`` where was measured"""
        self.gain_db: np.ndarray = np.empty(0)
        """``[reading]`` what was measured"""
        self._maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._measure(self.paths[:, 0])

    @property
    def step(self) -> int:
        """Steps flown."""
        return self.paths.shape[1] - 1

    @property
    def over(self) -> bool:
        """Whether all steps are flown."""
        return self.step >= self.benchmark.steps

    def options(self, uav: int, decided: Mapping[int, Sequence[int]] | None = None) -> np.ndarray:
        """``[k, (row, col)]`` cells that ``uav`` may move to, where some others have ``decided``
        and the rest may stay. Decide for one UAV after another; no option means that it hovers."""
        decided, now = decided or {}, self.paths[:, -1]
        near = _neighbours(self.free, now[uav])
        for other in range(len(now)):
            if other != uav:
                held = np.asarray(decided.get(other, now[other]))
                near = near[(near != held).any(axis=1)]
                if (held == now[uav]).all():
                    near = near[(near != now[other]).any(axis=1)]
        return near

    def move(self, cells: Any) -> None:
        """Fly one step to ``cells[uav, (row, col)]`` and measure there.

        Raises:
            BenchmarkError: the step is illegal.
        """
        if self.over:
            raise BenchmarkError(
                f"all {self.benchmark.steps} steps of case {self.number} are flown"
            )
        now, then = self.paths[:, -1], np.asarray(cells, dtype=int)
        if then.shape != now.shape:
            raise BenchmarkError(f"cells must have shape {now.shape}, got {then.shape}")
        step = np.stack([now, then], axis=1)
        wrong = illegal(self.free, step, first=self.step + 1)
        if wrong:
            raise BenchmarkError(f"case {self.number}, {wrong}")
        self.paths = np.concatenate([self.paths, then[:, None]], axis=1)
        self._measure(then[(then != now).any(axis=1)])

    def keep(self, mean_db: Any, variance_db2: Any) -> None:
        """Submit the maps ``[row, col]`` as those of the present step."""
        if self.step not in self.benchmark.record_steps:
            at = ", ".join(map(str, self.benchmark.record_steps))
            raise BenchmarkError(f"maps are submitted at the steps {at}, this is {self.step}")
        self._maps[self.step] = (np.asarray(mean_db), np.asarray(variance_db2))

    def write(self, folder: str | Path) -> Path:
        """Write this case's file of a submission; returns it."""
        missing = [t for t in self.benchmark.record_steps if t not in self._maps]
        if missing:
            raise BenchmarkError(f"case {self.number} has no maps of step {missing[0]}; keep them")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        maps = [self._maps[t] for t in self.benchmark.record_steps]
        path = folder / _file_name(self.number)
        np.savez_compressed(
            path,
            benchmark=self.benchmark.id,
            told_transmitter=self.benchmark.told_transmitter,
            paths=self.paths.astype(np.int16),
            mean_db=np.stack([mean for mean, _ in maps]),
            variance_db2=np.stack([variance for _, variance in maps]),
        )
        return path

    def _measure(self, cells: np.ndarray) -> None:
        n = len(cells)
        gain = self._truth_db[cells[:, 0], cells[:, 1]].astype(float)
        if self.noise_std_db > 0:
            # the draws around the noise are those of receivers with faults that this one has not
            self._rng.random(n)
            gain = gain + self.noise_std_db * self._rng.standard_normal(n)
            self._rng.standard_normal((n, 2))
            self._rng.random(n)
        self.cells = np.concatenate([self.cells, cells])
        self.gain_db = np.concatenate([self.gain_db, gain])


@dataclass(frozen=True, eq=False)
class Submission:
    """What one method handed in."""

    name: str
    """the folder's"""
    told_transmitter: str
    """yes, no, or not said"""
    paths: np.ndarray
    """``[case, uav, step + 1, (row, col)]``"""
    mean_db: np.ndarray
    """``[case, recorded step, row, col]``"""
    variance_db2: np.ndarray
    """``[case, recorded step, row, col]``"""


@dataclass(frozen=True)
class Row:
    """A method's line of the table."""

    name: str
    """of the submission"""
    told_transmitter: str
    """see `Submission`"""
    values: tuple[tuple[float, float, float], ...]
    """(mean, low, high) of the RMSE at each recorded step, then of goodness of fit and cover"""


def read_submission(benchmark: Benchmark, folder: str | Path) -> Submission:
    """A submission with its shapes checked and its paths flown legally.

    Raises:
        BenchmarkError: it is not complete, of another benchmark, or a path is illegal.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BenchmarkError(f"{folder} is no folder; give the one that Flight.write filled")
    cases = benchmark.cases
    shape = cases["free"].shape[1:]
    n_uavs = cases["starts"].shape[1]
    wanted = {
        "paths": (n_uavs, benchmark.steps + 1, 2),
        "mean_db": (len(benchmark.record_steps), *shape),
        "variance_db2": (len(benchmark.record_steps), *shape),
    }
    found: dict[str, list[np.ndarray]] = {name: [] for name in wanted}
    told = set()
    for k in range(len(benchmark)):
        path = folder / _file_name(k)
        if not path.exists():
            raise BenchmarkError(
                f"{folder} has no {path.name}; a submission has all {len(benchmark)} cases"
            )
        arrays = _arrays(path)
        if str(arrays.get("benchmark", benchmark.id)) != benchmark.id:
            raise BenchmarkError(
                f"{path} belongs to benchmark {arrays['benchmark']}, this is {benchmark.id}"
            )
        for name, size in wanted.items():
            if name not in arrays or arrays[name].shape != size:
                came = arrays[name].shape if name in arrays else "nothing"
                raise BenchmarkError(f"{name} of {path} must have shape {size}, got {came}")
            found[name].append(_numbers(arrays[name], f"{name} of {path}", name == "paths"))
        told.add(_said(arrays.get("told_transmitter")))
        free = cases["free"][k]
        paths, mean, variance = (found[name][-1] for name in wanted)
        if not (paths[:, 0] == cases["starts"][k]).all():
            raise BenchmarkError(f"{path}: the paths do not begin at the starts of case {k}")
        wrong = illegal(free, paths)
        if wrong:
            raise BenchmarkError(f"{path}: {wrong}")
        if not (np.abs(mean[:, free]) <= LARGEST_DB).all():
            raise BenchmarkError(
                f"{path}: mean_db must be -{LARGEST_DB:g} to {LARGEST_DB:g} dB in every free cell"
            )
        if not (variance[:, free] >= 0).all() or np.isinf(variance[:, free]).any():
            raise BenchmarkError(f"{path}: variance_db2 must be 0 or more in every free cell")
    return Submission(
        folder.resolve().name,
        told.pop() if len(told) == 1 else "in some cases",
        *(np.stack(found[name]) for name in wanted),
    )


def illegal(free: np.ndarray, paths: np.ndarray, *, first: int = 1) -> str | None:
    """What is wrong with ``paths[uav, step, (row, col)]`` over ``free[row, col]``, or ``None``; the
    first move is that of step ``first``."""
    if not _enterable(free, paths[:, 0]).all():
        return "a start is not free"
    for step in range(1, paths.shape[1]):
        now, then = paths[:, step - 1], paths[:, step]
        moved = np.abs(then - now).sum(axis=1)
        for uav in range(len(paths)):
            who, cell = f"step {step + first - 1}: UAV {uav}", tuple(then[uav].tolist())
            if moved[uav] > 1:
                return f"{who} jumps from {tuple(now[uav].tolist())} to {cell}"
            if not _enterable(free, then[uav : uav + 1])[0]:
                return f"{who} enters {cell}, which is built up or off the map"
            if moved[uav] == 0 and not _boxed_in(free, now, then, uav):
                return f"{who} hovers at {cell} although a move is free"
            for other in range(uav):
                if (then[uav] == then[other]).all():
                    return f"{who} shares {cell} with UAV {other}"
                if (then[uav] == now[other]).all() and (then[other] == now[uav]).all():
                    return f"{who} swaps cells with UAV {other}"
    return None


def scores(
    mean_db: np.ndarray,
    variance_db2: np.ndarray,
    truth_db: np.ndarray,
    free: np.ndarray,
    paths: np.ndarray,
) -> tuple[float, float, float]:
    """RMSE in dB, mean of squared error over variance, and share inside the 90 % interval, over
    free cells that no UAV has been in."""
    unseen = free & np.isfinite(truth_db)
    unseen[paths[..., 0], paths[..., 1]] = False
    if not unseen.any():
        return np.nan, np.nan, np.nan
    error = (np.asarray(mean_db, dtype=float) - truth_db)[unseen]
    variance = np.maximum(np.asarray(variance_db2, dtype=float)[unseen], VARIANCE_FLOOR_DB2)
    inside = np.abs(error) <= HALF_90 * np.sqrt(variance)
    rmse = float(np.sqrt(np.mean(error**2)))
    return rmse, float(np.mean(error**2 / variance)), float(np.mean(inside))


def interval(values: np.ndarray, cities: np.ndarray) -> tuple[float, float, float]:
    """Mean of ``values[case]`` and its 95 % interval over 4,000 resamples of ``cities[case]``; NaN
    bounds of a single city."""
    kept = np.isfinite(values)
    values, names = values[kept], cities[kept]
    if not kept.any():
        return np.nan, np.nan, np.nan
    names, index = np.unique(names, return_inverse=True)
    mean = float(values.mean())
    if len(names) < 2:
        return mean, np.nan, np.nan
    share = np.full(len(names), 1 / len(names))
    draws = np.random.default_rng(0).multinomial(len(names), share, size=4000)
    weights = draws[:, index].astype(float)
    weights /= weights.sum(axis=1, keepdims=True)
    low, high = np.quantile(weights @ values, [0.025, 0.975])
    return mean, float(low), float(high)


def row(benchmark: Benchmark, found: Submission) -> Row:
    """The scores of a submission over all cases."""
    free, truth = benchmark.cases["free"], benchmark.truth["gain_db"]
    each = np.array(
        [
            [
                scores(
                    found.mean_db[k, i],
                    found.variance_db2[k, i],
                    truth[k],
                    free[k],
                    found.paths[k][:, : step + 1],
                )
                for i, step in enumerate(benchmark.record_steps)
            ]
            for k in range(len(benchmark))
        ]
    )  # [case, recorded step, (RMSE, ratio, cover)]
    cities = benchmark.cases["city"]
    rmse = [interval(each[:, i, 0], cities) for i in range(each.shape[1])]
    mean, low, high = (
        float(np.log(v)) if v > 0 else -np.inf if v == 0 else np.nan
        for v in interval(each[:, -1, 1], cities)
    )
    cover = interval(each[:, -1, 2], cities)
    return Row(found.name, found.told_transmitter, (*rmse, (mean, low, high), cover))


def table(benchmark: Benchmark, rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    cities = len(np.unique(benchmark.cases["city"]))
    at = [f"RMSE T={step}" for step in benchmark.record_steps]
    head = ["method", "told the transmitter", *at, "goodness of fit", "90 % cover"]
    lines = [
        f"Benchmark {benchmark.id}: {len(benchmark)} surveys in {cities} cities. RMSE in dB over "
        "free cells that were not visited; brackets: 95 % bootstrap interval over cities.",
        "",
        "| " + " | ".join(head) + " |",
        "|---" * len(head) + "|",
    ]
    styles = [".2f"] * len(at) + ["+.2f", ".1%"]
    for one in rows:
        cells = [_text(v, style) for v, style in zip(one.values, styles, strict=True)]
        lines.append("| " + " | ".join([one.name, one.told_transmitter, *cells]) + " |")
    return "\n".join(lines)


def main(folders: Sequence[str]) -> int:
    """Print the rows of submissions."""
    if not folders or folders[0] in ("-h", "--help"):
        print(__doc__)
        return 0 if folders else 2
    try:
        benchmark = Benchmark()
        found = [row(benchmark, read_submission(benchmark, folder)) for folder in folders]
    except BenchmarkError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(benchmark, found))
    return 0


def _text(value: tuple[float, float, float], style: str) -> str:
    mean, low, high = value
    bounds = "–" if np.isnan(low) else f"{low:{style}}, {high:{style}}"
    return f"{mean:{style}} [{bounds}]"


def _said(told: Any) -> str:
    return "not said" if np.size(told) != 1 or told is None else "yes" if bool(told) else "no"


def _numbers(values: np.ndarray, name: str, whole: bool) -> np.ndarray:
    """``values`` as they are if they are real numbers; as integers if they are to be ``whole``."""
    if values.dtype.kind not in "iuf":
        raise BenchmarkError(f"{name} must hold numbers, got {values.dtype}")
    if not whole:
        return values
    if not (np.isfinite(values).all() and (values == np.rint(values)).all()):
        raise BenchmarkError(f"{name} must hold whole rows and columns")
    return values.astype(int)


def _file_name(number: int) -> str:
    return f"case-{number:03d}.npz"


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file; none is ever unpickled."""
    try:
        with zipfile.ZipFile(path), np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise BenchmarkError(f"there is no {path}") from None
    except (OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise BenchmarkError(f"{path} is damaged or not written by numpy.savez: {error}") from None
    except (ValueError, AttributeError, NotImplementedError):
        raise BenchmarkError(f"{path} holds something else than arrays of numbers") from None


def _enterable(free: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """``[n]`` whether the cells are on the map and free."""
    inside = np.all((cells >= 0) & (cells < np.array(free.shape)), axis=1)
    row_, col = np.where(inside[:, None], cells, 0).T
    return inside & free[row_, col]


def _neighbours(free: np.ndarray, cell: np.ndarray) -> np.ndarray:
    near = cell + MOVES
    return near[_enterable(free, near)]


def _boxed_in(free: np.ndarray, now: np.ndarray, then: np.ndarray, uav: int) -> bool:
    """Whether every move is blocked by what is built, or by another UAV before or after."""
    near = _neighbours(free, now[uav])
    for other in range(len(now)):
        if other != uav:
            for held in (now[other], then[other]):
                near = near[(near != held).any(axis=1)]
    return len(near) == 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
