"""Which cities, transmitters and altitudes a data set is built of.

A city's seed belongs to one split for good (T1 counts from 0, T2 from 1000, T3 from 2000, T4 from
3000), whatever the preset. So no predictor trained on one preset has seen a test city of another,
and the small presets are subsets of the paper's.
"""

from __future__ import annotations

__all__ = ["DATA_VERSION", "PRESETS", "BuildConfig", "preset_config"]

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.european import KINDS, european_city
from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
from skygain.cities.scenes import TOWNS, scene_part
from skygain.city import City
from skygain.datasets.layout import SPLITS
from skygain.ground.errors import InputError

DATA_VERSION = 2
"""version of the numbers: 0 came from noisy rays, 1 from rays whose diffraction was too strong at
grazing incidence; data sets of different versions are compared with nothing else"""

_SEEDS_PER_SPLIT = 1000


@dataclass(frozen=True)
class BuildConfig:
    """What a data set is built of; it follows from this and the installed releases alone.

    Raises:
        InputError: a number is out of range.
    """

    name: str
    """for the title"""
    cities: tuple[int, int, int, int]
    """cities of T1, T2, T3 and T4"""
    max_sites: int | None = None
    """transmitters per city, drawn from the outdoor ones of the lattice; all of them when
    ``None``"""
    altitudes_m: tuple[float, ...] = (10.0, 20.0, 30.0)
    """altitudes of the maps"""
    frequency_hz: float = 5.0e9
    """carrier frequency"""
    propagation: str = "union"
    """name of the propagation model"""
    seed: int = 0
    """for the choice of transmitters; the cities have seeds of their own"""
    city: ManhattanConfig = field(default_factory=ManhattanConfig)
    """how Manhattan cities are drawn"""
    kinds: tuple[str, ...] = ()
    """kinds of European towns and scenes of Sionna RT, by name, that take turns instead of
    Manhattan cities; of a scene each seed is another part"""

    def __post_init__(self) -> None:
        demands = {
            f"cities must be four numbers from 0 to {_SEEDS_PER_SPLIT}, not all 0": len(self.cities)
            == len(SPLITS)
            and all(0 <= n <= _SEEDS_PER_SPLIT for n in self.cities)
            and sum(self.cities) > 0,
            "max_sites must be 1 or more": self.max_sites is None or self.max_sites >= 1,
            "altitudes_m must be positive and different": 0
            < len(self.altitudes_m)
            == len(set(self.altitudes_m))
            and min(self.altitudes_m) > 0,
            "frequency_hz must be positive": self.frequency_hz > 0,
            "seed must be 0 or more": self.seed >= 0,
            f"kinds must be among {', '.join([*KINDS, *TOWNS])}": set(self.kinds)
            <= {*KINDS, *TOWNS},
        }
        for demand, met in demands.items():
            if not met:
                raise InputError(f"{demand}; got {self}")

    def drawn(self, seed: int) -> City:
        """The city of a seed."""
        if self.kinds:
            kind = self.kinds[seed % len(self.kinds)]
            return european_city(seed, KINDS[kind]) if kind in KINDS else scene_part(kind, seed)
        return manhattan_city(seed, self.city)

    def sites(self, seed: int, city: City) -> NDArray[np.float64]:
        """``[transmitter, (x, y, z)]`` of the city of a seed."""
        sites = transmitter_sites(city)
        if self.max_sites is None:
            return sites
        # the first of a shuffled list, so that fewer sites are a part of more sites
        order = np.random.default_rng([self.seed, seed]).permutation(len(sites))
        return sites[np.sort(order[: self.max_sites])]

    def as_data(self) -> dict[str, Any]:
        """What decides the numbers."""
        return asdict(self)

    @property
    def title(self) -> str:
        """Of the data set."""
        kind = (
            "Manhattan" if not self.kinds else "European" if self.kinds[0] in KINDS else "Scenes'"
        )
        return f"{kind} cities, {self.name}"

    @property
    def extent_m(self) -> float:
        """Side of the cities."""
        return self.city.extent_m

    @property
    def numbered_by(self) -> str:
        """What the number of a city is."""
        return "the city's seed"

    @property
    def city_seeds(self) -> list[tuple[int, str]]:
        """(seed, split) of every city, in the order of the file."""
        return [
            (_SEEDS_PER_SPLIT * k + j, split)
            for k, (split, n) in enumerate(zip(SPLITS, self.cities, strict=True))
            for j in range(n)
        ]


PRESETS = {
    config.name: config
    for config in (
        BuildConfig(name="paper", cities=(75, 25, 170, 30)),
        BuildConfig(name="light", cities=(60, 25, 60, 30), max_sites=6),
        BuildConfig(name="small", cities=(12, 4, 8, 6), max_sites=6),
        BuildConfig(name="tiny", cities=(1, 1, 1, 1), max_sites=2, altitudes_m=(10.0,)),
        BuildConfig(name="sample", cities=(1, 1, 1, 4), max_sites=3),
        BuildConfig(name="more-cities", cities=(200, 0, 0, 0), max_sites=6, altitudes_m=(10.0,)),
        BuildConfig(
            name="more-altitudes", cities=(100, 0, 40, 0), max_sites=6, altitudes_m=(20.0, 30.0)
        ),
        BuildConfig(name="more-kinds", cities=(150, 0, 0, 0), max_sites=6, kinds=tuple(KINDS)),
        BuildConfig(name="more-scenes", cities=(40, 0, 0, 0), max_sites=6, kinds=TOWNS),
        BuildConfig(
            name="large",
            cities=(0, 6, 0, 6),
            max_sites=1,
            altitudes_m=(10.0,),
            propagation="gudmundson",
            city=ManhattanConfig(extent_m=1024.0, blocks=10),
        ),
    )
}
"""``paper`` is the evaluation protocol's data set, ``light`` has its test cities and a part of the
others with up to 6 transmitters each, ``small`` serves to develop with, ``tiny`` to see that
everything works; ``sample`` is what ships inside the package; ``more-cities`` are training cities
to add to another data set (10 m only), ``more-altitudes`` has the first 100 of them and 40 cities
of T3 at 20 and 30 m; ``more-kinds`` are 150 towns with European street patterns, centres, estates
and suburbs in turn, ``more-scenes`` 40 parts of Sionna RT's scenes of real towns (needs the extra
``raytrace``); ``large`` has maps of 256 × 256 cells for swarms of many UAVs, Gudmundson fields over
cities of 10 × 10 blocks, and is built in seconds"""


def preset_config(name: str) -> BuildConfig:
    """The configuration called ``name``.

    Raises:
        InputError: there is no such preset.
    """
    if name not in PRESETS:
        raise InputError(f"unknown preset {name!r}; known: {', '.join(PRESETS)}")
    return PRESETS[name]
