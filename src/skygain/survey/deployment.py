"""Who flies from where, and for how long: homes, starts and batteries."""

from __future__ import annotations

__all__ = ["asked_homes", "deployed", "moves_within"]

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skygain.flight.starts import home_cells, start_cells
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.scenario import Scenario
from skygain.survey.requests import EnduranceRequest, FlightRequest
from skygain.survey.territory import asked_position


def asked_homes(text: str, grid: Grid) -> list[tuple[float, float]]:
    """``[home, (x, y)]`` of ``"latitude,longitude;…"`` or ``"x,y;…"`` in metres of the map.

    Raises:
        InputError: a position cannot be read, or lies off the map.
    """
    places = [part for part in text.split(";") if part.strip()]
    return [asked_position(part, grid, name="home")[:2] for part in places]


def moves_within(request: EnduranceRequest, spacing_m: float) -> int | None:
    """How many moves of a cell a battery allows; ``None`` without one."""
    if request.battery_min is None:
        return None
    return int(60.0 * request.battery_min * request.speed_mps / spacing_m + 1e-9)


def deployed(
    flight: FlightRequest,
    endurance: EnduranceRequest,
    scenario: Scenario,
    rng: np.random.Generator,
    among: NDArray[np.bool_] | None = None,
) -> tuple[Swarm, tuple[str, ...]]:
    """The swarm at its homes, with the moves that its batteries allow, and what is to be told.

    With a battery every UAV keeps a way home within it, whatever the planner wants.

    Args:
        flight: start, steps and rules.
        endurance: home, battery and speed.
        scenario: where they fly.
        rng: draws the cells where no home is given.
        among: ``[row, col]`` cells to begin in, see `skygain.flight.starts.start_cells`.

    Raises:
        InputError: nobody can take off there, or the battery lasts for no move and back.
    """
    rules, steps, notes = flight.rules, flight.steps, []
    spacing, speed = scenario.grid.spacing_m, endurance.speed_mps
    most = moves_within(endurance, spacing)
    if most is not None:
        rules = replace(rules, return_to_start=True)
        lasts = f"a battery of {endurance.battery_min:g} min lasts {most} moves of {spacing:g} m"
        if most < 2:
            raise InputError(
                f"{lasts} at {speed:g} m/s, which is no way there and back; give a larger "
                "`battery_min` or `speed_mps`"
            )
        flown = min(most, steps)
        took = f"{flown * spacing / speed / 60:.1f} min"
        notes.append(
            f"{lasts} at {speed:g} m/s: each UAV flies {flown} ({took}) and ends them at its home"
        )
        steps = flown
    if endurance.home is None:
        cells = start_cells(flight.start, scenario, flight.uavs, rng, among)
    else:
        homes = asked_homes(endurance.home, scenario.grid)
        cells = home_cells(scenario, homes, flight.uavs, rules.min_distance_m)
        at = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in scenario.grid.xy_m(cells)[:8])
        notes.append(f"take-off at x, y = {at}{' …' if len(cells) > 8 else ''} m")
    return Swarm.deployed(scenario, cells, steps, rules), tuple(notes)
