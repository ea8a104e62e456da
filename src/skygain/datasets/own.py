"""A data set of cities that somebody brings: footprints, height rasters, scenes.

Cities of a data set share one grid. So each is cut, from its middle, to the size of the smallest,
and begins a frame of its own; its ground is taken as level. What is stored is the raster; the truth
is computed over the outlines where the file has them.
"""

from __future__ import annotations

__all__ = ["OwnCities", "own_cities", "splits_of"]

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities import CityOptions, Reading, read_city
from skygain.city import City
from skygain.datasets.layout import SPLITS
from skygain.ground.errors import InputError
from skygain.ground.files import file_digest

_HEIGHT_M = 1.5
"""of a transmitter above the street"""
_FEWEST_CELLS = 16
"""along a side; on less no survey says anything"""


@dataclass(frozen=True)
class OwnCities:
    """What a data set of given cities is built of. Made by `own_cities`."""

    cities: tuple[str, ...]
    """file, seed or scene of each"""
    splits: tuple[str, ...]
    """split of each"""
    shape: tuple[int, int]
    """rows and columns of every map"""
    spacing_m: float
    """side of a cell"""
    altitudes_m: tuple[float, ...] = (10.0,)
    """altitudes of the maps"""
    transmitters: int = 6
    """transmitters per city, drawn from the open ground"""
    frequency_hz: float = 5.0e9
    """carrier frequency"""
    propagation: str = "union"
    """name of the propagation model"""
    seed: int = 0
    """draws the transmitters"""
    options: CityOptions = field(default_factory=CityOptions)
    """how the files are read"""
    notes: tuple[str, ...] = ()
    """what the reader and the cutting did, a line each"""

    @property
    def city_seeds(self) -> list[tuple[int, str]]:
        """(number, split) of every city, in the order of the file."""
        return list(enumerate(self.splits))

    def drawn(self, number: int) -> City:
        """The city of a number, cut to the common size, over level ground."""
        city = read_city(self.cities[number], self.options).city
        row, col = ((city.grid.shape[axis] - self.shape[axis]) // 2 for axis in (0, 1))
        cut = city.cropped(row, col, self.shape, rebase=True)
        return replace(cut, ground_m=np.zeros((), np.float32), ground_datum=None)

    def sites(self, number: int, city: City) -> NDArray[np.float64]:
        """``[transmitter, (x, y, z)]`` at random places of the open ground; fewer are the first of
        more.

        Raises:
            InputError: the city has no open ground.
        """
        ground = np.argwhere(city.height_m <= 0)
        if not len(ground):
            raise InputError(f"{self.cities[number]} has no open ground for a transmitter")
        order = np.random.default_rng([self.seed, number]).permutation(len(ground))
        chosen = ground[order[: self.transmitters]]
        return np.column_stack([city.grid.xy_m(chosen), np.full(len(chosen), _HEIGHT_M)])

    def as_data(self) -> dict[str, Any]:
        """What decides the numbers; files by name and content, without their folders."""
        told = asdict(self)
        del told["notes"]
        told["cities"] = [_content(city) for city in self.cities]
        terrain = self.options.terrain
        told["options"]["terrain"] = terrain and _content(terrain)
        return told

    @property
    def title(self) -> str:
        """Of the data set."""
        return f"Own cities: {', '.join(Path(city).name for city in self.cities)}"

    @property
    def extent_m(self) -> float:
        """The longer side of the cities."""
        return max(self.shape) * self.spacing_m

    @property
    def numbered_by(self) -> str:
        """What the number of a city is."""
        return "its place in the list of cities"


def own_cities(
    cities: Sequence[str],
    *,
    splits: Sequence[str] = ("T4",),
    side: int | None = None,
    transmitters: int = 6,
    altitudes_m: Sequence[float] = (10.0,),
    options: CityOptions | None = None,
    **further: Any,
) -> OwnCities:
    """Read the cities once and see that they fit together.

    Args:
        cities: file, seed or scene of each, as `skygain.cities.read_city` takes them.
        splits: split of each city, or one for all.
        side: cells along a side of every map; the smallest city's rows and columns when left out.
        transmitters: how many per city.
        altitudes_m: of the maps.
        options: how the files are read.
        further: other fields of `OwnCities`.

    Raises:
        InputError: a city cannot be read, cells differ in size, a map would be too small, or a
            number is out of range.
    """
    if transmitters < 1:
        raise InputError(f"`transmitters` must be 1 or more, got {transmitters}")
    altitudes = tuple(float(a) for a in altitudes_m)
    if not altitudes or len(set(altitudes)) < len(altitudes) or not min(altitudes) > 0:
        raise InputError(f"`altitudes_m` must be above 0 m and different, got {list(altitudes)}")
    options = options or CityOptions()
    readings = [read_city(city, options) for city in cities]
    each = splits_of(splits, cities)
    grids = [reading.city.grid for reading in readings]
    spacing = grids[0].spacing_m
    for city, grid in zip(cities, grids, strict=True):
        if not np.isclose(grid.spacing_m, spacing):
            raise InputError(
                f"{cities[0]} has cells of {spacing:g} m, {city} of {grid.spacing_m:g} m; give "
                "one `spacing_m` for all"
            )
    rows, cols = (min(grid.shape[axis] for grid in grids) for axis in (0, 1))
    if side is not None:
        if side > min(rows, cols):
            raise InputError(
                f"`side={side}` is more than the smallest city has, {rows} x {cols} cells; give "
                "less, or leave it out"
            )
        rows = cols = side
    if min(rows, cols) < _FEWEST_CELLS:
        raise InputError(
            f"maps of {rows} x {cols} cells are too small for surveys, which need {_FEWEST_CELLS} "
            "along a side; give a smaller `spacing_m` or larger cities"
        )
    notes = [
        line
        for city, reading in zip(cities, readings, strict=True)
        for line in _notes(city, reading, (rows, cols))
    ]
    return OwnCities(
        tuple(map(str, cities)),
        each,
        (rows, cols),
        float(spacing),
        altitudes,
        transmitters,
        options=options,
        notes=tuple(notes),
        **further,
    )


def splits_of(splits: Sequence[str], cities: Sequence[Any]) -> tuple[str, ...]:
    """A split for each city; one stands for all.

    >>> splits_of(["T4"], ["a", "b"])
    ('T4', 'T4')
    """
    for split in splits:
        if split not in SPLITS:
            raise InputError(f"`splits` must be among {', '.join(SPLITS)}, got {split!r}")
    if len(splits) == 1:
        return tuple(splits) * len(cities)
    if len(splits) != len(cities):
        raise InputError(
            f"`splits` names {len(splits)} splits for {len(cities)} cities; give one for each, or "
            "one for all"
        )
    return tuple(splits)


def _notes(city: str, reading: Reading, shape: tuple[int, int]) -> list[str]:
    """What was done to a city, a line each."""
    name = Path(city).name
    lines = [f"{name}: {note}" for note in reading.notes]
    rows, cols = reading.city.grid.shape
    if (rows, cols) != shape:
        lines.append(
            f"{name}: its {rows} x {cols} cells are cut to the {shape[0]} x {shape[1]} in the "
            "middle, which all cities have"
        )
    if not reading.city.is_level:
        lines.append(f"{name}: its ground is taken as level, heights stay above it")
    return lines


def _content(text: str) -> list[str]:
    """Name of a file and digest of its content; the text itself where it names no file."""
    path = Path(text)
    return [path.name, file_digest(path)] if path.is_file() else [text]
