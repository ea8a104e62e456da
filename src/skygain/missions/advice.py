"""Whether another sortie is worth flying."""

from __future__ import annotations

__all__ = ["Advice", "advice"]

from dataclasses import dataclass

from skygain.missions.folder import Mission
from skygain.missions.imagined import ahead_of
from skygain.missions.next_sortie import left_over, open_sortie
from skygain.missions.planning import expected_error, plan_sortie
from skygain.predictors.base import Belief


@dataclass(frozen=True)
class Advice:
    """What to do next, with its reason."""

    error_db: float
    """expected error of the map now"""
    next_db: float
    """expected error after one more sortie"""
    stop: bool
    """whether to stop"""
    reason: str
    """why, in words"""

    def __str__(self) -> str:
        return f"{'stop' if self.stop else 'fly on'}: {self.reason}"


def advice(mission: Mission, belief: Belief, least_gain_db: float) -> Advice:
    """What the next sortie would bring, and whether that is enough to fly it."""
    site, request = mission.site, mission.request
    now_db = expected_error(site, ahead_of(belief))
    waiting = open_sortie(mission)
    if waiting is not None:
        next_db = waiting.error_after_db
    else:
        number = len(mission.sorties()) + 1
        sortie = plan_sortie(
            site,
            belief,
            mission.method.build_planner(),
            mission.random(number),
            number=number,
            leftover=left_over(mission, site),
        )
        next_db = sortie.error_after_db
    gain = now_db - next_db
    told = f"the expected error is {now_db:.1f} dB; one more sortie would bring {next_db:.1f} dB"
    if request.stop_std_db is not None and now_db < request.stop_std_db:
        return Advice(now_db, next_db, True, f"{told}, and {request.stop_std_db:g} dB are enough")
    if gain < least_gain_db:
        return Advice(now_db, next_db, True, f"{told}, less than {least_gain_db:g} dB better")
    if request.stop_std_db is not None:
        told += f"; {request.stop_std_db:g} dB are wanted"
    return Advice(now_db, next_db, False, told)
