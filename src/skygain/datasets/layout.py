"""The file layout of a data set, in one place for its reader and its writer.

A data set is one zip file that holds a Zarr (version 3) group, which `xarray.open_zarr` reads too.
Cities are rasters and rectangles; links are transmitters with their gain maps, ordered by city.

| variable | dimensions | type | meaning |
| --- | --- | --- | --- |
| `height_m` | city, y, x | float16 | building height at the cell's centre, 0 = street; row 0 =
smallest y |
| `building` | city, building, edge | float32 | rectangles x0, y0, x1, y1, height in metres, padded
with NaN |
| `split` | city | text | T1, T2, T3 or T4 |
| `city_index` | link | int16 | position along `city` |
| `tx_m` | link, axis | float32 | transmitter x, y, z in metres |
| `gain_db` | link, altitude, y, x | float16 | channel gain in dB; all NaN where an altitude was not
computed |
| `ray_traced` | link, altitude, y, x | bool | whether a ray reached the cell |

with the coordinates `city` (a number of the city's own, for generated cities their seed),
`altitude`, `y`, `x`, `axis`, `edge`.
"""

from __future__ import annotations

__all__ = ["AXIS", "EDGE", "SPLITS", "VARIABLES", "CityRecord"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SPLITS = ("T1", "T2", "T3", "T4")
"""train predictors, validate them, train policies, test"""
AXIS = ("x", "y", "z")
EDGE = ("x0", "y0", "x1", "y1", "height")

VARIABLES: dict[str, tuple[tuple[str, ...], str]] = {
    "height_m": (("city", "y", "x"), "<f2"),
    "building": (("city", "building", "edge"), "<f4"),
    "split": (("city",), "<U2"),
    "city_index": (("link",), "<i2"),
    "tx_m": (("link", "axis"), "<f4"),
    "gain_db": (("link", "altitude", "y", "x"), "<f2"),
    "ray_traced": (("link", "altitude", "y", "x"), "|b1"),
    "city": (("city",), "<i2"),
    "altitude": (("altitude",), "<f4"),
    "y": (("y",), "<f4"),
    "x": (("x",), "<f4"),
    "axis": (("axis",), "<U1"),
    "edge": (("edge",), "<U6"),
}
"""name: (dimensions, type as written); a reader accepts any type of the same kind"""


@dataclass(frozen=True, eq=False)
class CityRecord:
    """One city with all its links, as stored."""

    number: int
    """the city's own number, its seed if it was generated; the coordinate ``city``"""
    split: str
    """one of `SPLITS`"""
    height_m: NDArray[np.floating]
    """``[y, x]`` building heights, 0 on the street"""
    building: NDArray[np.floating]
    """``[building, (x0, y0, x1, y1, height)]`` rectangles in metres"""
    tx_m: NDArray[np.floating]
    """``[link, (x, y, z)]`` transmitters"""
    gain_db: NDArray[np.floating]
    """``[link, altitude, y, x]`` channel gain, NaN where an altitude was not computed"""
    ray_traced: NDArray[np.bool_]
    """``[link, altitude, y, x]`` whether a ray reached the cell"""
