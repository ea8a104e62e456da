"""A data set out of gain maps that another program computed or somebody measured."""

from __future__ import annotations

__all__ = ["import_dataset"]

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import skygain
from skygain.city import City
from skygain.datasets.gain_maps import GainMaps, built_over, read_gain_maps, seen_on
from skygain.datasets.layout import CityRecord
from skygain.datasets.own import splits_of
from skygain.datasets.presets import DATA_VERSION
from skygain.datasets.writer import write_dataset
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.scenario import check_transmitter


def import_dataset(
    maps: Sequence[str | Path],
    path: str | Path,
    *,
    city: City | None = None,
    splits: Sequence[str] = ("T4",),
    altitude_m: float | None = None,
    frequency_hz: float | None = None,
    spacing_m: float | None = None,
    gain: str | None = None,
    transmitter_m: tuple[float, float, float] | None = None,
) -> list[str]:
    """Write gain maps as a data set. Each file is a city of its own; with ``city`` all are of it.

    Args:
        maps: files, see `skygain.datasets.gain_maps.read_gain_maps`; all of one size.
        path: the data set to write.
        city: the buildings; without it those of the files, or none.
        splits: split of each city, or one for all.
        altitude_m: of the maps, where the files do not say it; 10 m when left out.
        frequency_hz: carrier, where the files do not say it; 5 GHz when left out.
        spacing_m: side of a cell, for files that do not say it.
        gain: variable or band of the gain.
        transmitter_m: (x, y, z) where the files do not say it.

    Returns:
        What was assumed, a line each.

    Raises:
        InputError: a file cannot be used, or the files do not fit together.
    """
    read = [read_gain_maps(one, gain=gain, spacing_m=spacing_m) for one in maps]
    altitude = _common(read, "altitude_m", altitude_m, 10.0)
    frequency = _common(read, "frequency_hz", frequency_hz, 5e9)
    first = read[0]
    for one in read:
        if one.grid.shape != first.grid.shape or one.grid.spacing_m != first.grid.spacing_m:
            raise InputError(
                f"{first.name} has {first.grid.shape} cells of {first.grid.spacing_m:g} m, "
                f"{one.name} {one.grid.shape} of {one.grid.spacing_m:g} m; maps of a data set "
                "share one size: cut them, or make two data sets"
            )
    notes = [note for one in read for note in one.notes if transmitter_m is None]
    groups = [[one] for one in read] if city is None else [read]
    records = []
    for number, (group, split) in enumerate(zip(groups, splits_of(splits, groups), strict=True)):
        record, told = _record(number, group, city, split, altitude, transmitter_m)
        records.append(record)
        notes += told
    attributes = {
        "title": f"Imported maps: {', '.join(Path(one).name for one in maps)}",
        "data_version": DATA_VERSION,
        "propagation": "imported",
        "frequency_hz": frequency,
        "gain": "channel gain in dB as imported; cells inside buildings hold values that mean "
        "nothing",
        "tool": f"Skygain {skygain.__version__}, skygain dataset import",
    }
    local = Grid(first.grid.shape, first.grid.spacing_m)
    write_dataset(path, records, grid=local, altitudes_m=[altitude], attributes=attributes)
    return notes


def _common(read: Sequence[GainMaps], name: str, given: float | None, default: float) -> float:
    """What the files agree on; what is ``given`` counts before it."""
    found = {getattr(one, name) for one in read} - {None}
    if given is None and len(found) > 1:
        raise InputError(
            f"the files say `{name}` differently: {', '.join(f'{v:g}' for v in sorted(found))}; "
            f"give one `{name}`, or import them one by one"
        )
    return given if given is not None else found.pop() if found else default


def _record(
    number: int,
    group: Sequence[GainMaps],
    city: City | None,
    split: str,
    altitude_m: float,
    transmitter_m: tuple[float, float, float] | None,
) -> tuple[CityRecord, list[str]]:
    """One city with its links, in a frame of its own, and what was done to it."""
    grid = group[0].grid
    gain = np.concatenate([one.gain_db for one in group])
    if city is not None:
        if any(one.grid != grid for one in group):
            raise InputError(
                "maps of one `city` must lie on the same cells; import them one by one"
            )
        found = np.nan_to_num(seen_on(grid, city.grid, city.height_m))
    else:
        found = np.zeros(grid.shape) if group[0].height_m is None else group[0].height_m
    town = City(grid, np.asarray(found, dtype=np.float32), name=group[0].name)
    town, built = built_over(town, gain, altitude_m)
    notes = [f"{town.name}: {built} cells without a gain count as built up"] if built else []
    sites = np.concatenate([one.transmitters_m for one in group])
    if transmitter_m is not None:
        sites = np.tile(np.asarray(transmitter_m, dtype=float), (len(gain), 1))
    for k, site in enumerate(sites.tolist()):
        try:
            check_transmitter(town, (site[0], site[1], site[2]))
        except InputError as error:
            raise InputError(f"{town.name}, map {k}: {error}") from None
    lowest = np.nanmin(gain, axis=(1, 2), keepdims=True)
    filled = np.where(np.isfinite(gain), gain, lowest)[:, None]
    x, y = grid.origin_m
    record = CityRecord(
        number,
        split,
        town.height_m,
        np.empty((0, 5)),
        sites - (x, y, 0.0),
        filled,
        np.zeros(filled.shape, dtype=bool),
    )
    return record, notes
