"""Flying over a recording: the planner chooses where to go, and the instrument answers only where
somebody once measured.

A recording covers streets, not areas. A planner let loose on the whole map would be drawn to where
nothing was recorded, learn nothing there, and be drawn there still. `replay_scenario` therefore
keeps the UAVs near the recorded cells, and joins the parts of a recording that lie apart by the
shortest ways between them, so that every part can be reached.
"""

from __future__ import annotations

__all__ = ["ReplayInstrument", "replay_scenario", "replay_truth"]

from pathlib import PurePath

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.ground.errors import InputError
from skygain.instruments.asked import asked_cells, asked_uavs
from skygain.instruments.base import Instrument
from skygain.instruments.gridded import GriddedRecording
from skygain.measurements import Measurements
from skygain.scenario import Scenario


class ReplayInstrument(Instrument):
    """Answers with the recorded value of a cell, and not at all where there is none."""

    def __init__(self, gridded: GriddedRecording) -> None:
        self.gridded = gridded
        self._at = np.full(gridded.grid.shape, -1, dtype=np.int64)
        self._at[gridded.cell[:, 0], gridded.cell[:, 1]] = np.arange(len(gridded))

    def measure(
        self, cells: ArrayLike, *, uav: ArrayLike | None = None, time_s: float = 0.0
    ) -> Measurements:
        """The recorded values at those of ``cells[n, (row, col)]`` that have one, stamped with
        ``time_s``.

        Asked twice, it answers the same twice: a recording has one value per cell.

        Raises:
            InputError: a cell lies off the map.
        """
        asked = asked_cells(cells, self.gridded.grid.shape)
        which = asked_uavs(uav, len(asked))
        found = self._at[asked[:, 0], asked[:, 1]]
        has, found = found >= 0, found[found >= 0]
        g = self.gridded
        return Measurements.at(
            asked[has],
            g.level_db[found],
            noise_std_db=g.noise_std_db[found],
            time_s=time_s,
            uav=which[has],
            censored=g.censored[found],
        )

    def available(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """``[row, col]`` cells with a recorded value.

        Raises:
            InputError: ``shape`` is not that of the recording's map.
        """
        if tuple(shape) != self.gridded.grid.shape:
            raise InputError(
                f"the recording is on a map of {self.gridded.grid.shape} cells, asked about "
                f"{tuple(shape)}; they must agree"
            )
        return self.gridded.recorded


def replay_truth(gridded: GriddedRecording) -> NDArray[np.float64]:
    """``[row, col]`` recorded values, NaN where nothing was recorded: what an estimate is scored
    against.

    The scores of `skygain.evaluation.metrics.score` leave out NaN cells and visited cells, so that
    the headline error is the one on the recorded cells that the flight did not use.
    """
    truth = np.full(gridded.grid.shape, np.nan)
    truth[gridded.cell[:, 0], gridded.cell[:, 1]] = gridded.level_db
    return truth


def replay_scenario(
    gridded: GriddedRecording,
    city: City | None = None,
    *,
    uav_altitude_m: float = 10.0,
    prediction_altitude_m: float | None = None,
    reach_m: float | None = 20.0,
    transmitter_m: tuple[float, float, float] | None = None,
    frequency_hz: float = 5.0e9,
) -> Scenario:
    """The setting in which a recording is flown over again.

    Flyable are the unobstructed cells within ``reach_m`` of a recorded cell, and corridors three
    cells wide (so that UAVs can pass each other) along the shortest unobstructed ways that join the
    separate parts into one. Parts that buildings cut off altogether are left out of flight; they
    still count in the error.

    Args:
        gridded: the recording on its map.
        city: buildings on the same grid; open ground when left out, in which case altitudes have no
            effect.
        uav_altitude_m: altitude of flight; use the altitude of the recording, or buildings it
            passed under become obstacles.
        prediction_altitude_m: altitude of the map; that of flight when left out.
        reach_m: how far from a recorded cell UAVs may fly; ``None`` opens the whole map. The
            default had the smallest error on a campus (docs/instruments.md).
        transmitter_m: (x, y, z) if known.
        frequency_hz: carrier frequency.

    Raises:
        InputError: the city has another grid, or every recorded cell is inside a building.
    """
    grid = gridded.grid
    if city is None:
        city = City(
            grid, np.zeros(grid.shape, dtype=np.float32), name=PurePath(gridded.source).stem
        )
    elif city.grid != grid:
        raise InputError(
            "the recording was brought onto another grid than the city's; use "
            "on_grid(recording, city.grid)"
        )
    if reach_m is not None and not 0 <= reach_m < np.inf:
        raise InputError(
            f"reach_m must be 0 m or more, got {reach_m}; leave it out for 20 m, or give None for "
            "the whole map"
        )
    free = ~city.obstructed(uav_altitude_m)
    if not (free & gridded.recorded).any():
        raise InputError(
            f"every recorded cell of {gridded.source} is inside a building at {uav_altitude_m:g} "
            "m; "
            "fly higher (`altitude_m`), or check the position of the `city`"
        )
    return Scenario(
        city,
        uav_altitude_m=uav_altitude_m,
        prediction_altitude_m=uav_altitude_m
        if prediction_altitude_m is None
        else prediction_altitude_m,
        no_fly=None
        if reach_m is None
        else ~_reachable(gridded.recorded & free, free, reach_m / grid.spacing_m),
        transmitter_m=transmitter_m,
        frequency_hz=frequency_hz,
    )


def _reachable(
    recorded: NDArray[np.bool_], free: NDArray[np.bool_], reach: float
) -> NDArray[np.bool_]:
    """Free cells within ``reach`` cells of a recorded one, joined into one 4-connected part with as
    many of them as can be."""
    from scipy.ndimage import binary_dilation, distance_transform_edt, label

    near = free & (distance_transform_edt(~recorded) <= reach + 1e-9)
    corridors = binary_dilation(_links(near, free), np.ones((3, 3), dtype=bool)) & free
    parts, _ = label(near | corridors)
    return parts == np.bincount(parts[recorded]).argmax()


def _links(near: NDArray[np.bool_], free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells of the shortest 4-connected ways through ``free`` that join the parts of ``near``:
    their minimum spanning tree.

    Every free cell is given to its nearest part; two parts are as far apart as the shortest way
    across a border between their cells, and these distances have the same spanning tree as the full
    ones (Mehlhorn 1988).
    """
    from scipy.ndimage import label
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

    parts, n_parts = label(near)
    ways = np.zeros(near.shape, dtype=bool)
    if n_parts < 2:
        return ways
    index = np.arange(near.size).reshape(near.shape)
    pairs = [
        (index[:-1], index[1:], free[:-1] & free[1:]),
        (index[:, :-1], index[:, 1:], free[:, :-1] & free[:, 1:]),
    ]
    a, b = (np.concatenate([pair[side][pair[2]] for pair in pairs]) for side in (0, 1))
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(near.size, near.size)).tocsr()
    steps, previous, nearest = dijkstra(
        graph,
        directed=False,
        indices=np.flatnonzero(near),
        unweighted=True,
        return_predecessors=True,
        min_only=True,
    )
    owner = np.where(nearest >= 0, parts.ravel()[np.maximum(nearest, 0)], 0)
    border = (owner[a] != owner[b]) & (owner[a] > 0) & (owner[b] > 0)
    a, b = a[border], b[border]
    length = steps[a] + steps[b] + 1
    order = np.argsort(length, kind="stable")
    low, high = np.minimum(owner[a], owner[b])[order], np.maximum(owner[a], owner[b])[order]
    key, first = np.unique(
        low * (n_parts + 1) + high, return_index=True
    )  # the shortest border of each pair of parts
    between = coo_array(
        (length[order][first], (low[first], high[first])), shape=(n_parts + 1, n_parts + 1)
    )
    crossing = dict(zip(key.tolist(), order[first].tolist(), strict=True))
    tree = minimum_spanning_tree(between.tocsr()).tocoo()
    flat = ways.ravel()
    for i, j in zip(tree.row.tolist(), tree.col.tolist(), strict=True):
        edge = crossing[min(i, j) * (n_parts + 1) + max(i, j)]
        for cell in (int(a[edge]), int(b[edge])):
            while cell >= 0:
                flat[cell] = True
                cell = int(previous[cell])
    return ways
