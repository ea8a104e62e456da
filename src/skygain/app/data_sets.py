"""`skygain dataset`: build from presets or own cities, import, describe."""

from __future__ import annotations

__all__ = ["run_build", "run_import", "run_info"]

from dataclasses import fields, replace
from typing import TYPE_CHECKING

from skygain.app.progress import Progress
from skygain.app.requests import DatasetBuildRequest, DatasetImportRequest, DatasetInfoRequest
from skygain.app.signals import told_of_signals

if TYPE_CHECKING:
    from skygain.datasets.own import OwnCities
    from skygain.datasets.presets import BuildConfig


def run_build(request: DatasetBuildRequest, progress: Progress) -> str:
    """Build the data set; returns what it holds."""
    from skygain.datasets.builder import build_dataset
    from skygain.datasets.presets import preset_config
    from skygain.datasets.summary import describe_dataset

    what: BuildConfig | OwnCities
    if request.preset is None:
        what = _own(request, progress)
    else:
        what = preset_config(request.preset)
        if request.altitudes_m is not None:
            what = replace(what, altitudes_m=request.altitudes_m)
    progress.phase("tracing cities")
    ended = "ended; finished cities are kept, the same command goes on"
    with told_of_signals(lambda: ended, ended):
        build_dataset(
            what,
            request.out,
            workers=request.workers,
            resume=request.resume,
            propagation=request.propagation,
            cluster=request.cluster,
            progress=lambda done, total, _left: progress(done, total),
        )
    return describe_dataset(request.out)


def _own(request: DatasetBuildRequest, progress: Progress) -> OwnCities:
    """The cities that were brought, read once; what was done to them is told."""
    from skygain.cities import CityOptions
    from skygain.datasets.own import own_cities

    progress.phase("reading cities")
    names = {one.name for one in fields(CityOptions)} & {one.name for one in request.asked()}
    cities = own_cities(
        [str(city) for city in request.cities],
        splits=request.splits,
        side=request.side,
        transmitters=request.transmitters,
        altitudes_m=request.altitudes_m or (10.0,),
        options=CityOptions(**{name: getattr(request, name) for name in names}),
        frequency_hz=request.frequency_hz,
        seed=request.seed,
    )
    for line in cities.notes:
        progress.note(line)
    return cities


def run_import(request: DatasetImportRequest, progress: Progress) -> str:
    """Import the maps; returns what the data set holds."""
    from skygain.datasets.gain_maps import read_gain_maps
    from skygain.datasets.importing import import_dataset
    from skygain.datasets.summary import describe_dataset
    from skygain.survey.territory import asked_city, asked_position

    progress.phase("reading maps")
    city = None if request.city is None else asked_city(request).city
    position = None
    if request.transmitter is not None:
        first = read_gain_maps(request.maps[0], gain=request.gain, spacing_m=request.spacing_m)
        position = asked_position(request.transmitter, first.grid)
    notes = import_dataset(
        request.maps,
        request.out,
        city=city,
        splits=request.splits,
        altitude_m=request.altitude_m,
        frequency_hz=request.frequency_hz,
        spacing_m=request.spacing_m,
        gain=request.gain,
        transmitter_m=position,
    )
    for line in notes:
        progress.note(line)
    return describe_dataset(request.out)


def run_info(request: DatasetInfoRequest, progress: Progress) -> str:
    """What a data set holds."""
    from skygain.datasets.summary import describe_dataset

    return describe_dataset(request.path)
