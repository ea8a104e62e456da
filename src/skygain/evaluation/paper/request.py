"""What `skygain reproduce` may be asked for; light to import."""

from __future__ import annotations

__all__ = ["ALL", "NAMES", "ReproduceRequest"]

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from skygain.ground.declared import named
from skygain.ground.errors import InputError, did_you_mean
from skygain.ground.executor import ClusterRequest

NAMES = ("altitudes", "gain-bins", "delay", "cluster3", "spread3", "cluster5")
"""the figures"""
ALL = "all"


@dataclass(frozen=True, kw_only=True)
class ReproduceRequest(ClusterRequest):
    """Fly and draw the figures of the paper, each beside its claims and whether they hold here.

    Examples:
        skygain reproduce --quick
        skygain reproduce --figure cluster3,spread3 --data cities.zarr.zip --out figures
        skygain reproduce --figure cluster3 --methods 'kriging / lookahead' --quick
    """

    runs: ClassVar[str] = "skygain.app.reproduce:run_reproduce"

    figure: tuple[str, ...] = (ALL,)
    """altitudes, gain-bins, delay, cluster3, spread3, cluster5 or all; several with commas"""
    data: str = "sample"
    """data set (PATH.zarr.zip), or sample"""
    split: str = "T4"
    """T1, T2, T3 or T4"""
    quick: bool = False
    """a tenth of the surveys, at least one"""
    max_surveys: int = 60
    """at most this many surveys for each setting, spread over the cities"""
    methods: tuple[str, ...] = ()
    """further methods, 'PREDICTOR / PLANNER', in the figures that compare methods"""
    steps: int = 200
    """moves per UAV"""
    crop: int = 96
    """side in cells of the random window that is surveyed; 0 for whole maps"""
    seed: int = 0
    """draws windows, starts and the planners' choices"""
    workers: int | None = named(None, stored=False)
    """processes; one per core when left out; 1 on a quiet machine for delays to be quoted"""
    out: Path = named(Path("surveys/paper"), stored=False)
    """folder of the pages; goes on with what is there"""

    def check(self) -> None:
        """Figures that exist, and numbers that can be flown."""
        for name in self.figure:
            if name not in (*NAMES, ALL):
                raise InputError(f"no `figure` {name!r}; {did_you_mean(name, (*NAMES, ALL))}")
        if not self.figure:
            raise InputError(f"`figure` is empty; give one of {', '.join(NAMES)}, or {ALL}")
        for name in ("steps", "max_surveys", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"`{name}` must be 1 or more, got {value}")
        for name in ("crop", "seed"):
            if getattr(self, name) < 0:
                raise InputError(f"`{name}` must be 0 or more, got {getattr(self, name)}")

    @property
    def names(self) -> tuple[str, ...]:
        """The figures to draw, in the paper's order."""
        return NAMES if ALL in self.figure else tuple(n for n in NAMES if n in self.figure)
