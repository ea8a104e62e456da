"""What `skygain benchmark` may be asked for; light to import."""

from __future__ import annotations

__all__ = ["BenchmarkExportRequest", "BenchmarkScoreRequest"]

from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

from skygain.evaluation.request import EvaluateRequest
from skygain.ground.declared import Request, named
from skygain.ground.errors import InputError


@dataclass(frozen=True, kw_only=True)
class BenchmarkExportRequest(Request):
    """Write surveys, rules and scorer as files for those who do not use Skygain; NumPy is enough.

    Examples:
        skygain benchmark export --out benchmark
        skygain benchmark export --data cities.zarr.zip --max-surveys 60 --out benchmark.zip
    """

    runs: ClassVar[str] = "skygain.app.benchmarks:run_export"

    data: str = "sample"
    """data set (PATH.zarr.zip), or sample"""
    split: str = "T4"
    """T1, T2, T3 or T4"""
    max_surveys: int | None = None
    """at most this many surveys, spread over the cities; one per transmitter when left out"""
    crop: int = 96
    """side in cells of the random window that is surveyed; 0 for whole maps"""
    uavs: int = 3
    """how many UAVs"""
    steps: int = 200
    """moves per UAV; maps are asked for at a quarter, half and all of them"""
    start: str = "cluster"
    """cluster (all in one square of 40 m) or spread (anywhere)"""
    altitude_m: float = 10.0
    """altitude of flight and map, metres above the ground"""
    noise_db: float = 0.0
    """standard deviation of the receivers' noise"""
    seed: int = 0
    """draws the windows, the starts and the noise"""
    out: Path = named(stored=False)
    """the folder to write, or PATH.zip"""
    overwrite: bool = named(False, stored=False)
    """replace a benchmark that is there; submissions stay"""

    @property
    def comparison(self) -> EvaluateRequest:
        """The comparison that flies the same surveys."""
        shared = {f.name for f in fields(self)} & {f.name for f in fields(EvaluateRequest)}
        return EvaluateRequest(**{name: getattr(self, name) for name in shared - {"out"}})

    def check(self) -> None:
        """What a comparison could fly."""
        self.comparison  # noqa: B018  (raises what cannot be flown)


@dataclass(frozen=True, kw_only=True)
class BenchmarkScoreRequest(Request):
    """Print the rows of submissions to an exported benchmark, with intervals over cities.

    Examples:
        skygain benchmark score benchmark/submissions/nearest-neighbour
    """

    runs: ClassVar[str] = "skygain.app.benchmarks:run_score"

    submissions: tuple[Path, ...] = named(argument=True)
    """folders with one case-000.npz, … for each survey"""
    benchmark: Path | None = None
    """the exported folder; the nearest one above the first submission when left out"""

    def check(self) -> None:
        """There is something to score."""
        if not self.submissions:
            raise InputError("`submissions` are missing; give one folder or several")
