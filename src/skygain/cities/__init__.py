"""Where cities come from: a random generator, height rasters, building footprints, 3D city models,
and the scenes of Sionna RT.

`open_city` takes any of them by name. Readers of files need the extra ``geo`` and scenes the extra
``raytrace``; both are loaded only when used.
"""

from __future__ import annotations

__all__ = [
    "CityOptions",
    "EuropeanConfig",
    "ManhattanConfig",
    "Reading",
    "manhattan_city",
    "open_city",
    "read_city",
    "transmitter_sites",
]

from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
from skygain.cities.opening import open_city, read_city
from skygain.cities.reading import CityOptions, Reading
