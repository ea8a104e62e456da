"""Long straight legs through the free space: places with much room, and which of them see each
other."""

from __future__ import annotations

__all__ = ["Streets"]

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from skygain.flight.ways import steps_between
from skygain.missions.clearance import Airspace, straightened

Floats = NDArray[np.float64]

APART_M = 16.0
"""places keep at least this distance"""
SIGHT_M = 110.0
"""legs between two places are at most so long; longer ones pass places on their way"""
HOP_M = 1.0
"""a place on the way counts as so many metres, so that ways of few legs are preferred"""
SITE_CELLS = 3
"""readings along a leg stand for squares of so many cells"""
_NEAR_SITE = 2.2
_BEND_CELLS = 0.75


@dataclass(frozen=True, eq=False)
class Streets:
    """Places of a free space, the clear legs between them, and the shortest ways along those."""

    space: Airspace
    """where legs may lie"""
    places: NDArray[np.float64]
    """``[n, (row, col)]`` where they are, in cells; whole numbers but for places joined"""
    xy_m: NDArray[np.float64]
    """``[n, (x, y)]`` the same in metres"""
    seen: NDArray[np.bool_]
    """``[n, n]`` whether the leg between two places is clear and over flyable cells"""
    sites: NDArray[np.int64]
    """``[s, (row, col)]`` flyable cells that stand for what is read around them"""
    length_m: NDArray[np.float64]
    """``[n, n]`` length of the shortest way, `HOP_M` for each place on it"""
    before: NDArray[np.int32]
    """``[n, n]`` the last place before the second on the way from the first; negative for none"""
    _leg_sites: dict[tuple[int, int], NDArray[np.int64]] = field(default_factory=dict)
    _reads: dict[int, NDArray[np.bool_]] = field(default_factory=dict)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.sites)

    @classmethod
    def of(cls, space: Airspace) -> Streets:
        """The streets of a space, computed once."""
        return _streets(space)

    def joined(self, xy_m: NDArray[np.float64]) -> Streets:
        """The same with more places ``xy_m[k, (x, y)]``, after those that are there."""
        grid, n = self.space.grid, len(self.places)
        cells = (np.asarray(xy_m, dtype=float) - np.asarray(grid.origin_m)) / grid.spacing_m
        places = np.concatenate([self.places, cells[:, ::-1]])
        first, second = np.triu_indices(len(places), 1)
        new = second >= n
        seen = np.zeros((len(places), len(places)), dtype=bool)
        seen[:n, :n] = self.seen
        _look(self.space, places, first[new], second[new], seen)
        return _complete(self.space, places, seen, self.sites)

    def within(self, ends_m: Sequence[tuple[Floats, Floats]], reach_m: Sequence[float]) -> Streets:
        """What of the streets a way of at most ``reach_m[k]`` between the k-th two points
        ``ends_m[k]`` can come to, for any k."""
        xy, sites = self.xy_m, self.space.grid.xy_m(self.sites)
        near, told = np.zeros(len(xy), dtype=bool), np.zeros(len(sites), dtype=bool)
        for (one, other), reach in zip(ends_m, reach_m, strict=True):
            for found, points in ((near, xy), (told, sites)):
                way = np.hypot(*(points - one).T) + np.hypot(*(points - other).T)
                found |= way <= reach + 2 * SITE_CELLS * self.space.grid.spacing_m
        if near.all() or not near.any() or not told.any():
            return self
        seen = self.seen[np.ix_(near, near)]
        return _complete(self.space, self.places[near], seen, self.sites[told])

    def way(self, first: int, last: int) -> list[int]:
        """Places on the shortest way from one to another, both included."""
        found = [last]
        while found[-1] != first:
            found.append(int(self.before[first, found[-1]]))
        return found[::-1]

    def reads(self, first: int) -> NDArray[np.bool_]:
        """``[n, s]`` sites that the shortest ways from one place to all others read."""
        if first not in self._reads:
            found = np.zeros((len(self.places), len(self.sites)), dtype=bool)
            for place in np.argsort(self.length_m[first], kind="stable"):
                last = int(self.before[first, place])
                if last >= 0:
                    found[place] = found[last]
                    found[place, self._sites_of(last, int(place))] = True
            self._reads[first] = found
        return self._reads[first]

    def directions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``[n, n, (x, y)]`` unit vectors of the first and of the last leg of every way; zero from
        a place to itself."""
        n = len(self.places)
        step = self.xy_m[None] - self.xy_m[:, None]
        unit = step / np.maximum(np.hypot(*step.transpose(2, 0, 1)), 1e-9)[..., None]
        before = np.where(self.before >= 0, self.before, np.arange(n)[:, None])
        last = unit[before, np.arange(n)[None]]
        # the way back is the same way
        return -last.transpose(1, 0, 2), last

    def sites_at(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of the sites that stand for readings at ``cells[k, (row, col)]``."""
        if not len(cells):
            return np.empty(0, dtype=np.int64)
        gap, site = self._tree.query(cells)
        return np.unique(site[gap <= _NEAR_SITE])

    def _sites_of(self, one: int, other: int) -> NDArray[np.int64]:
        """Sites read on the leg between two places that see each other."""
        key = (min(one, other), max(one, other))
        if key not in self._leg_sites:
            a, b = self.places[key[0]], self.places[key[1]]
            n = max(2, int(np.hypot(*(b - a)) / SITE_CELLS * 2) + 1)
            points = a + np.linspace(0.0, 1.0, n)[:, None] * (b - a)
            self._leg_sites[key] = self.sites_at(points)
        return self._leg_sites[key]


@lru_cache(maxsize=4)
def _streets(space: Airspace) -> Streets:
    places = _places(space)
    seen = np.zeros((len(places), len(places)), dtype=bool)
    _look(space, places, *np.triu_indices(len(places), 1), seen)
    while (more := _between_parts(space, places, seen)) is not None:
        n, places = len(places), np.concatenate([places, more])
        seen = np.pad(seen, (0, len(more)))
        first, second = np.triu_indices(len(places), 1)
        _look(space, places, first[second >= n], second[second >= n], seen)
        ends = [np.flatnonzero((places[:n] == end).all(axis=1))[0] for end in more[[0, -1]]]
        chain = [ends[0], *range(n, len(places)), ends[1]]
        seen[chain[:-1], chain[1:]] = seen[chain[1:], chain[:-1]] = True
    return _complete(space, places, seen, _sites(space.flyable))


def _between_parts(
    space: Airspace, places: NDArray[np.float64], seen: NDArray[np.bool_]
) -> NDArray[np.float64] | None:
    """Places on a way from the smallest part of the streets to another; ``None`` if all are
    joined or cannot be."""
    n, part = connected_components(seen, directed=False)
    cells = places.astype(np.int64)
    for smallest in np.argsort(np.bincount(part, minlength=n), kind="stable")[: n - 1]:
        start = cells[part == smallest][0]
        steps = steps_between(space.flyable, start)
        away = steps[cells[:, 0], cells[:, 1]].astype(float)
        away[(part == smallest) | (away < 0)] = np.inf
        if not np.isfinite(away).any():
            continue
        at = cells[int(away.argmin())]
        way = [at]
        while steps[tuple(at)] > 0:
            near = at + np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])
            near = near[space.grid.contains(near)]
            at = near[steps[near[:, 0], near[:, 1]] == steps[tuple(at)] - 1][0]
            way.append(at)
        grid = space.grid
        line = straightened(space, grid.xy_m(np.array(way)), _BEND_CELLS * grid.spacing_m)
        return grid.cells_at(line).astype(float)
    return None


def _places(space: Airspace) -> NDArray[np.float64]:
    """Flyable cells `APART_M` from each other, those with the most room first."""
    flyable = space.flyable
    room = ndimage.distance_transform_edt(np.pad(flyable, 1))[1:-1, 1:-1]
    cells = np.argwhere(flyable)
    order = np.argsort(-room[cells[:, 0], cells[:, 1]], kind="stable")
    free = flyable.copy()
    reach = int(np.ceil(APART_M / space.grid.spacing_m))
    disk = np.hypot(*np.ogrid[-reach : reach + 1, -reach : reach + 1])
    disk = disk * space.grid.spacing_m < APART_M
    kept = []
    for row, col in cells[order]:
        if free[row, col]:
            kept.append((row, col))
            top, left = max(0, row - reach), max(0, col - reach)
            part = free[top : row + reach + 1, left : col + reach + 1]
            part &= ~disk[top - row + reach :, left - col + reach :][
                : part.shape[0], : part.shape[1]
            ]
    return np.array(kept, dtype=float).reshape(-1, 2)


def _look(
    space: Airspace,
    places: NDArray[np.float64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    seen: NDArray[np.bool_],
) -> None:
    """Enter in ``seen[n, n]`` which of the pairs see each other."""
    near = np.hypot(*(places[first] - places[second]).T) * space.grid.spacing_m <= SIGHT_M
    first, second = first[near], second[near]
    if not len(first):
        return
    # samples every half cell sort most pairs out before the exact test
    n = int(2 * SIGHT_M / space.grid.spacing_m) + 1
    share = np.linspace(0.0, 1.0, n)[None, :, None]
    points = places[first][:, None] * (1 - share) + places[second][:, None] * share
    cells = np.clip(np.rint(points).astype(np.int64), 0, np.array(space.flyable.shape) - 1)
    open_ = space.flyable[cells[..., 0], cells[..., 1]].all(axis=1)
    first, second = first[open_], second[open_]
    xy = space.grid.xy_m(places)
    clear = space.clear_each(xy[first], xy[second])
    for one, other in zip(first[clear], second[clear], strict=True):
        if space.cells_along(xy[[one, other]]) is not None:
            seen[one, other] = seen[other, one] = True


def _sites(flyable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """One flyable cell for each square of `SITE_CELLS`, the one nearest to its middle."""
    cells = np.argwhere(flyable)
    square = cells // SITE_CELLS
    off = np.abs(cells - square * SITE_CELLS - SITE_CELLS // 2).sum(axis=1)
    key = square[:, 0] * flyable.shape[1] + square[:, 1]
    order = np.lexsort((off, key))
    _, first = np.unique(key[order], return_index=True)
    return cells[order[first]]


def _complete(
    space: Airspace,
    places: NDArray[np.float64],
    seen: NDArray[np.bool_],
    sites: NDArray[np.int64],
) -> Streets:
    """Streets with their shortest ways."""
    xy = space.grid.xy_m(places)
    first, second = np.nonzero(seen)
    length = np.hypot(*(xy[first] - xy[second]).T) + HOP_M
    graph = csr_matrix((length, (first, second)), shape=seen.shape)
    distance, before = dijkstra(graph, directed=False, return_predecessors=True)
    return Streets(space, places, xy, seen, sites, distance, before)
