"""What `skygain evaluate` may be asked for; light to import."""

from __future__ import annotations

__all__ = ["EvaluateRequest"]

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from skygain.ground.declared import named
from skygain.ground.errors import InputError
from skygain.ground.executor import ClusterRequest
from skygain.survey.requests import FlightRequest

if TYPE_CHECKING:
    from skygain.survey.methods import MethodSpec

_OF_THE_RUN = ("predictors", "planners", "methods", "max_surveys", "data")
"""fields that do not change what a rollout finds; of the data their content counts"""


@dataclass(frozen=True, kw_only=True)
class EvaluateRequest(FlightRequest, ClusterRequest):
    """Compare methods over many surveys, in pairs, with intervals; prints the table.

    Examples:
        skygain evaluate --predictors kriging,operator --planners lawnmower,lookahead
        skygain evaluate --methods 'operator / lookahead,kriging / lawnmower' --max-surveys 8
    """

    runs: ClassVar[str] = "skygain.app.compare:run_comparison"

    predictors: tuple[str, ...] = named((), names="skygain.predictors:PREDICTORS")
    """names separated by commas; kriging when left out"""
    planners: tuple[str, ...] = named((), names="skygain.planners:PLANNERS")
    """every predictor flies with every one of these; random-waypoint when left out"""
    methods: tuple[str, ...] = ()
    """further methods as in the tables, 'PREDICTOR / PLANNER'; they can stand alone"""
    data: str = "sample"
    """data set (PATH.zarr.zip), or sample"""
    split: str = "T4"
    """T1, T2, T3 or T4"""
    max_surveys: int | None = None
    """at most this many surveys, spread over the cities; one per transmitter when left out"""
    crop: int = 96
    """side in cells of the random window that is surveyed, as far as the maps go; 0 for whole
    maps"""
    record_every: int = 25
    """score every this many steps, and at the end"""
    workers: int | None = named(None, stored=False)
    """processes of this machine; one per core when left out"""
    out: Path = named(Path("surveys/evaluation"), stored=False)
    """folder for rollouts, tables and the figure; goes on with what is there"""

    def check(self) -> None:
        """Numbers of surveys, steps and cells that make a comparison, methods that can be read."""
        for name in ("steps", "record_every", "max_surveys", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"`{name}` must be 1 or more, got {value}")
        if self.crop < 0:
            raise InputError(
                f"`crop` must be a number of cells, or 0 for whole maps, got {self.crop}"
            )
        if self.methods:
            self.pairs  # noqa: B018  (raises what cannot be read)

    @property
    def pairs(self) -> list[MethodSpec]:
        """Every predictor with every planner, predictors first, then the further methods."""
        from skygain.survey.methods import MethodSpec

        predictors, planners = self.predictors, self.planners
        if predictors or planners or not self.methods:
            predictors, planners = predictors or ("kriging",), planners or ("random-waypoint",)
        product = [MethodSpec(p, q) for p in predictors for q in planners]
        further = [MethodSpec.of_label(text) for text in self.methods]
        return list(dict.fromkeys([*product, *further]))

    @property
    def record_steps(self) -> list[int]:
        """Steps at which scores are taken."""
        return sorted({*range(self.record_every, self.steps + 1, self.record_every), self.steps})

    @property
    def settings(self) -> dict[str, Any]:
        """What a rollout depends on besides its method and the data; runs that agree in it may be
        mixed."""
        return {k: v for k, v in self.stored().items() if k not in _OF_THE_RUN}
