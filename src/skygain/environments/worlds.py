"""Where episodes come from: random windows of ray-traced links, with a start for the UAVs."""

from __future__ import annotations

__all__ = ["LinkWorlds", "Episode", "Worlds"]

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.datasets.cases import FREE_SHARE, largest_part
from skygain.datasets.links import Links, load_links
from skygain.flight.starts import STARTS, start_cells
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.scenario import Scenario

_DRAWS = 200


@dataclass(frozen=True, eq=False)
class Episode:
    """What one episode is played in."""

    scenario: Scenario
    """with the transmitter's position; who may look at it is decided elsewhere"""
    truth_db: NDArray[np.float32]
    """``[row, col]`` gain, finite"""
    start: NDArray[np.int64]
    """``[uav, (row, col)]``"""


class Worlds(Protocol):
    """A source of episodes."""

    @property
    def side(self) -> int:
        """Rows and columns of every world."""

    def draw(self, rng: np.random.Generator, n_uavs: int) -> Episode:
        """A world that follows from ``rng`` alone."""


@dataclass(frozen=True)
class LinkWorlds:
    """Windows of the links of one split, turned and mirrored at random.

    Raises:
        InputError: unknown kind of start.
    """

    data: str = "sample"
    """path of a data set, or ``"sample"`` for the one that ships with the package"""
    split: str = "T1"
    """split of the cities"""
    altitude_m: float = 10.0
    """altitude of flight and of prediction"""
    start: str = "cluster"
    """``"cluster"``, ``"spread"``, or ``"mixed"`` for one or the other with equal odds"""
    side: int = 96
    """cells along the edge of a window"""
    augment: bool = True
    """turn and mirror"""
    _kinds: tuple[str, ...] = field(init=False, repr=False, default=STARTS)

    def __post_init__(self) -> None:
        if self.start not in (*STARTS, "mixed"):
            raise InputError(f"unknown start {self.start!r}; known: {', '.join(STARTS)}, mixed")
        object.__setattr__(self, "_kinds", STARTS if self.start == "mixed" else (self.start,))

    @cached_property
    def _links(self) -> Links:
        return load_links(self.data, self.split)

    def draw(self, rng: np.random.Generator, n_uavs: int) -> Episode:
        """See `Worlds`.

        Raises:
            InputError: the split has no maps at this altitude, or no window with room for the swarm
                was found.
        """
        odds = (self._links.altitude_m == self.altitude_m).astype(float)
        if not (self._links.available @ odds).any():
            known = ", ".join(f"{a:g}" for a in self._links.altitude_m)
            raise InputError(
                f"{self.data} has no maps at {self.altitude_m:g} m; altitudes: {known}"
            )
        kind = self._kinds[int(rng.integers(len(self._kinds)))]
        grid = Grid((self.side, self.side), self._links.spacing_m)
        for _ in range(_DRAWS):
            view = self._links.draw(rng, self.side, odds, self.augment)
            part = largest_part(view.outdoor)
            if part.sum() < max(n_uavs, FREE_SHARE * part.size):
                continue
            row, col, z = view.transmitter
            city = City(grid, view.height_m)
            try:
                place = (col * grid.spacing_m, row * grid.spacing_m, z)
                scenario = Scenario(city, view.altitude_m, view.altitude_m, transmitter_m=place)
                reachable = Scenario(city, view.altitude_m, view.altitude_m, no_fly=~part)
                return Episode(scenario, view.gain_db, start_cells(kind, reachable, n_uavs, rng))
            # a transmitter in a cell that counts as built up, or no square with room: the next
            # window
            except InputError:
                continue
        raise InputError(
            f"{self.data}: found no window of {self.side} cells for {n_uavs} UAVs in {_DRAWS} "
            "draws; use fewer UAVs"
        )
