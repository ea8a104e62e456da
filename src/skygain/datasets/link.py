"""One transmitter's channel over one city: the unit that everything in a data set is counted in."""

from __future__ import annotations

__all__ = ["Link"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.city import City


@dataclass(frozen=True, eq=False)
class Link:
    """The channel gain from one transmitter to every cell of a map at one altitude."""

    city: City
    """the map; its frame is the one that ``transmitter_m`` is given in"""
    transmitter_m: tuple[float, float, float]
    """(x, y, z) of the transmitter; on a crop it may lie outside the map"""
    altitude_m: float
    """altitude of the receivers above the street"""
    truth_db: NDArray[np.float32]
    """``[row, col]`` channel gain; means nothing where the city obstructs the altitude"""
    ray_traced: NDArray[np.bool_]
    """``[row, col]`` whether a ray reached the cell; elsewhere the gain is the over-rooftop term"""
    split: str
    """the split its city belongs to, ``"T1"`` to ``"T4"``"""
    city_index: int
    """position of its city in the data set"""
    index: int
    """position of the link in the data set"""

    @property
    def outdoor(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells unobstructed at the link's altitude, where the truth means
        something."""
        return ~self.city.obstructed(self.altitude_m)
