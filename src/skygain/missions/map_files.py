"""The mission's map: the same files that a survey leaves, from the readings so far."""

from __future__ import annotations

__all__ = ["flown_so_far", "write_map"]

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.evaluation.rollout import Frame
from skygain.flight.swarm import Swarm
from skygain.measurements import Measurements
from skygain.missions.folder import Mission, swapped_in
from skygain.missions.state import known_belief, quantity_of, readings_so_far
from skygain.predictors.base import Belief
from skygain.reports.folder import write_folder
from skygain.reports.outcome import Outcome
from skygain.survey.loop import SurveyResult

_MOST_FRAMES = 60


def write_map(mission: Mission, belief: Belief) -> tuple[Path, list[str]]:
    """Write ``map/``; returns it, and what had to be left out."""
    outcome = flown_so_far(mission, belief)
    folder = mission.folder / "map"
    with swapped_in(folder) as draft:
        notes = write_folder(outcome, draft)
    return folder, notes


def flown_so_far(mission: Mission, belief: Belief) -> Outcome:
    """The mission told as a survey: readings as steps, one frame for each log that came in."""
    site = mission.site
    readings = mission.journal.readings()
    taken = readings_so_far(site, readings)
    history = _history(site.pads, taken)
    swarm = Swarm(
        site.scenario.flyable,
        site.grid.spacing_m,
        history,
        np.zeros(len(history), dtype=np.int64),
    )
    planned = len(mission.sorties())
    stopped = "1 sortie planned" if planned == 1 else f"{planned} sorties planned"
    result = SurveyResult(belief.scenario, swarm, taken, belief, stopped)
    quantity = quantity_of(mission.journal)
    label = "channel gain in dB" if quantity == "gain" else "received power in dBm"
    return Outcome(
        result,
        _frames(mission, history),
        title=f"Mission over {site.reading.city.name}",
        config=mission.request.stored(),
        level_label=label,
        notes=site.notes,
        source=site.reading.as_data(),
    )


def _history(pads: tuple, taken: Measurements) -> NDArray[np.int64]:
    """``[uav, step, (row, col)]`` cells in the order in which each UAV read them; UAVs with fewer
    stay where they ended."""
    uavs = len(pads)
    paths = []
    for uav in range(uavs):
        mine = taken.taken(taken.uav == uav)
        order = np.argsort(mine.time_s, kind="stable")
        cells = mine.cell[order]
        moved = np.concatenate([[True], (np.diff(cells, axis=0) != 0).any(axis=1)])[: len(cells)]
        paths.append(np.vstack([pads[uav].cell[None], cells[moved]]))
    longest = max(map(len, paths))
    return np.stack([np.vstack([p, np.repeat(p[-1:], longest - len(p), axis=0)]) for p in paths])


def _frames(mission: Mission, history: NDArray[np.int64]) -> list[Frame]:
    """What was believed after each log, the beginning first."""
    site = mission.site
    readings = mission.journal.readings()
    last = {event: k for k, event in enumerate(mission.journal.reading_events(), start=1)}
    ends = [0, *sorted(last.values())]
    if len(ends) > _MOST_FRAMES:
        ends = [ends[i] for i in np.unique(np.linspace(0, len(ends) - 1, _MOST_FRAMES).astype(int))]
    frames = []
    steps = history.shape[1] - 1
    for number, end in enumerate(ends):
        belief = known_belief(mission, readings[:end])
        posterior = belief.posterior()
        step = round(steps * number / max(1, len(ends) - 1))
        frames.append(
            Frame(
                step,
                posterior.mean_db.astype(np.float32),
                posterior.std_db.astype(np.float32),
                history[:, : step + 1],
                {"expected_rmse_db": posterior.expected_rmse_db(site.scenario.outdoor)},
            )
        )
    return frames
