"""What a mission would bring, before anyone flies: sorties, energy, and how sure the map gets."""

from __future__ import annotations

__all__ = ["Outlook", "outlook", "site_lines"]

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from skygain.missions.imagined import ahead_of, with_expected
from skygain.missions.planning import expected_error, plan_sortie
from skygain.missions.site import Site
from skygain.missions.sortie import Sortie
from skygain.planners.base import Planner
from skygain.predictors.base import Belief


@dataclass(frozen=True, eq=False)
class Outlook:
    """Sorties as the planner would fly them."""

    sorties: tuple[Sortie, ...]
    """one after another, each as if the ones before had been flown"""
    error_db: tuple[float, ...]
    """expected error before the first and after each"""
    enough: bool = field(default=False)
    """whether the last one reaches the certainty asked for"""


def outlook(
    site: Site,
    belief: Belief,
    planner: Planner,
    most: int,
    *,
    stop_std_db: float | None = None,
    seed: int = 0,
    told: Callable[[int, int, str], None] = lambda done, total, text: None,
) -> Outlook:
    """Plan up to ``most`` sorties ahead, until the map would be certain enough."""
    belief = ahead_of(belief)
    sorties: list[Sortie] = []
    std = [expected_error(site, belief)]
    enough = stop_std_db is not None and std[-1] < stop_std_db
    while len(sorties) < most and not enough:
        number = len(sorties) + 1

        def heard(done: int, total: int, number: int = number) -> None:
            told((number - 1) * total + done, most * total, f"sortie {number}")

        rng = np.random.default_rng([seed, number])
        sortie = plan_sortie(site, belief, planner, rng, number=number, told=heard)
        belief = with_expected(belief, sortie.cells)
        sorties.append(sortie)
        std.append(expected_error(site, belief))
        enough = stop_std_db is not None and std[-1] < stop_std_db
    return Outlook(tuple(sorties), tuple(std), enough)


def site_lines(site: Site) -> list[str]:
    """The place in numbers, a line each."""
    request, grid = site.request, site.grid
    rows, cols = grid.shape
    latitude, longitude = grid.latlon(((rows - 1) / 2, (cols - 1) / 2))
    hectares = site.area_m2 / 1e4
    lines = [
        f"{site.reading.city.name}: {rows} x {cols} cells of {grid.spacing_m:g} m around "
        f"{latitude:.5f}, {longitude:.5f}, {grid.crs}",
        f"area {hectares:.1f} ha, {site.flyable_share:.0%} of its cells can be flown at "
        f"{site.altitude_text} with {request.clearance_m:g} m of clearance",
        f"{request.uavs} UAVs, {request.speed_mps:g} m/s, {request.usable_s / 60:.1f} min of "
        f"{request.battery_min:g} min of battery may be used",
    ]
    return [*lines, *(f"note: {note}" for note in site.notes)]
