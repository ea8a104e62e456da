"""The world a simulated survey flies in: a city, a transmitter, and the gain the transmitter really
has everywhere.

A packaged or built data set brings its truth along, and so does a map of gains; for any other city
the truth is computed here, by the propagation model asked for.
"""

from __future__ import annotations

__all__ = ["World", "open_world", "simulated_instrument"]

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.ground.errors import InputError
from skygain.scenario import Scenario, check_transmitter
from skygain.survey.requests import PlaceRequest
from skygain.survey.territory import above_zero, asked_city, asked_position, at_sea_level

if TYPE_CHECKING:
    from skygain.cities import Reading
    from skygain.datasets.store import ChannelDataset, Link
    from skygain.instruments.base import Instrument

PROTOCOL_CROP = 96
"""side in cells of the map a survey covers in the paper, taken where nothing is asked for"""


@dataclass(frozen=True, eq=False)
class World:
    """What the instrument looks up."""

    city: City
    """the map that is surveyed"""
    transmitter_m: tuple[float, float, float]
    """where the transmitter really is, in the city's metres; possibly outside the map"""
    truth_db: NDArray[np.float32]
    """``[row, col]`` gain at the altitude of the map"""
    ray_traced: NDArray[np.bool_] | None = None
    """``[row, col]`` cells a ray reached, when rays were traced"""
    altitude_m: float = 10.0
    """altitude of flight"""
    frequency_hz: float = 5e9
    """carrier frequency"""
    datum_m: float | None = None
    """height above the sea of the altitude's zero, where the flight keeps a level"""
    source: Reading | None = None
    """the city as it was read, with what its reader assumed; ``None`` for a data set"""
    map_altitude_m: float | None = None
    """altitude of the map, where it is not that of flight"""
    flown_db: NDArray[np.float32] | None = None
    """``[row, col]`` gain at the altitude of flight, where it is not that of the map"""

    def scenario(self) -> Scenario:
        """What may be known of it, the transmitter included."""
        return Scenario(
            self.city,
            uav_altitude_m=self.altitude_m,
            prediction_altitude_m=self.map_altitude_m or self.altitude_m,
            transmitter_m=self.transmitter_m,
            frequency_hz=self.frequency_hz,
            datum_m=self.datum_m,
        )

    def instrument(self, noise_db: float = 0.0, rng: np.random.Generator | int = 0) -> Instrument:
        """Receivers that measure in it."""
        heard_db = self.truth_db if self.flown_db is None else self.flown_db
        return simulated_instrument(heard_db, noise_db, np.random.default_rng(rng))


def simulated_instrument(
    truth_db: NDArray[np.floating], noise_db: float, rng: np.random.Generator
) -> Instrument:
    """Receivers that look ``truth_db[row, col]`` up, exactly or with Gaussian noise."""
    from skygain.instruments.simulated import NoiseConfig, NoisyInstrument, PerfectInstrument

    if noise_db == 0:
        return PerfectInstrument(truth_db)
    return NoisyInstrument(truth_db, NoiseConfig(std_db=noise_db), rng)


def _crop_corner(
    shape: tuple[int, int], side: int, rng: np.random.Generator
) -> tuple[int, int, tuple[int, int]]:
    """South-west cell and shape of a random window of ``side`` cells, as large as the map
    allows; the whole map for 0."""
    if side == 0:
        return 0, 0, shape
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
            f"{city.name!r} has no open ground for a transmitter; give `transmitter=x,y,z` above a "
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
    if name.endswith(".zarr.zip") or _holds_zarr(name):
        return ChannelDataset.open(name), number
    return None


def _holds_zarr(name: str) -> bool:
    """Whether ``name`` is a zip with a data set in it, however it is called."""
    if not name.endswith(".zip") or not zipfile.is_zipfile(name):
        return False
    with zipfile.ZipFile(name) as archive:
        return "zarr.json" in archive.namelist()


def _dataset_world(
    dataset: ChannelDataset,
    number: int | None,
    altitude_m: float,
    map_altitude_m: float | None,
    frequency_hz: float | None,
    crop: int,
    rng: np.random.Generator,
) -> World:
    if frequency_hz is not None and not isclose(frequency_hz, dataset.frequency_hz, rel_tol=1e-6):
        raise InputError(
            f"the links of that data set were traced at {dataset.frequency_hz / 1e9:g} GHz, not at "
            f"{frequency_hz / 1e9:g} GHz; leave `frequency_hz` out, or choose a city whose "
            "truth is computed"
        )
    links = dataset.links(None, altitude_m)
    for wanted_m in (altitude_m, map_altitude_m):
        if wanted_m is not None and not dataset.links(None, wanted_m):
            raise InputError(
                f"that data set has no map at {wanted_m:g} m; choose an altitude it holds (skygain "
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
    mapped = link if map_altitude_m is None else dataset.link(number, map_altitude_m)
    return World(
        city=link.city.cropped(row, col, window),
        transmitter_m=tuple(float(v) for v in link.transmitter_m),  # type: ignore[arg-type]
        truth_db=mapped.truth_db[rows, cols],
        ray_traced=mapped.ray_traced[rows, cols],
        altitude_m=altitude_m,
        frequency_hz=dataset.frequency_hz,
        map_altitude_m=map_altitude_m,
        flown_db=None if map_altitude_m is None else link.truth_db[rows, cols],
    )


def _mapped_world(place: PlaceRequest, altitude_m: float, rng: np.random.Generator) -> World:
    """The world of a map of gains, with the buildings of the city, of the file, or none."""
    from skygain.cities import Reading
    from skygain.datasets.gain_maps import built_over, read_gain_maps, seen_on

    assert place.truth is not None
    if getattr(place, "above_sea", False):
        raise InputError("`above_sea` does not go with `truth`, whose map is above the ground")
    maps = read_gain_maps(place.truth, spacing_m=place.spacing_m)
    notes = list(maps.notes)
    if len(maps.gain_db) > 1:
        number = int(rng.integers(len(maps.gain_db)))
        notes.append(f"map {number} of {len(maps.gain_db)} in {place.truth.name} is flown")
    else:
        number = 0
    gain, grid = maps.gain_db[number], maps.grid
    x, y, z = maps.transmitters_m[number].tolist()
    counts: dict[str, int] = {}
    if place.city is not None:
        if _dataset_and_link(place.city) is not None:
            raise InputError("a data set brings its own truth; leave `truth` out, or `city`")
        reading = asked_city(place)
        city, notes = reading.city, [*reading.remarks, *notes]
        counts = dict(reading.counts)
        gain = seen_on(city.grid, grid, gain)
    else:
        height = maps.height_m
        if height is None:
            height = np.zeros(grid.shape, np.float32)
        city = City(grid, height, name=maps.name)
    if maps.altitude_m is not None and not isclose(maps.altitude_m, altitude_m):
        notes.append(f"{place.truth.name} is at {maps.altitude_m:g} m, and so is the flight")
        altitude_m = maps.altitude_m
    city, built = built_over(city, gain, altitude_m)
    if built:
        counts["cells without a gain count as built up"] = built
    if place.transmitter != "random":
        x, y, z = asked_position(place.transmitter, city.grid)
        notes = [note for note in notes if "where the transmitter is" not in note]
    check_transmitter(city, (x, y, z))
    row, col, window = _crop_corner(city.grid.shape, place.crop or 0, rng)
    rows, cols = slice(row, row + window[0]), slice(col, col + window[1])
    return World(
        city.cropped(row, col, window),
        (x, y, z),
        np.where(np.isfinite(gain), gain, np.nanmin(gain))[rows, cols].astype(np.float32),
        None,
        altitude_m,
        place.frequency_hz or maps.frequency_hz or place.carrier_hz,
        source=Reading(city, counts, tuple(notes)),
    )


def open_world(
    place: PlaceRequest | str,
    *,
    altitude_m: float = 10.0,
    map_altitude_m: float | None = None,
    rng: np.random.Generator | int = 0,
    told: Callable[[str], None] = lambda phase: None,
) -> World:
    """The world that ``place`` asks for, with the truth at the altitudes of flight and map.

    Args:
        place: a request; a text stands for ``PlaceRequest(city=text)``. Without a city, the
            packaged sample.
        altitude_m: altitude of flight.
        map_altitude_m: altitude of the map; that of flight when left out.
        rng: draws the window, the transmitter, the link; a number is a seed.
        told: hears what is done next.

    Raises:
        InputError: see `skygain.cities.read_city`; the transmitter is indoors; the data set has no
            such link.
    """
    if isinstance(place, str):
        place = PlaceRequest(city=place)
    rng = np.random.default_rng(rng)
    if map_altitude_m is not None and isclose(map_altitude_m, altitude_m):
        map_altitude_m = None
    if place.truth is not None:
        if map_altitude_m is not None:
            raise InputError(
                "a `truth` is at one altitude, so the map cannot have another than the flight; "
                "leave `map_altitude_m` out"
            )
        told("reading the truth")
        return _mapped_world(place, altitude_m, rng)
    spec = place.city or "sample"
    told("reading the city")
    found = _dataset_and_link(spec)
    if found is not None:
        if place.transmitter != "random":
            raise InputError(
                "the links of a data set bring their own transmitter; leave `transmitter` out or "
                "choose another city"
            )
        side = PROTOCOL_CROP if place.crop is None else place.crop
        return _dataset_world(*found, altitude_m, map_altitude_m, place.frequency_hz, side, rng)

    from skygain.propagation import PROPAGATION, RAYS_ALONE

    model = PROPAGATION.factory(place.propagation)
    if place.propagation in RAYS_ALONE:
        raise InputError(
            "rays alone leave cells without any gain, so they cannot be surveyed; give "
            "`propagation=union`"
        )
    reading = asked_city(place)
    city, datum_m = reading.city, None
    if place.transmitter == "random":
        position = _random_transmitter(city, rng)
    else:
        position = asked_position(place.transmitter, city.grid)
        check_transmitter(city, position)
    if getattr(place, "above_sea", False):
        city, altitude_m, found_m, datum_m = at_sea_level(city, altitude_m, position)
        position = found_m or position
        if map_altitude_m is not None:
            map_altitude_m = above_zero(map_altitude_m, datum_m)
    if place.crop is not None:
        side = place.crop
    else:
        side = 0 if Path(spec).suffix else PROTOCOL_CROP
    row, col, window = _crop_corner(city.grid.shape, side, rng)
    rows, cols = slice(row, row + window[0]), slice(col, col + window[1])
    told(f"computing the truth ({place.propagation})")
    altitudes_m = [altitude_m] if map_altitude_m is None else [map_altitude_m, altitude_m]
    where = (city, np.array([position]), altitudes_m)
    seed, traced = int(rng.integers(2**31)), None
    if place.propagation == "union":
        from skygain.propagation.truth import RELIEF, trace_truth

        truth = trace_truth(*where, frequency_hz=place.carrier_hz)
        gain_db, traced = truth.gain_db[0], truth.ray_traced[0, 0][rows, cols]
        if not city.is_level:
            reading = replace(reading, remarks=(*reading.remarks, RELIEF))
    else:
        gain_db = model(*where, frequency_hz=place.carrier_hz, seed=seed)[0]
    window_city = city.cropped(row, col, window)
    return World(
        window_city,
        position,
        gain_db[0][rows, cols],
        traced,
        altitude_m,
        place.carrier_hz,
        datum_m,
        reading,
        map_altitude_m,
        None if map_altitude_m is None else gain_db[1][rows, cols],
    )
