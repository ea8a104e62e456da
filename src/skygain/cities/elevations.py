"""What the numbers of a height raster mean: heights above the ground, or a surface with the terrain
still in it.

A map of heights above ground touches the ground nearly everywhere: most blocks of streets and
houses have a cell at zero. Where they have none, the terrain is in the numbers, and without a
terrain model nobody can tell a hill from a house.
"""

from __future__ import annotations

__all__ = [
    "MAX_HEIGHT_M",
    "UNITS_M",
    "Heights",
    "filled",
    "heights_above_ground",
    "heights_over_terrain",
]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError

MAX_HEIGHT_M = 1000.0
"""no building is higher"""

UNITS_M = {
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "us survey foot": 1200 / 3937,
    "us-ft": 1200 / 3937,
    "us_ft": 1200 / 3937,
    "cm": 0.01,
    "dm": 0.1,
    "mm": 0.001,
}
"""metres in the units that heights come in"""

_MAX_DEPTH_M = 100.0
"""a surface model minus a terrain model errs below zero, but not by more than this"""

_STREET_M = 2.0
"""what lies lower than this is at street level"""

_BLOCK_M = 100.0
"""side of the blocks that are asked whether they touch the ground"""

_RAISED_SHARE = 0.25
"""terrain is in the numbers if more of the blocks than this never touch the ground"""

_EVEN_M = 0.5
"""ground that varies by less is level"""

_SUNK_M = 1.0
"""level ground that lies lower than this below zero is no error of the heights"""

_NOISE_M = 0.5
"""two models of the same street differ by this much"""

_MASKED_TOP_M = 60.0
"""where everything but buildings is masked, the lowest building is lower than this"""

_MARKS = (-9999.0, -32768.0, -32767.0, -99999.0, -999.0)
"""numbers that stand for no data in files that do not say so"""

_NEED = (
    "give `terrain` (a file of the ground's height, or its height in metres where it is level), or "
    "'none' if these are heights above ground"
)


@dataclass(frozen=True)
class Heights:
    """A raster understood."""

    height_m: NDArray[np.float32]
    """``[row, col]`` height of what is built above the ground, 0 on open ground"""
    ground_m: NDArray[np.float32]
    """``[row, col]`` height of the ground, or one number"""
    counts: dict[str, int]
    """cells that were mended, by what was done"""
    remarks: tuple[str, ...] = ()
    """what was taken for what"""


def heights_above_ground(
    values_m: NDArray[np.float64], spacing_m: float, *, trusted: bool = False
) -> Heights:
    """Values that should be heights above ground; not finite where there is none.

    Args:
        values_m: ``[row, col]`` in metres.
        spacing_m: side of a cell.
        trusted: whether it was said that the terrain is not in them.

    Raises:
        InputError: they cannot be heights above ground, or the terrain is in them.
    """
    values, marked = _without_marks(values_m)
    known = np.isfinite(values)
    _check_known(known)
    low, high = float(values[known].min()), float(values[known].max())
    if low < -500.0 or high > 9000.0:
        _check_range(low, high)
    ground: float = 0.0
    remarks: tuple[str, ...] = ()
    lows = _block_lows(np.where(known, values, 0.0), spacing_m)
    sunk = float(np.median(lows))
    even = np.ptp(np.quantile(lows, [0.05, 0.95])) <= _EVEN_M
    if not trusted and even and (sunk < -_SUNK_M or _NOISE_M < sunk <= _STREET_M):
        ground, remarks = sunk, (f"the lowest level, {sunk:g} m, is taken as the ground",)
        values, low, high = values - sunk, low - sunk, high - sunk
    elif not trusted:
        _check_no_terrain(lows, low, high, known)
    _check_range(low, high)
    flat = known & (values > 0) & (values < _NOISE_M)
    height, counts = _roofs(np.where(flat, 0.0, values), known)
    counts[f"cells below {_NOISE_M:g} m, taken as open ground"] = int(flat.sum())
    counts["cells without data, taken as open ground"] -= marked
    counts["cells with a mark for no data, taken as open ground"] = marked
    return Heights(height, np.array(ground, np.float32), _occurred(counts), remarks)


def heights_over_terrain(
    values_m: NDArray[np.float64], ground_m: NDArray[np.float64], spacing_m: float
) -> Heights:
    """Values of a surface model, or of heights above ground, with the ground beneath them.

    Which of the two they are is told by the streets: at street level a surface model equals the
    terrain, and heights above ground are 0.

    Raises:
        InputError: the two models do not belong together.
    """
    values, marked = _without_marks(values_m)
    ground, gaps = filled(ground_m)
    known = np.isfinite(values)
    _check_known(known)
    above = values - ground
    on_ground = np.abs(above[known]) <= _STREET_M
    on_zero = np.abs(values[known]) <= _STREET_M
    remarks: tuple[str, ...] = ("the surface is taken as above sea level, minus the terrain",)
    if on_zero.mean() > on_ground.mean():
        lows = _block_lows(np.where(known, values, 0.0), spacing_m)
        _check_no_terrain(lows, float(values[known].min()), float(values[known].max()), known)
        above, remarks = values, ("the heights are taken as above ground, over the terrain",)
    elif on_ground.mean() < 0.01:
        raise InputError(
            f"the surface lies {float(np.median(above[known])):.4g} m from the terrain at its "
            "middle and nowhere touches it; give as `terrain` the model of the same place and "
            "vertical system"
        )
    _check_range(float(above[known].min()), float(above[known].max()))
    height, _ = _roofs(np.where(above < _NOISE_M, np.minimum(above, 0.0), above), known)
    counts = {
        "cells with a mark for no data, taken as open ground": marked,
        "cells beyond the terrain model, taken as its nearest": gaps,
        "cells without data, taken as open ground": int((~known).sum()) - marked,
        "cells more than 2 m below the terrain, taken as open ground": int(
            (above[known] < -_STREET_M).sum()
        ),
    }
    return Heights(height, ground.astype(np.float32), _occurred(counts), remarks)


def _without_marks(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Undeclared marks for no data (exactly one of the usual numbers) as NaN, and how many."""
    marked = np.isin(values, _MARKS) | (np.abs(values) > 1e30) & ~np.isinf(values)
    return (np.where(marked, np.nan, values), int(marked.sum())) if marked.any() else (values, 0)


def _check_known(known: NDArray[np.bool_]) -> None:
    if not known.any():
        raise InputError(
            "no cell has a value; choose another band (`height_field`) or `box`, or check the "
            "file's nodata value"
        )


def _block_lows(values: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    """The lowest values of each block, beneath which lie 2 % of it; a cell without data counts as
    open ground."""
    rows, cols = (max(1, round(n * spacing_m / _BLOCK_M)) for n in values.shape)
    strips = np.array_split(values, min(rows, values.shape[0]))
    return np.array(
        [
            float(np.quantile(block, 0.02))
            for strip in strips
            for block in np.array_split(strip, min(cols, values.shape[1]), axis=1)
        ]
    )


def _check_no_terrain(
    lows: NDArray[np.float64], low: float, high: float, known: NDArray[np.bool_]
) -> None:
    if low > _MASKED_TOP_M and not known.all():
        raise InputError(
            f"the values run from {low:g} to {high:g} m, so they are heights above sea level and "
            f"all else is masked; {_NEED}"
        )
    raised = float(np.mean(lows > _STREET_M))
    if raised > _RAISED_SHARE:
        raise InputError(
            f"the values run from {low:g} to {high:g} m and {raised:.0%} of the {_BLOCK_M:g} m "
            f"blocks have no cell at street level, so the terrain seems to be in them; {_NEED}"
        )
    if float(np.mean(lows < -_STREET_M)) > _RAISED_SHARE:
        raise InputError(
            f"the values run from {low:g} to {high:g} m and the ground lies below zero at several "
            f"levels, so the terrain seems to be in them; {_NEED}"
        )


def _check_range(low: float, high: float) -> None:
    if low < -_MAX_DEPTH_M or high > MAX_HEIGHT_M:
        raise InputError(
            f"values from {low:g} to {high:g} m are not building heights; expected metres above "
            f"ground from 0 to {MAX_HEIGHT_M:g}, with missing cells marked as nodata; {_NEED}"
        )


def _roofs(
    above_m: NDArray[np.float64], known: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], dict[str, int]]:
    below = known & (above_m < 0)
    counts = {
        "cells without data, taken as open ground": int((~known).sum()),
        "cells below ground, taken as open ground": int(below.sum()),
    }
    return np.where(known & ~below, above_m, 0.0).astype(np.float32), counts


def filled(ground: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """The terrain without gaps (a cell without takes the nearest that has one), and how many there
    were."""
    ground, _ = _without_marks(ground)
    missing = ~np.isfinite(ground)
    if missing.all():
        raise InputError("the terrain model does not reach the map; give a `terrain` of this place")
    if missing.any():
        from scipy.ndimage import distance_transform_edt

        nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
        ground = ground[tuple(nearest)]
    return ground, int(missing.sum())


def _occurred(counts: dict[str, int]) -> dict[str, int]:
    return {what: count for what, count in counts.items() if count}
