"""Which sortie comes next: the one still open, or a new one from all that was read."""

from __future__ import annotations

__all__ = ["left_over", "next_sortie", "open_sortie"]

from collections.abc import Callable, Sequence

import numpy as np

from skygain.ground.errors import InputError
from skygain.missions.folder import Mission
from skygain.missions.imagined import ahead_of, with_expected
from skygain.missions.journal import POSTED
from skygain.missions.planning import Leftover, plan_sortie
from skygain.missions.site import Site
from skygain.missions.sortie import Sortie
from skygain.missions.state import known_belief, readings_so_far

_FEWEST = 4
_FLOWN_SHARE = 0.1


def open_sortie(mission: Mission) -> Sortie | None:
    """The newest sortie, if it was not flown since it was planned.

    A companion computer posts before the take-off too, so readings that were posted count as a
    flight once a live flight has ended, or once they hold a tenth of the cells planned.
    """
    sorties = mission.sorties()
    if not sorties:
        return None
    newest, planned = sorties[-1], mission.journal.events("planned")[-1]["id"]
    events = mission.journal.events("ingested", "flown")
    since = [event for event in events if event["id"] > planned]
    read = [event for event in since if event["kind"] == "ingested"]
    if any(event.get("file") != POSTED for event in read):
        return None
    if read and len(since) > len(read):
        return None
    if read:
        site = mission.site
        seen = readings_so_far(site, mission.journal.readings()).visited(site.grid.shape)
        if seen[newest.cells[:, 0], newest.cells[:, 1]].mean() >= _FLOWN_SHARE:
            return None
    return newest


def next_sortie(
    mission: Mission,
    *,
    without: Sequence[int] = (),
    ahead: bool = False,
    told: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Sortie, bool]:
    """The next sortie, in the journal when this returns, and whether it was there already.

    Args:
        mission: open for writing.
        without: UAVs that stay on the ground; the open sortie is planned anew for the others.
        ahead: plan one more as if the open one had been flown.
        told: hears how many steps are planned.

    Raises:
        InputError: nobody can fly.
    """
    site = mission.site
    everyone = range(len(site.pads))
    for uav in without:
        if uav not in everyone:
            raise InputError(
                f"`without` names UAV {uav}, but the mission has UAVs 0 to {len(everyone) - 1}"
            )
    uavs = [uav for uav in everyone if uav not in without]
    waiting = open_sortie(mission)
    if waiting is not None and not ahead:
        if [f.uav for f in waiting.flights] == uavs or not without:
            return waiting, True
        number = waiting.number
    else:
        number = len(mission.sorties()) + 1
    belief = known_belief(mission)
    if ahead and waiting is not None:
        belief = with_expected(ahead_of(belief), waiting.cells)
    sortie = plan_sortie(
        site,
        belief,
        mission.method.build_planner(),
        mission.random(number),
        number=number,
        uavs=uavs,
        leftover=left_over(mission, site),
        told=told,
    )
    mission.journal.add("planned", {"sortie": sortie.as_data()})
    return sortie, False


def left_over(mission: Mission, site: Site) -> list[Leftover]:
    """What the last sortie with readings planned and nobody has read since; less than a few cells
    are left to the planner."""
    flown = mission.flown()
    sorties = [s for s in mission.sorties() if s.number in flown]
    if not sorties:
        return []
    seen = readings_so_far(site, mission.journal.readings()).visited(site.grid.shape)
    # a reading a cell aside tells as much
    near = seen.copy()
    near[1:] |= seen[:-1]
    near[:-1] |= seen[1:]
    near[:, 1:] |= seen[:, :-1]
    near[:, :-1] |= seen[:, 1:]
    runs = []
    for flight in sorties[-1].flights:
        missed = ~near[flight.cells[:, 0], flight.cells[:, 1]]
        edges = np.flatnonzero(np.diff(np.r_[False, missed, False]))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if last - first >= _FEWEST:
                runs.append(Leftover.of(flight, int(first), int(last), site.grid))
    return runs
