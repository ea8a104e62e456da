"""The surveys that a comparison flies: which link, which crop, where the UAVs start.

The list follows from the data set and a seed alone, so every predictor and planner meets the same
surveys and their results can
be compared in pairs. Each case draws from a random stream of its own, keyed by seed and link:
asking for more surveys, for another split, for more UAVs or for the other kind of start leaves the
crops of all other cases as they were.
"""

from __future__ import annotations

__all__ = ["FREE_SHARE", "Case", "largest_part", "survey_cases"]

from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from skygain.datasets.crops import cropped_link
from skygain.datasets.link import Link
from skygain.datasets.store import ChannelDataset
from skygain.flight.starts import start_cells
from skygain.grid import random_corner
from skygain.ground.errors import InputError
from skygain.scenario import Scenario, check_transmitter

_CROP, _START, _SURVEY, _ORDER = range(4)
"""the random streams of a case, and the one that orders the links of a city"""
FREE_SHARE = 0.25
"""a crop whose largest connected flyable part is smaller than this is drawn again"""
_DRAWS = 100


@dataclass(frozen=True)
class Case:
    """One survey to fly. It holds numbers only, so it is cheap to send to another process, which
    reads the maps itself."""

    path: str
    """file of the data set"""
    link: int
    """position of the link in the data set"""
    city_index: int
    """position of the link's city in the data set"""
    split: str
    """split of the city"""
    altitude_m: float
    """altitude of flight and of prediction"""
    row: int
    """row of the city that is row 0 of the crop"""
    col: int
    """column of the city that is column 0 of the crop"""
    shape: tuple[int, int]
    """rows and columns of the crop"""
    starts: tuple[tuple[int, int], ...]
    """(row, col) in the crop where each UAV starts"""
    seed: int
    """seed for whatever the survey itself draws"""

    @property
    def start_cells(self) -> NDArray[np.int64]:
        """``[uav, (row, col)]`` cells of the crop where the UAVs start."""
        return np.array(self.starts, dtype=np.int64)

    @property
    def crop(self) -> Link:
        """The cropped link, in a frame of its own."""
        return _crop(self.path, self.link, self.altitude_m, self.row, self.col, self.shape)

    @property
    def truth_db(self) -> NDArray[np.float32]:
        """``[row, col]`` channel gain on the crop; means nothing inside buildings."""
        return self.crop.truth_db

    @property
    def ray_traced(self) -> NDArray[np.bool_]:
        """``[row, col]`` whether a ray reached the cell."""
        return self.crop.ray_traced

    def scenario(self, *, transmitter_known: bool = True) -> Scenario:
        """What the predictor and the planner may know of this survey."""
        return Scenario(
            city=self.crop.city,
            uav_altitude_m=self.altitude_m,
            prediction_altitude_m=self.altitude_m,
            transmitter_m=self.crop.transmitter_m if transmitter_known else None,
            frequency_hz=_dataset(self.path).frequency_hz,
        )

    def rng(self, stream: int = 0) -> np.random.Generator:
        """A generator for the survey; different ``stream`` numbers (planner, noise, …) are
        independent of each other."""
        return np.random.default_rng([self.seed, stream])


def survey_cases(
    dataset: ChannelDataset,
    split: str,
    *,
    n_uavs: int = 3,
    start: str = "cluster",
    altitude_m: float = 10.0,
    max_surveys: int | None = None,
    seed: int = 0,
    crop_shape: tuple[int, int] = (96, 96),
) -> list[Case]:
    """The surveys of ``split``, one per link.

    Args:
        dataset: where the links are.
        split: ``"T1"`` to ``"T4"``.
        n_uavs: UAVs per survey.
        start: ``"cluster"`` or ``"spread"``, see `skygain.flight.starts`.
        altitude_m: altitude of flight and of prediction.
        max_surveys: at most so many, spread over the cities: one link of each city, then a second
            of each, and so on. A shorter list is the beginning of a longer one. All links, city by
            city, when left out.
        seed: another seed gives other crops and starts.
        crop_shape: rows and columns of the crop.

    Returns:
        The cases. All start cells lie in the largest connected part of the crop's flyable cells.
        Links whose transmitter stands in a cell that counts as built up are left out.

    Raises:
        InputError: unknown split or altitude, no links at that altitude, a crop larger than the
            map, or no room for the swarm.
    """
    if max_surveys is not None and max_surveys < 1:
        raise InputError(
            f"max_surveys must be 1 or more, got {max_surveys}; leave it out to fly all surveys"
        )
    links = [i for i in dataset.links(split, altitude_m) if _stands_outdoors(dataset, i)]
    if not links:
        raise InputError(
            f"split {split} of {dataset.path} has no links at {altitude_m:g} m; choose another "
            "split or altitude"
        )
    if max_surveys is not None:
        links = _spread(dataset, links, seed)[:max_surveys]
    return [_case(dataset, link, n_uavs, start, altitude_m, seed, crop_shape) for link in links]


def _spread(dataset: ChannelDataset, links: list[int], seed: int) -> list[int]:
    """The links with one of each city first, then a second of each, …; which one is random, lest it
    always be the south-west."""
    ranked = []
    for i, group in groupby(links, key=lambda link: int(dataset.city_index[link])):
        order = np.random.default_rng([seed, _ORDER, i]).permutation(np.array(list(group)))
        ranked += [(rank, i, int(link)) for rank, link in enumerate(order)]
    return [link for _, _, link in sorted(ranked)]


def _stands_outdoors(dataset: ChannelDataset, link: int) -> bool:
    x, y, z = dataset.transmitters_m[link].tolist()
    try:
        check_transmitter(dataset.city(int(dataset.city_index[link])), (x, y, z))
    except InputError:
        return False
    return True


def _case(
    dataset: ChannelDataset,
    link: int,
    n_uavs: int,
    start: str,
    altitude_m: float,
    seed: int,
    shape: tuple[int, int],
) -> Case:
    """Draw crop and start of one link's survey."""
    i = int(dataset.city_index[link])
    city = dataset.city(i)
    crops = np.random.default_rng([seed, _CROP, link])
    places = np.random.default_rng([seed, _START, link])
    for _ in range(_DRAWS):
        row, col = random_corner(city.grid.shape, shape, crops)
        cropped = city.cropped(row, col, shape, rebase=True)
        free = largest_part(~cropped.obstructed(altitude_m))
        if free.sum() < max(n_uavs, FREE_SHARE * free.size):
            continue
        scenario = Scenario(
            city=cropped, uav_altitude_m=altitude_m, prediction_altitude_m=altitude_m, no_fly=~free
        )
        starts = start_cells(start, scenario, n_uavs, places)
        return Case(
            path=str(dataset.path),
            link=link,
            city_index=i,
            split=dataset.splits[i],
            altitude_m=float(altitude_m),
            row=row,
            col=col,
            shape=(int(shape[0]), int(shape[1])),
            starts=tuple((int(r), int(c)) for r, c in starts),
            seed=int(np.random.SeedSequence([seed, _SURVEY, link]).generate_state(1)[0]),
        )
    raise InputError(
        f"link {link} of {dataset.path}: no crop of {shape} cells in {_DRAWS} draws has a "
        "connected quarter free for flight at "
        f"{altitude_m:g} m and room for {n_uavs} UAVs; fly higher, take a larger crop or fewer UAVs"
    )


def largest_part(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest 4-connected part of ``free[row, col]``."""
    labels, count = ndimage.label(free)
    if count == 0:
        return free
    return labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))


@lru_cache(maxsize=4)
def _dataset(path: str) -> ChannelDataset:
    """The data set at ``path``, opened once per process."""
    return ChannelDataset.open(path)


@lru_cache(maxsize=8)
def _crop(
    path: str, link: int, altitude_m: float, row: int, col: int, shape: tuple[int, int]
) -> Link:
    return cropped_link(_dataset(path).link(link, altitude_m), row, col, shape)
