"""The world a simulated survey flies in: a city, a transmitter, and the gain the transmitter really
has everywhere.

A packaged or built data set brings its truth along; for any other city it is computed here, by the
propagation model asked for.
"""

from __future__ import annotations

__all__ = ["World", "open_world", "parse_position"]

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.ground.errors import InputError
from skygain.scenario import check_transmitter

if TYPE_CHECKING:
    from skygain.datasets.store import ChannelDataset, Link

PROTOCOL_CROP = 96
"""side in cells of the map a survey covers in the paper"""


@dataclass(frozen=True, eq=False)
class World:
    """What the instrument looks up."""

    city: City
    """the map that is surveyed"""
    transmitter_m: tuple[float, float, float]
    """where the transmitter really is, in the city's metres; possibly outside the map"""
    truth_db: NDArray[np.float32]
    """``[row, col]`` gain at the altitude asked for"""
    ray_traced: NDArray[np.bool_] | None = None
    """``[row, col]`` cells a ray reached, when rays were traced"""


def parse_position(text: str) -> tuple[float, float, float]:
    """``"x,y"`` or ``"x,y,z"`` in metres; z is 1.5 m when left out.

    >>> parse_position("120, 80")
    (120.0, 80.0, 1.5)
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not np.isfinite(numbers).all():
        raise InputError(
            f"cannot read the position {text!r}; write x,y or x,y,z in metres, for example "
            "120,80,1.5, or 'random'"
        )
    x, y, *z = numbers
    return x, y, z[0] if z else 1.5


def _crop_corner(
    shape: tuple[int, int], side: int | None, rng: np.random.Generator
) -> tuple[int, int, tuple[int, int]]:
    """South-west cell and shape of a random window of ``side`` cells, as large as the map
    allows."""
    if side is None:
        return 0, 0, shape
    if side < 2:
        raise InputError(f"a crop needs at least 2 cells a side, got {side}; 96 is the paper's")
    window = min(side, shape[0]), min(side, shape[1])
    return (
        int(rng.integers(shape[0] - window[0] + 1)),
        int(rng.integers(shape[1] - window[1] + 1)),
        window,
    )


def _random_transmitter(city: City, rng: np.random.Generator) -> tuple[float, float, float]:
    """A random open-ground position 1.5 m up."""
    open_ground = np.argwhere(city.height_m <= 0)
    if len(open_ground) == 0:
        raise InputError(
            f"{city.name!r} has no open ground for a transmitter; give --transmitter x,y,z above a "
            "roof"
        )
    x, y = city.grid.xy_m(open_ground[rng.integers(len(open_ground))])
    return float(x), float(y), 1.5


def _dataset_and_link(spec: str) -> tuple[ChannelDataset, int | None] | None:
    """The data set and link that ``sample``, ``sample:1``, ``PATH.zarr.zip`` or ``PATH.zarr.zip:7``
    names; ``None`` for others."""
    from skygain.datasets.sample import open_sample
    from skygain.datasets.store import ChannelDataset

    name, _, tail = spec.rpartition(":") if spec.rpartition(":")[2].isdigit() else (spec, "", "")
    number = int(tail) if tail else None
    if name == "sample":
        return open_sample(), number
    if name.endswith(".zarr.zip"):
        return ChannelDataset.open(Path(name)), number
    return None


def _dataset_world(
    dataset: ChannelDataset,
    number: int | None,
    altitude_m: float,
    crop: int | None,
    rng: np.random.Generator,
) -> World:
    links = dataset.links(None, altitude_m)
    if not links:
        raise InputError(
            f"that data set has no map at {altitude_m:g} m; choose an altitude it holds (skygain "
            "dataset info)"
        )
    if number is None:
        number = links[int(rng.integers(len(links)))]
    if number not in links:
        raise InputError(
            f"that data set has no link {number} at {altitude_m:g} m; it has {len(links)}, from "
            f"{min(links)} to {max(links)}"
        )
    link: Link = dataset.link(number, altitude_m)
    row, col, window = _crop_corner(link.city.grid.shape, crop, rng)
    rows, cols = slice(row, row + window[0]), slice(col, col + window[1])
    return World(
        city=link.city.cropped(row, col, window),
        transmitter_m=tuple(float(v) for v in link.transmitter_m),  # type: ignore[arg-type]
        truth_db=link.truth_db[rows, cols],
        ray_traced=link.ray_traced[rows, cols],
    )


def open_world(
    spec: str,
    *,
    transmitter: str = "random",
    altitude_m: float = 10.0,
    propagation: str = "union",
    frequency_hz: float = 5e9,
    crop: int | None = PROTOCOL_CROP,
    spacing_m: float | None = None,
    crs: str | None = None,
    box: tuple[float, float, float, float] | None = None,
    rng: np.random.Generator,
) -> World:
    """The world named ``spec``.

    Args:
        spec: ``sample`` or ``sample:LINK`` (traced links that ship with the package),
            ``PATH.zarr.zip`` or ``PATH.zarr.zip:LINK`` (a data set), or a city as
            `skygain.cities.open_city` takes it: a seed, a height raster, footprints, a scene name.
        transmitter: ``"random"`` or a position as `parse_position` reads it, in the city's metres.
            A data set's links have theirs.
        altitude_m: altitude of the truth.
        propagation: name of the model that computes the truth of a city.
        frequency_hz: carrier frequency.
        crop: side in cells of a random window to survey; ``None`` for the whole map. A city read
            from a file is not cropped by the default of 96.
        spacing_m: cell size for cities read from files and scenes.
        crs: coordinate reference system of a city file that does not name its own.
        rng: draws the crop, the transmitter, the link.

    Raises:
        InputError: see `skygain.cities.open_city`; the transmitter is indoors; the data set has no
            such link.
    """
    found = _dataset_and_link(spec)
    if found is not None:
        if transmitter != "random":
            raise InputError(
                "the links of a data set bring their own transmitter; leave --transmitter out or "
                "choose another city"
            )
        return _dataset_world(*found, altitude_m, crop, rng)

    from skygain.cities import open_city
    from skygain.propagation import PROPAGATION

    model = PROPAGATION.factory(propagation)
    if propagation == "raytrace":
        raise InputError(
            "rays alone leave cells without any gain, so they cannot be surveyed; use "
            "--propagation union"
        )
    city = open_city(spec, spacing_m=spacing_m, crs=crs, box=box)
    if transmitter == "random":
        position = _random_transmitter(city, rng)
    else:
        position = parse_position(transmitter)
        check_transmitter(city, position)
    if crop == PROTOCOL_CROP and Path(spec).suffix:
        crop = None
    row, col, window = _crop_corner(city.grid.shape, crop, rng)
    rows, cols = slice(row, row + window[0]), slice(col, col + window[1])
    where = (city, np.array([position]), [altitude_m])
    seed, traced = int(rng.integers(2**31)), None
    if propagation == "union":
        from skygain.propagation.truth import trace_truth

        truth = trace_truth(*where, frequency_hz=frequency_hz, seed=seed)
        gain_db, traced = truth.gain_db[0, 0], truth.ray_traced[0, 0][rows, cols]
    else:
        gain_db = model(*where, frequency_hz=frequency_hz, seed=seed)[0, 0]
    return World(city.cropped(row, col, window), position, gain_db[rows, cols], traced)
