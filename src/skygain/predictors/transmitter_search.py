"""Where an unseen transmitter may stand: a quadtree of candidate positions on and around the map.

The area within `margin_m` of the map is cut into squares. A square is represented by one position at its middle (the nearest open cell
where that is built up) and weighs as much as the prior puts on its open ground. Squares that measurements favour are cut into four
until they are one cell small. The prior on each axis is the one that follows from a map cut at random out of a city that reaches up
to `margin_m` further: constant over the map, falling linearly to zero over the margin. Nothing is assumed about how
transmitters are placed in the city.
"""

from __future__ import annotations

__all__ = ["Square", "coarse_squares", "split_square"]

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skygain.scenario import Scenario


@dataclass(frozen=True)
class Square:
    """One candidate: cells [row, row + side) × [col, col + side), which may lie outside the map."""

    row: int
    """southernmost row"""
    col: int
    """westernmost column"""
    side: int
    """cells along the edge"""
    position: tuple[float, float]
    """(row, col) of the representative, possibly between cells"""
    prior: float
    """unnormalised prior probability"""


def coarse_squares(scenario: Scenario, margin_m: float, side_m: float, at_most: int) -> list[Square]:
    """Squares of about ``side_m`` (a power of two times the cell) over the map and its margin; larger if more than ``at_most``."""
    spacing = scenario.grid.spacing_m
    rows, cols = scenario.grid.shape
    margin = round(margin_m / spacing)
    level = max(0, round(np.log2(max(side_m / spacing, 1.0))))
    while True:
        side = 2**level
        pad = -(-margin // side) * side
        found = [
            square
            for row in range(-pad, rows + margin, side)
            for col in range(-pad, cols + margin, side)
            if (square := _square(scenario, margin, row, col, side)) is not None
        ]
        if len(found) <= at_most:
            return found
        level += 1


def split_square(scenario: Scenario, margin_m: float, square: Square) -> list[Square]:
    """The up to four quarters of ``square`` that have open ground; empty for a single cell."""
    if square.side == 1:
        return []
    margin, half = round(margin_m / scenario.grid.spacing_m), square.side // 2
    quarters = [_square(scenario, margin, square.row + r, square.col + c, half) for r in (0, half) for c in (0, half)]
    return [quarter for quarter in quarters if quarter is not None]


def _square(scenario: Scenario, margin: int, row: int, col: int, side: int) -> Square | None:
    shape = scenario.grid.shape
    r, c = np.arange(row, row + side), np.arange(col, col + side)
    weight = _axis_prior(r, shape[0], margin)[:, None] * _axis_prior(c, shape[1], margin)
    on_map = ((r >= 0) & (r < shape[0]))[:, None] & ((c >= 0) & (c < shape[1]))
    if on_map.any():
        height = scenario.city.height_m[np.clip(r, 0, shape[0] - 1)[:, None], np.clip(c, 0, shape[1] - 1)]
        weight = np.where(on_map & (height > 0), 0.0, weight)
    prior = float(weight.sum())
    if prior <= 0:
        return None
    middle = np.array([row, col]) + (side - 1) / 2
    nearest = np.floor(middle).astype(int) - (row, col)
    if weight[tuple(nearest)] <= 0 or (weight == 0).any():
        open_cells = np.argwhere(weight > 0) + np.array([row, col])
        middle = open_cells[np.argmin(((open_cells - middle) ** 2).sum(axis=1))].astype(float)
    return Square(row, col, side, (float(middle[0]), float(middle[1])), prior)


def _axis_prior(index: NDArray[np.int64], length: int, margin: int) -> NDArray[np.float64]:
    beyond = np.maximum(np.maximum(-index, index - (length - 1)), 0)
    return np.clip(1.0 - beyond / (margin + 1), 0.0, 1.0)
