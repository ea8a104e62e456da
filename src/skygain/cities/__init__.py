"""Where cities come from: a random generator, height rasters, building footprints, and the scenes
of Sionna RT.

`open_city` takes any of them by name. Readers of files need the extra ``geo`` and scenes the extra
``raytrace``; both are loaded only when used.
"""

from __future__ import annotations

__all__ = [
    "ManhattanConfig",
    "Reading",
    "central_crop",
    "manhattan_city",
    "open_city",
    "random_crop",
    "read_city",
    "transmitter_sites",
]

from skygain.cities.crops import central_crop, random_crop
from skygain.cities.manhattan import ManhattanConfig, manhattan_city, transmitter_sites
from skygain.cities.opening import open_city, read_city
from skygain.frames import Reading
