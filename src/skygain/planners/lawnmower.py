"""Lawnmower and spiral: the sweeping rivals, coordinated between the UAVs and legal.

Sweeping ignores what was measured and is strong all the same: evenly spread tracks leave no cell
far from a measurement. The lane spacing is the closest that the steps left allow (see
`skygain.planners.search.sweep`), each lane is shifted to the freest row or column near it, and
buildings are flown round. The plan runs to the end of the survey.
"""

from __future__ import annotations

__all__ = ["LawnmowerPlanner", "SpiralPlanner"]

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skygain.flight.moves import Cells
from skygain.flight.swarm import Swarm
from skygain.planners.base import Plan, Planner
from skygain.planners.search.sweep import Pattern, Region, sweep
from skygain.predictors.base import Belief


def _line(row: int, col: int, row_to: int, col_to: int) -> Cells:
    """Cells of a straight line, both ends included."""
    n = max(abs(row_to - row), abs(col_to - col)) + 1
    return (
        np.stack([np.linspace(row, row_to, n), np.linspace(col, col_to, n)], axis=1)
        .round()
        .astype(np.int64)
    )


def _lane(free: NDArray[np.int64], centre: float, reach: float) -> int:
    """The line index within ``reach`` of ``centre`` with the most free cells, the nearest of
    equals."""
    low, high = (
        max(0, int(np.ceil(centre - reach))),
        min(len(free) - 1, int(np.floor(centre + reach))),
    )
    options = (
        np.arange(low, high + 1)
        if high >= low
        else np.array([int(np.clip(round(centre), 0, len(free) - 1))])
    )
    return int(options[np.lexsort((np.abs(options - centre), -free[options]))[0]])


def lanes(flyable: NDArray[np.bool_]) -> Pattern:
    """Boustrophedon: ``density`` lanes across the region. Variants: lane axis, first lane, first
    direction, trimmed ends."""

    def pattern(region: Region, density: int, variant: int) -> Cells | None:
        if variant >= 16:
            return None
        upright, last_first, backwards, trimmed = (bool(variant >> k & 1) for k in range(4))
        row, row_end, col, col_end = region
        window = flyable[row:row_end, col:col_end]
        if upright:
            window = window.T
        width, length = window.shape
        spacing = width / density
        trim = min(int(spacing / 2), (length - 1) // 2) if trimmed else 0
        free = window.sum(axis=1)
        order = range(density)[::-1] if last_first else range(density)
        parts = []
        for k, lane in enumerate(order):
            at = _lane(free, (lane + 0.5) * spacing - 0.5, spacing / 4)
            ends = (trim, length - 1 - trim)
            first, last = ends[::-1] if (k % 2 == 1) != backwards else ends
            parts.append(_line(at, first, at, last))
        cells = np.concatenate(parts)
        if upright:
            cells = cells[:, ::-1]
        return cells + np.array([row, col])

    return pattern


def rings(flyable: NDArray[np.bool_]) -> Pattern:
    """Inward rectangular spiral with ``density`` turns. Variants: starting corner and sense of
    rotation."""

    def pattern(region: Region, density: int, variant: int) -> Cells | None:
        if variant >= 8:
            return None
        row, row_end, col, col_end = region
        height, width = row_end - row, col_end - col
        step = min(height, width) / (2 * density)
        corners = []
        for turn in range(density):
            inset = int((turn + 0.5) * step)
            low, high, left, right = (
                row + inset,
                row_end - 1 - inset,
                col + inset,
                col_end - 1 - inset,
            )
            ring = [(low, left), (low, right), (high, right), (high, left)]
            ring = ring[variant % 4 :] + ring[: variant % 4]
            if variant >= 4:
                ring = ring[:1] + ring[:0:-1]
            corners += ring
        parts = [_line(*a, *b) for a, b in pairwise(corners)]
        cells = np.concatenate(parts)
        return np.clip(cells, (row, col), (row_end - 1, col_end - 1))

    return pattern


@dataclass(frozen=True)
class LawnmowerPlanner(Planner):
    """Coordinated boustrophedon over one area per UAV; plans once, to the end of the survey."""

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        return Plan(sweep(swarm, lanes(swarm.flyable), horizon), commit_steps=horizon)


@dataclass(frozen=True)
class SpiralPlanner(Planner):
    """Coordinated inward spirals over one area per UAV; plans once, to the end of the survey."""

    def plan(self, swarm: Swarm, belief: Belief, horizon: int, rng: np.random.Generator) -> Plan:
        return Plan(sweep(swarm, rings(swarm.flyable), horizon), commit_steps=horizon)
