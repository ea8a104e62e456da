"""A recording brought onto a grid: one value per cell, with how sure it is.

Readings of one cell are averaged in dB. The beliefs of this package are normal in dB, and shadowing
is what is mapped: the dB mean estimates its centre. A mean of powers would lie higher by (ln 10 /
20) σ² dB for a spread of σ dB (1.8 dB at σ = 4 dB), by more in cells that fade more, and a single
strong reading would decide it.
"""

from __future__ import annotations

__all__ = ["GriddedRecording", "bounds_of_both", "grid_for", "on_grid"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.frames import (
    MAX_CELLS,
    Bounds,
    box_in_metres,
    grid_over,
    metric_crs,
    parse_crs,
    transformed_bounds,
)
from skygain.grid import Grid
from skygain.ground.errors import InputError, require
from skygain.instruments.recording import FLOOR_STD_DB, Recording
from skygain.measurements import Measurements

_POOLED_READINGS = 4.0
"""a cell's own spread is mixed with the spread of all cells as if the latter came from this many
readings of its own"""

_FAR = 10.0
"""a reading more than so many times the map's size away belongs to another place"""

_SAMPLED = 20_000
_MARGIN = 0.0002
"""degrees around a map that is to hold city and readings"""
_FEWEST_RASTER = 9
_FEW = 50
"""strays are told from so many readings on"""

_WGS84 = "EPSG:4326"


@dataclass(frozen=True, eq=False)
class GriddedRecording:
    """A recording on a grid: the cells that have readings, in map order, and what they read. Arrays
    are read-only."""

    grid: Grid
    """the map"""
    cell: NDArray[np.int64]
    """``[k, (row, col)]`` cells with at least one reading"""
    level_db: NDArray[np.float64]
    """``[k]`` mean in dB of the cell's distinct readings"""
    noise_std_db: NDArray[np.float64]
    """``[k]`` standard deviation of that mean"""
    spread_db: NDArray[np.float64]
    """``[k]`` sample standard deviation of the cell's distinct readings; NaN where there is one
    only"""
    count: NDArray[np.int64]
    """``[k]`` readings in the cell, copies included"""
    distinct: NDArray[np.int64]
    """``[k]`` readings that differ in position or level; a logger that polls faster than the phone
    measures writes copies"""
    censored: NDArray[np.bool_]
    """``[k]`` every reading of the cell was at the receiver's floor"""
    outside: int
    """readings that lie off the map"""
    quantity: str
    """``"gain"`` in dB or ``"power"`` in dBm"""
    source: str
    """where the recording came from"""
    notes: tuple[str, ...] = ()
    """what was mended, assumed or left out on the way here, a line each"""

    def __post_init__(self) -> None:
        for name in (
            "cell",
            "level_db",
            "noise_std_db",
            "spread_db",
            "count",
            "distinct",
            "censored",
        ):
            getattr(self, name).flags.writeable = False

    def __len__(self) -> int:
        return len(self.cell)

    @property
    def recorded(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells with a reading."""
        mask = np.zeros(self.grid.shape, dtype=bool)
        mask[self.cell[:, 0], self.cell[:, 1]] = True
        return mask

    def measurements(self) -> Measurements:
        """The cells' values as measurements, in map order."""
        return Measurements.at(
            self.cell, self.level_db, noise_std_db=self.noise_std_db, censored=self.censored
        )


def on_grid(
    recording: Recording, grid: Grid, *, floor_std_db: float = FLOOR_STD_DB
) -> GriddedRecording:
    """One value per cell of ``grid``.

    With m distinct readings y in a cell, the value is their mean ȳ and its standard deviation is
    √(s²/m + f²), where f is ``floor_std_db`` and s² = (4 p² + Σ(y − ȳ)²) / (4 + m − 1) mixes the
    cell's own spread with p², the spread pooled over all
    cells: a single reading is as uncertain as readings of one cell usually are. Where the file
    states each reading's standard
    deviation σ, it is believed instead: √(Σσ²)/m. Readings that agree in position and level count
    once.

    Raises:
        InputError: no reading lies on the map, the map has no CRS to place latitudes with, or x and
            y are in another frame.
    """
    if not 0 <= floor_std_db < np.inf:
        raise InputError(
            f"floor_std_db must be 0 dB or more, got {floor_std_db}; {FLOOR_STD_DB:g} is usual"
        )
    xy_m = _metres(recording, grid.crs)
    cells, on_map = _cells_of(xy_m, grid)
    if not on_map.any():
        raise InputError(_all_outside(recording, grid))
    noise = np.zeros(len(recording)) if recording.noise_std_db is None else recording.noise_std_db
    floored = np.zeros(len(recording)) if recording.censored is None else recording.censored
    keys = [grid.flat(cells), *xy_m.T, recording.level_db, noise, floored]
    if not on_map.all():
        keys = [key[on_map] for key in keys]
    order = _sorted(keys)
    rows = [key[order] for key in keys]
    first = np.r_[True, rows[0][1:] != rows[0][:-1]]
    everyone, count = rows[0][first], np.diff(np.flatnonzero(np.r_[first, True]))
    new = first.copy()
    for key in rows[1:]:
        new[1:] |= key[1:] != key[:-1]
    flat, _, _, level, noise, floored = (key[new] for key in rows)
    group = np.cumsum(np.r_[False, flat[1:] != flat[:-1]])
    distinct = np.bincount(group)
    mean = np.bincount(group, level) / distinct
    squares = np.bincount(group, (level - mean[group]) ** 2)
    if recording.noise_std_db is None:
        freedom = max(1, len(level) - len(mean))
        own = (_POOLED_READINGS * squares.sum() / freedom + squares) / (
            _POOLED_READINGS + distinct - 1
        )
        std = np.sqrt(own / distinct + floor_std_db**2)
    else:
        std = np.sqrt(np.bincount(group, noise**2)) / distinct
    return GriddedRecording(
        grid=grid,
        cell=np.stack(np.divmod(everyone, grid.shape[1]), axis=-1),
        level_db=mean,
        noise_std_db=std,
        spread_db=np.where(distinct > 1, np.sqrt(squares / np.maximum(distinct - 1, 1)), np.nan),
        count=count,
        distinct=distinct,
        censored=np.bincount(group, floored) == distinct,
        outside=int((~on_map).sum()),
        quantity=recording.quantity,
        source=recording.source,
        notes=(*recording.notes, *_off_map(recording, grid, xy_m, on_map)),
    )


def grid_for(
    recording: Recording, spacing_m: float | None = 4.0, box: Bounds | None = None
) -> Grid:
    """A grid that holds the recording: in the UTM zone of its centre if the recording is
    georeferenced, else in its own frame.

    Args:
        recording: what is to be mapped.
        spacing_m: side of a cell; ``None`` takes that of the readings' own raster, if their x and y
            stand on one, and 4 m otherwise.
        box: (west, south, east, north) of the map, in degrees or in the metres of the grid; all
            readings and a cell around them when left out.

    Raises:
        InputError: the box or the spacing makes no sense, or the map would be too large.
    """
    raster = _raster(recording) if spacing_m is None else None
    if raster is not None and box is None:
        return raster
    spacing_m = 4.0 if spacing_m is None else spacing_m
    if not 0 < spacing_m < np.inf:
        raise InputError(
            f"`spacing_m` must be a positive number of metres, got {spacing_m}; 4 is usual"
        )
    source = parse_crs(_WGS84 if recording.latlon is not None else recording.crs)
    points = recording.xy_m if recording.latlon is None else recording.latlon[:, ::-1]
    assert points is not None
    if (
        box is not None
        and recording.latlon is not None
        and np.abs(np.asarray(box, dtype=float)).max() <= 360
    ):
        bounds: Bounds = tuple(float(v) for v in box)  # type: ignore[assignment]
    else:
        bounds = _bounds(_near_others(points))
    target = metric_crs(source, bounds)
    if box is not None:
        return grid_over(box_in_metres(box, target), spacing_m, target)
    west, south, east, north = transformed_bounds(bounds, source, target)
    # The corners go to whole multiples of the spacing, so that maps of one area made from different
    # recordings share their cells.
    west, south = (np.floor(v / spacing_m) * spacing_m for v in (west, south))
    east, north = (np.ceil(v / spacing_m) * spacing_m for v in (east, north))
    return grid_over(
        (west - spacing_m, south - spacing_m, east + spacing_m, north + spacing_m),
        spacing_m,
        target,
    )


def bounds_of_both(recording: Recording, grid: Grid) -> Bounds | None:
    """Bounds in metres of a map that holds a grid and a recording, where no reading lies on the
    grid and all lie within its longer side of it; ``None`` elsewhere.

    Raises:
        InputError: one of them has no place on Earth.
    """
    xy_m = _metres(recording, grid.crs)
    west, south, east, north = grid.bounds_m
    low, high = xy_m.min(axis=0), xy_m.max(axis=0)
    side, step = max(east - west, north - south), grid.spacing_m
    near = np.isfinite(xy_m).all() and (low >= (west - side, south - side)).all()
    if (
        not near
        or not (high <= (east + side, north + side)).all()
        or _cells_of(xy_m, grid)[1].any()
    ):
        return None
    over = np.ceil(np.maximum((west, south) - low, 0.0) / step) + 1.0
    beyond = np.ceil(np.maximum(high - (east, north), 0.0) / step) + 1.0
    return (
        float(west - over[0] * step),
        float(south - over[1] * step),
        float(east + beyond[0] * step),
        float(north + beyond[1] * step),
    )


def _raster(recording: Recording) -> Grid | None:
    """The grid whose cell centres are the readings' places, when they are those of a simulator's
    receiver grid: each cell at most once, most of the cells."""
    if recording.xy_m is None or len(recording) < _FEWEST_RASTER:
        return None
    xs, ys = (np.unique(np.round(axis, 3)) for axis in recording.xy_m.T)
    steps = np.concatenate([np.diff(xs), np.diff(ys)])
    if not len(steps) or min(len(xs), len(ys)) < 2 or len(xs) * len(ys) > MAX_CELLS:
        return None
    spacing = float(steps.min())
    even = np.abs(steps / spacing - np.rint(steps / spacing)).max() < 0.01
    if spacing <= 0 or not even or len(recording) < 0.3 * len(xs) * len(ys):
        return None
    shape = tuple(round(float(v[-1] - v[0]) / spacing) + 1 for v in (ys, xs))
    if shape[0] * shape[1] > MAX_CELLS:
        return None
    return Grid((shape[0], shape[1]), spacing, (float(xs[0]), float(ys[0])), recording.crs)


def _near_others(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points less a few strays: a receiver that loses its fix may report another country."""
    if len(points) < _FEW:
        return points
    low, high = np.percentile(points[:: max(1, len(points) // _SAMPLED)], (2, 98), axis=0)
    size = (high - low).max()
    near = ((points >= low - _FAR * size) & (points <= high + _FAR * size)).all(axis=1)
    return points[near] if size > 0 else points


def _bounds(points: NDArray[np.float64]) -> Bounds:
    west, south = points.min(axis=0)
    east, north = points.max(axis=0)
    return float(west), float(south), float(east), float(north)


def _metres(recording: Recording, crs: str | None) -> NDArray[np.float64]:
    """``[n, (x, y)]`` of the readings in the frame of a grid with ``crs``; not finite where the
    projection has no such place."""
    if recording.latlon is not None:
        if crs is None:
            raise InputError(
                f"{recording.source} has latitudes, but the map has no coordinate reference "
                "system; give the one the city is in (`crs`), or leave `city` out"
            )
        return Grid((1, 1), 1.0, crs=crs).xy_m_at_latlon(recording.latlon)
    assert recording.xy_m is not None
    if recording.crs == crs:
        return recording.xy_m
    if recording.crs is None or crs is None:
        with_crs, without = (
            ("the map", recording.source)
            if recording.crs is None
            else (recording.source, "the map")
        )
        raise InputError(
            f"{with_crs} has a coordinate reference system and {without} has none; give the one it "
            "is in (`crs` for the city, `recording_crs` for the recording)"
        )
    pyproj = require("pyproj", "geo")
    x, y = pyproj.Transformer.from_crs(
        parse_crs(recording.crs), parse_crs(crs), always_xy=True
    ).transform(*recording.xy_m.T)
    return np.column_stack([x, y])


def _cells_of(xy_m: NDArray[np.float64], grid: Grid) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Cells of the points and whether each is on the map; a point off the map gets cell (0, 0)."""
    west, south, east, north = grid.bounds_m
    with np.errstate(invalid="ignore"):
        near = (
            (xy_m[:, 0] >= west)
            & (xy_m[:, 0] <= east)
            & (xy_m[:, 1] >= south)
            & (xy_m[:, 1] <= north)
        )
    cells = grid.cells_at(np.where(near[:, None], xy_m, np.asarray(grid.origin_m)))
    on_map = near & grid.contains(cells)
    return np.where(on_map[:, None], cells, 0), on_map


def _sorted(keys: list[NDArray]) -> NDArray[np.int64]:
    """Order by the first key, then the second, and so on; most rows differ in the first two."""
    order = np.lexsort((keys[1], keys[0]))
    same = (keys[0][order][1:] == keys[0][order][:-1]) & (keys[1][order][1:] == keys[1][order][:-1])
    tied = np.r_[False, same] | np.r_[same, False]
    if tied.any():
        rows = order[tied]
        order[tied] = rows[np.lexsort([key[rows] for key in reversed(keys)])]
    return order


def _off_map(
    recording: Recording, grid: Grid, xy_m: NDArray[np.float64], on_map: NDArray[np.bool_]
) -> list[str]:
    """What to tell of readings off the map.

    Raises:
        InputError: most of them are so far from it that the recording is of another place.
    """
    off = int((~on_map).sum())
    if not off:
        return []
    west, south, east, north = grid.bounds_m
    reach = _FAR * max(east - west, north - south)
    with np.errstate(invalid="ignore"):
        away = np.maximum.reduce(
            [west - xy_m[:, 0], xy_m[:, 0] - east, south - xy_m[:, 1], xy_m[:, 1] - north]
        )
    far = ~(away <= reach)
    if far.mean() > 0.5:
        raise InputError(_all_outside(recording, grid, int(far.sum())))
    told = [f"{off} of {len(recording)} readings lie off the map"]
    if far.any():
        first = int(np.flatnonzero(far)[0])
        where = recording.latlon if recording.xy_m is None else recording.xy_m
        assert where is not None
        line = f"line {recording.line[first]}" if recording.line is not None else "one"
        told.append(
            f"{int(far.sum())} of these are more than {_FAR:g} times the map's size away, "
            f"{line} at {where[first][0]:.6g}, {where[first][1]:.6g}"
        )
    return told


def _all_outside(recording: Recording, grid: Grid, far: int | None = None) -> str:
    """Why no reading lies on the map, as far as can be told; or ``far`` of them nowhere near."""
    n = len(recording)
    message = (
        f"all {n} readings of {recording.source} lie outside the map"
        if far is None
        else f"{far} of {n} readings of {recording.source} lie far from the map"
    )
    if recording.latlon is None:
        assert recording.xy_m is not None
        lo, hi = recording.xy_m.min(axis=0), recording.xy_m.max(axis=0)
        return (
            f"{message}: they span x {lo[0]:.6g} to {hi[0]:.6g} and y {lo[1]:.6g} to {hi[1]:.6g} "
            "m, the map "
            f"{tuple(round(v, 1) for v in grid.bounds_m)}; check the coordinate reference system "
            "of the recording (`recording_crs`) and the `box`"
        )
    lo, hi = recording.latlon.min(axis=0), recording.latlon.max(axis=0)
    swapped = recording.latlon[:, ::-1]
    swapped = swapped[np.abs(swapped[:, 0]) <= 90]
    west, south, east, north = _map_in_degrees(grid)
    hint = (
        f"the map spans {south:.5f} to {north:.5f} and {west:.5f} to {east:.5f}: check the city "
        "(`city`) and the `box`, or leave them out"
        + (
            f"; a map of both has `box={min(west, lo[1]) - _MARGIN:.4f},"
            f"{min(south, lo[0]) - _MARGIN:.4f},{max(east, hi[1]) + _MARGIN:.4f},"
            f"{max(north, hi[0]) + _MARGIN:.4f}`"
            if far is None and max(hi - lo) + max(east - west, north - south) < 0.1
            else ""
        )
    )
    if len(swapped) and _cells_of(grid.xy_m_at_latlon(swapped), grid)[1].any():
        hint = (
            "swapped, they lie on it: exchange the latitude and longitude columns "
            "(`columns=latitude=NAME,longitude=NAME`)"
        )
    return (
        f"{message}: they span latitudes {lo[0]:.5f} to {hi[0]:.5f} and longitudes {lo[1]:.5f} to "
        f"{hi[1]:.5f}; {hint}"
    )


def _map_in_degrees(grid: Grid) -> Bounds:
    rows, cols = grid.shape
    corners = grid.latlon([(0, 0), (0, cols - 1), (rows - 1, 0), (rows - 1, cols - 1)])
    (south, west), (north, east) = corners.min(axis=0), corners.max(axis=0)
    return float(west), float(south), float(east), float(north)
