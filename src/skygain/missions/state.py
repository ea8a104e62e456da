"""What a mission knows at any moment: its readings on the map, and the belief that follows."""

from __future__ import annotations

__all__ = [
    "gridded_readings",
    "known_belief",
    "quantity_of",
    "readings_so_far",
    "recording_of",
    "with_readings",
]

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from skygain.ground.errors import InputError
from skygain.instruments.gridded import GriddedRecording, on_grid
from skygain.instruments.recording import Recording
from skygain.measurements import Measurements
from skygain.missions.folder import Mission
from skygain.missions.journal import Journal, Reading
from skygain.missions.site import Site
from skygain.predictors.base import Belief


def quantity_of(journal: Journal) -> str | None:
    """What the mission's readings hold, ``"gain"`` or ``"power"``; ``None`` before the first."""
    for event in journal.events("ingested"):
        return str(event["quantity"])
    return None


def recording_of(readings: Sequence[Reading], quantity: str) -> Recording:
    """The readings as one recording."""
    noise = [one.noise_std_db for one in readings]
    return Recording(
        level_db=np.array([one.level_db for one in readings]),
        quantity=quantity,
        source="the mission",
        latlon=np.array([(one.latitude, one.longitude) for one in readings]).reshape(-1, 2),
        noise_std_db=None if None in noise else np.array(noise, dtype=float),
        censored=np.array([one.censored for one in readings], dtype=bool),
    )


def gridded_readings(
    site: Site, readings: Sequence[Reading], quantity: str
) -> GriddedRecording | None:
    """One value for each cell with readings; ``None`` without any."""
    return on_grid(recording_of(readings, quantity), site.grid) if readings else None


def readings_so_far(site: Site, readings: Sequence[Reading]) -> Measurements:
    """Every reading on the map as it was taken, with the number of its UAV."""
    if not readings:
        return Measurements.none()
    cells = site.grid.cells_at_latlon(np.array([(r.latitude, r.longitude) for r in readings]))
    inside = site.grid.contains(cells)
    kept = [r for r, keep in zip(readings, inside, strict=True) if keep]
    return Measurements.at(
        cells[inside],
        [r.level_db for r in kept],
        noise_std_db=[r.noise_std_db or 0.0 for r in kept],
        time_s=[r.time_s or 0.0 for r in kept],
        uav=[r.uav for r in kept],
        censored=[r.censored for r in kept],
    )


@threadpool_limits.wrap(limits=1, user_api="blas")
def known_belief(mission: Mission, readings: Sequence[Reading] | None = None) -> Belief:
    """What is believed after ``readings``; after all of the mission's when left out.

    Raises:
        InputError: the predictor has to be told where the transmitter is.
    """
    site, method = mission.site, mission.method
    predictor = method.build_predictor()
    scenario = method.visible(site.scenario, predictor)
    if predictor.transmitter == "required" and scenario.transmitter_m is None:
        raise InputError(
            f"predictor {method.predictor!r} must be told where the transmitter is; give "
            "`transmitter`, or choose one that does without, such as kriging-blind"
        )
    belief = predictor.begin(scenario)
    readings = mission.journal.readings() if readings is None else readings
    found = gridded_readings(site, readings, quantity_of(mission.journal) or "power")
    if found is not None:
        belief = belief.updated(found.measurements())
    belief.posterior()
    return belief


@threadpool_limits.wrap(limits=1, user_api="blas")
def with_readings(mission: Mission, belief: Belief, readings: Sequence[Reading]) -> Belief:
    """``belief`` with ``readings`` that came after it.

    Readings of one cell that came at several times count as several, which `known_belief` takes
    together: near enough to plan by, and much faster.
    """
    site = mission.site
    if not len(readings_so_far(site, readings)):
        return belief
    found = gridded_readings(site, readings, quantity_of(mission.journal) or "power")
    return belief if found is None else belief.updated(found.measurements())
