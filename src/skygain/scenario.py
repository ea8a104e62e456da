"""What a predictor and a planner are allowed to know before the first measurement."""

from __future__ import annotations

__all__ = ["Scenario"]

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError

FREQUENCY_HZ = 5.0e9
"""carrier frequency where none is given"""


@dataclass(frozen=True, eq=False)
class Scenario:
    """One survey's setting: the city, the altitudes, the no-fly zones, and the transmitter if its
    position is known.

    Raises:
        InputError: no cell is free for flight or for prediction, the no-fly mask has another shape
            than the map, or a known transmitter stands inside a building or is not finite.
    """

    city: City
    uav_altitude_m: float = 10.0
    """altitude at which the UAVs fly and measure, above the ground beneath them (following the
    terrain), or above ``datum_m`` where that is given"""
    prediction_altitude_m: float = 10.0
    """altitude of the map to be predicted, likewise"""
    no_fly: NDArray[np.bool_] | None = None
    """``[row, col]`` cells no UAV may enter, besides buildings"""
    wanted: NDArray[np.bool_] | None = None
    """``[row, col]`` cells where a map is wanted; all of them when left out"""
    transmitter_m: tuple[float, float, float] | None = None
    """(x, y, z) of the transmitter in the city's metres, ``None`` when unknown; it may lie outside
    the map"""
    frequency_hz: float = FREQUENCY_HZ
    """carrier frequency"""
    datum_m: float | None = None
    """where the flight keeps a level above the sea (see `at_level`): the height of both altitudes'
    zero, on which the city is levelled; ``None`` where altitudes are above ground"""

    def __post_init__(self) -> None:
        for name in ("uav_altitude_m", "prediction_altitude_m", "frequency_hz"):
            value = float(getattr(self, name))
            if not (np.isfinite(value) and value > 0):
                raise InputError(
                    f"{name} must be a positive number, got {value}; give metres above the street "
                    "(or hertz)"
                )
        for name in ("no_fly", "wanted"):
            if getattr(self, name) is None:
                continue
            mask = np.array(getattr(self, name), dtype=bool)
            if mask.shape != self.grid.shape:
                raise InputError(
                    f"{name} has shape {mask.shape}, but the map has {self.grid.shape}; they must "
                    "agree"
                )
            mask.flags.writeable = False
            object.__setattr__(self, name, mask)
        if not self.flyable.any():
            raise InputError(
                f"no cell of {self.city.name!r} is free for flight at {self.uav_altitude_m:g} m: "
                "every cell is built up or no-fly; "
                "fly higher (`altitude_m`) or choose another `city`"
            )
        if not self.outdoor.any():
            raise InputError(
                f"no cell of {self.city.name!r} is outdoors at {self.prediction_altitude_m:g} m "
                "where a map is wanted; predict at a higher altitude, or give another `area`"
            )
        if self.transmitter_m is not None:
            check_transmitter(self.city, self.transmitter_m)

    @classmethod
    def at_level(
        cls, city: City, level_m: float, *, prediction_level_m: float | None = None, **others: Any
    ) -> Scenario:
        """A flight that keeps ``level_m`` above the sea: hills are obstacles as buildings are.

        Args:
            city: with its ground.
            level_m: of the flight, above what the city's ground is measured from.
            prediction_level_m: of the map; that of the flight when left out.
            others: further fields; the transmitter's z is above the ground beneath it.

        Raises:
            InputError: the level lies below the lowest ground; or as for any scenario.
        """
        lowest = float(city.ground_m.min())
        if not level_m > lowest:
            raise InputError(
                f"the level {level_m:g} m lies below the lowest ground, {lowest:g} m; give an "
                "altitude above sea level, or one above the ground"
            )
        if others.get("transmitter_m") is not None:
            x, y, z = others["transmitter_m"]
            others["transmitter_m"] = (x, y, z + city.ground_at(x, y) - lowest)
        predicted = level_m if prediction_level_m is None else prediction_level_m
        return cls(
            city.levelled(lowest),
            uav_altitude_m=level_m - lowest,
            prediction_altitude_m=predicted - lowest,
            datum_m=lowest,
            **others,
        )

    @property
    def altitude_text(self) -> str:
        """The altitude of flight, and above what it is: ``"10 m above ground"``."""
        if self.datum_m is None:
            return f"{self.uav_altitude_m:g} m above ground"
        return f"{self.datum_m + self.uav_altitude_m:g} m above {self._zero}"

    @property
    def map_altitude_text(self) -> str:
        """The altitude of the map, and above what it is."""
        if self.datum_m is None:
            return f"{self.prediction_altitude_m:g} m above ground"
        return f"{self.datum_m + self.prediction_altitude_m:g} m above {self._zero}"

    @property
    def one_altitude(self) -> bool:
        """Whether the map is at the altitude of flight."""
        return self.uav_altitude_m == self.prediction_altitude_m

    @property
    def _zero(self) -> str:
        return self.city.ground_datum or "sea level"

    @property
    def grid(self) -> Grid:
        """The city's grid."""
        return self.city.grid

    @cached_property
    def flyable(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells a UAV may be in: unobstructed at the UAV altitude and not in a
        no-fly zone."""
        free = ~self.city.obstructed(self.uav_altitude_m)
        if self.no_fly is not None:
            free &= ~self.no_fly
        free.flags.writeable = False
        return free

    @cached_property
    def outdoor(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells where the prediction counts: unobstructed at the prediction
        altitude, and wanted."""
        free = ~self.city.obstructed(self.prediction_altitude_m)
        if self.wanted is not None:
            free &= self.wanted
        free.flags.writeable = False
        return free

    def without_transmitter(self) -> Scenario:
        """The same setting with the transmitter's position withheld."""
        return replace(self, transmitter_m=None)


def check_transmitter(city: City, transmitter_m: tuple[float, float, float]) -> None:
    """Raise `InputError` if the transmitter is not three finite numbers or stands inside a building
    of the map."""
    position = np.asarray(transmitter_m, dtype=float)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InputError(
            "a transmitter position is three finite numbers x, y, z in metres, got "
            f"{transmitter_m}; give e.g. 120,80,1.5"
        )
    roof_m = city.roof_m(position[0], position[1])
    if roof_m > 0 and roof_m >= position[2]:
        raise InputError(
            f"the transmitter at x={position[0]:.8g} m, y={position[1]:.8g} m, z={position[2]:g} m "
            f"is inside a building {roof_m:g} m high; move it to open ground or above the roof"
        )
