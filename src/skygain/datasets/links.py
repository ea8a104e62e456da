"""Ray-traced links as plain arrays, and the random views of them that networks are trained on.

A network sees thousands of crops a minute. Going through the data set's labels for each would cost
more than the crop itself, so one split is read once into dense arrays, and a `View` (which link,
which altitude, which window, which of the eight symmetries of the square) is drawn from a generator
and cut out of them.
"""

from __future__ import annotations

__all__ = [
    "Links",
    "Paths",
    "View",
    "joined",
    "load_links",
    "origin_of",
    "read_links",
    "several_paths",
]

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skygain.datasets.layout import SPLITS
from skygain.datasets.origin import demand_one_origin, origin
from skygain.datasets.sample import SAMPLE
from skygain.datasets.store import ChannelDataset
from skygain.grid import SYMMETRIES, random_corner, turned, turned_cells
from skygain.ground.errors import InputError

Paths = str | Path | Sequence[str | Path]
"""one data set or several: paths, or ``"sample"`` for the one that ships with the package"""


@dataclass(frozen=True, eq=False)
class View:
    """One training sample: a window of one link's map, possibly turned and mirrored."""

    height_m: NDArray[np.float32]
    """``[row, col]`` building heights of the window"""
    gain_db: NDArray[np.float32]
    """``[row, col]`` truth, finite everywhere"""
    outdoor: NDArray[np.bool_]
    """``[row, col]`` cells where the truth counts"""
    ray_traced: NDArray[np.bool_]
    """``[row, col]`` cells a ray reached"""
    transmitter: tuple[float, float, float]
    """(row, col, z): fractional cell in the window's frame (it may lie outside) and metres above
    the street"""
    altitude_m: float
    """altitude of the map"""


@dataclass(frozen=True, eq=False)
class Links:
    """One split of a data set."""

    height_m: NDArray[np.float32]
    """``[city, row, col]``"""
    city: NDArray[np.int64]
    """``[link]`` index along the first axis of `height_m`"""
    transmitter: NDArray[np.float64]
    """``[link, (row, col, z)]`` fractional cells, metres"""
    gain_db: NDArray[np.float16]
    """``[link, altitude, row, col]`` NaN where an altitude was not computed"""
    ray_traced: NDArray[np.bool_]
    """``[link, altitude, row, col]``"""
    altitude_m: NDArray[np.float64]
    """``[altitude]``"""
    available: NDArray[np.bool_]
    """``[link, altitude]`` whether the altitude was computed"""
    spacing_m: float
    """side of a cell"""

    def __len__(self) -> int:
        return len(self.city)

    def draw(
        self,
        rng: np.random.Generator,
        side: int,
        weights: NDArray[np.float64] | None = None,
        augment: bool = True,
    ) -> View:
        """A random window of ``side`` cells: first the altitude is drawn, then a link that has it,
        then the window.

        ``weights[altitude]`` are relative odds (default: equal); an altitude that no link has is
        never drawn. Turns and mirror images only with ``augment``.

        Raises:
            InputError: no link has any of the altitudes wanted.
        """
        odds = (
            np.ones(len(self.altitude_m)) if weights is None else np.asarray(weights, dtype=float)
        )
        odds = np.where(self.available.any(axis=0), odds, 0.0)
        if not odds.sum() > 0:
            held = ", ".join(f"{a:g}" for a in self.altitude_m[self.available.any(axis=0)])
            raise InputError(
                f"no link has an altitude of those wanted; the data set has maps at {held} m"
            )
        altitude = int(rng.choice(len(odds), p=odds / odds.sum()))
        having = np.flatnonzero(self.available[:, altitude])
        link = int(having[rng.integers(len(having))])
        row, col = self.corner(rng, side)
        return self.view(
            link, altitude, row, col, side, int(rng.integers(SYMMETRIES)) if augment else 0
        )

    def corner(self, rng: np.random.Generator, side: int) -> tuple[int, int]:
        """First cell (row, col) of a window of ``side`` cells drawn at random.

        Raises:
            InputError: the maps are smaller than the window.
        """
        rows, cols = self.height_m.shape[1:]
        if side > min(rows, cols):
            raise InputError(
                f"maps of {rows} x {cols} cells are smaller than the {side} x {side} that networks "
                "learn from; take larger cities or smaller cells"
            )
        return random_corner((rows, cols), (side, side), rng)

    def view(
        self, link: int, altitude: int, row: int, col: int, side: int, symmetry: int = 0
    ) -> View:
        """The window of ``side`` cells whose first cell is (row, col), under one of the
        `skygain.grid.SYMMETRIES`."""
        window = (slice(row, row + side), slice(col, col + side))
        place = self.transmitter[link, :2] - (row, col)
        tx_row, tx_col = turned_cells(place, (side - 1, side - 1), symmetry)

        def cut(map_: NDArray) -> NDArray:
            return np.ascontiguousarray(turned(map_[window], symmetry))

        height = cut(self.height_m[self.city[link]])
        gain = cut(self.gain_db[link, altitude]).astype(np.float32)
        altitude_m = float(self.altitude_m[altitude])
        outdoor = (height < altitude_m) & np.isfinite(gain)
        gain[~outdoor] = 0.0
        return View(
            height_m=height,
            gain_db=gain,
            outdoor=outdoor,
            ray_traced=cut(self.ray_traced[link, altitude]),
            transmitter=(float(tx_row), float(tx_col), float(self.transmitter[link, 2])),
            altitude_m=altitude_m,
        )


def load_links(paths: Paths, split: str) -> Links:
    """Read one split (``T1`` … ``T4``) of a data set, or of several together.

    Raises:
        InputError: a file is missing or is no data set, none has a city of that split, their
            maps differ in size, or they come from different propagation models.
    """
    several = several_paths(paths)
    origin_of(several)
    found = [read_links(path, split) for path in several]
    links = [part for part in found if part is not None]
    if not links:
        raise InputError(
            f"{', '.join(map(str, several))} holds no link of split {split!r}; known splits: "
            f"{', '.join(SPLITS)}"
        )
    return links[0] if len(links) == 1 else joined(links)


def origin_of(paths: Paths) -> str:
    """The one propagation model that one data set or several come from, as text.

    Raises:
        InputError: a file is missing or is no data set, or they come from different models.
    """
    attributes = {path: ChannelDataset.open(path).attributes for path in several_paths(paths)}
    demand_one_origin(attributes)
    return origin(next(iter(attributes.values())))


def several_paths(paths: Paths) -> list[Path]:
    """One data set or several, as a list."""
    several = [paths] if isinstance(paths, str | Path) else paths
    return [SAMPLE if path == "sample" else Path(path) for path in several]


def read_links(path: Path, split: str) -> Links | None:
    """One data set's links, None if it has none of that split; see `load_links`."""
    dataset = ChannelDataset.open(path)
    cities = np.flatnonzero(np.array(dataset.splits) == split)
    kept = np.flatnonzero(np.isin(dataset.city_index, cities))
    if not len(kept):
        return None
    gain, ray_traced = dataset.maps(kept)
    x, y, z = dataset.transmitters_m[kept].T
    grid = dataset.grid
    return Links(
        height_m=np.stack([dataset.city(city).height_m for city in cities.tolist()]),
        city=np.searchsorted(cities, dataset.city_index[kept]),
        transmitter=np.stack(
            [(y - grid.origin_m[1]) / grid.spacing_m, (x - grid.origin_m[0]) / grid.spacing_m, z],
            axis=-1,
        ),
        gain_db=gain,
        ray_traced=ray_traced,
        altitude_m=np.array(dataset.altitudes_m),
        available=np.asarray(np.isfinite(gain).any(axis=(2, 3))),
        spacing_m=grid.spacing_m,
    )


def joined(parts: list[Links]) -> Links:
    """The links of several data sets as those of one.

    Raises:
        InputError: their maps differ in size.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.height_m.shape[1:] != first.height_m.shape[1:] or part.spacing_m != first.spacing_m:
            raise InputError(
                "data sets to be used together must have maps of one size; these have "
                f"{first.height_m.shape[1:]} cells of "
                f"{first.spacing_m:g} m and {part.height_m.shape[1:]} cells of {part.spacing_m:g} m"
            )
    altitudes = np.unique(np.concatenate([part.altitude_m for part in parts]))
    shape = (sum(map(len, parts)), len(altitudes), *first.height_m.shape[1:])
    gain, ray_traced = np.full(shape, np.nan, np.float16), np.zeros(shape, bool)
    available, start = np.zeros(shape[:2], bool), 0
    for part in parts:
        at = np.ix_(
            np.arange(start, start + len(part)), np.searchsorted(altitudes, part.altitude_m)
        )
        gain[at], ray_traced[at], available[at] = part.gain_db, part.ray_traced, part.available
        start += len(part)
    before = np.cumsum([0, *(len(part.height_m) for part in parts[:-1])])
    return Links(
        height_m=np.concatenate([part.height_m for part in parts]),
        city=np.concatenate([part.city + n for part, n in zip(parts, before, strict=True)]),
        transmitter=np.concatenate([part.transmitter for part in parts]),
        gain_db=gain,
        ray_traced=ray_traced,
        altitude_m=altitudes,
        available=available,
        spacing_m=first.spacing_m,
    )
