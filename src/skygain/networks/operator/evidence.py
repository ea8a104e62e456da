"""What readings say about every position where the transmitter may stand, as maps a network can
read.

The positions are the squares of a regular grid over the map and a margin around it. For each of
them the path model predicts every reading; sums of the standardised error (plain, softened, over
paths in line of sight, and once more with crowded readings counted less) are kept per position and
grow with each reading. `channels` turns them into the input maps of the locator network, which
learned how far such sums can be trusted.
"""

from __future__ import annotations

__all__ = [
    "EVIDENCE_CHANNELS",
    "EvidenceSums",
    "PathPredictions",
    "PositionGrid",
    "evidence_channels",
]

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skygain.networks.operator.features import CHANNELS, fill_cells
from skygain.networks.operator.path_model import PathModel

Array = NDArray[np.float32]

SOFTEN = 3.0
"""standardised errors beyond this count with their logarithm only"""
CROWD_M = 12.0
"""earlier readings within this distance make a reading count less"""
LINE_OF_SIGHT = CHANNELS.index("line_of_sight")
SUMS = ("weight", "z", "soft", "log_std", "error", "square", "los_weight", "los_z", "los_soft")
PER_SET = (
    "z",
    "soft",
    "log_std",
    "spread",
    "los_share",
    "los_z",
    "los_soft",
    "log_likelihood",
    "tempered",
)
EVIDENCE_CHANNELS = (
    *(f"{name}/{kind}" for kind in ("all", "thinned") for name in PER_SET),
    "open",
    "on_map",
    "height",
    "count",
    "altitude",
    "measured",
    "gain_here",
    "mean_gain",
    "distance",
)
"""names of the channels, in order"""
TEMPERED = EVIDENCE_CHANNELS.index("tempered/thinned")


@dataclass(frozen=True, eq=False)
class PositionGrid:
    """Squares of ``side`` cells over the map and its margin, each with one position that stands for
    it."""

    start: int
    """first row and column of the first square (negative: in the margin)"""
    side: int
    """cells along the edge of a square"""
    shape: tuple[int, int]
    """squares in rows and columns"""
    index: NDArray[np.int64]
    """``[k]`` raveled squares with open ground"""
    position: NDArray[np.float64]
    """``[k, (row, col, z)]`` of each: the middle, or an open cell where the square is partly built
    up"""
    prior: NDArray[np.float64]
    """``[k]`` unnormalised: open ground, less and less of it towards the end of the margin"""

    @classmethod
    def over(
        cls,
        height_m: NDArray[np.floating],
        spacing_m: float,
        margin_m: float = 102.0,
        side: int = 2,
        z_m: float = 1.5,
    ) -> PositionGrid:
        """The grid for a map of building heights ``height_m[row, col]``."""
        margin = -(-round(margin_m / spacing_m) // side) * side
        rows, cols = (-(-(n + 2 * margin) // side) * side for n in height_m.shape)
        open_ = np.ones((rows, cols), dtype=bool)
        inside = (
            slice(margin, margin + height_m.shape[0]),
            slice(margin, margin + height_m.shape[1]),
        )
        open_[inside] = height_m <= 0
        by_row, by_col = (
            _axis_prior(np.arange(n) - margin, m, margin)
            for n, m in zip(open_.shape, height_m.shape, strict=True)
        )
        weight = open_ * np.outer(by_row, by_col)
        blocks = (
            weight.reshape(rows // side, side, cols // side, side)
            .transpose(0, 2, 1, 3)
            .reshape(-1, side * side)
        )
        prior = blocks.sum(axis=1)
        index = np.flatnonzero(prior > 0)
        row, col = np.divmod(index, cols // side)
        corner = np.stack([row, col], axis=-1) * side - margin
        position = corner + (side - 1) / 2.0
        partly = (blocks[index] <= 0).any(axis=1)
        first = np.argmax(blocks[index[partly]] > 0, axis=1)
        position[partly] = corner[partly] + np.stack(np.divmod(first, side), axis=-1)
        full = np.concatenate([position, np.full((len(index), 1), z_m)], axis=1)
        return cls(-margin, side, (rows // side, cols // side), index, full, prior[index])

    def dense(self, values: NDArray, fill: float = 0.0) -> Array:
        """``values[..., k]`` as maps ``[..., row, col]``."""
        out = np.full((*values.shape[:-1], self.shape[0] * self.shape[1]), fill, dtype=np.float32)
        out[..., self.index] = values
        return out.reshape(*values.shape[:-1], *self.shape)

    def square_of(self, cell: NDArray[np.integer]) -> NDArray[np.int64]:
        """``[n, 2]`` row and column of the square that holds each ``cell[n, (row, col)]``."""
        return (np.asarray(cell, dtype=np.int64) - self.start) // self.side


def _axis_prior(index: NDArray[np.int64], length: int, margin: int) -> NDArray[np.float64]:
    beyond = np.maximum(np.maximum(-index, index - (length - 1)), 0)
    return np.clip(1.0 - beyond / (margin + 1), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class PathPredictions:
    """What the path model expects at some cells from every position."""

    cells: NDArray[np.int64]
    """``[m, (row, col)]``"""
    mean_db: Array
    """``[m, k]``"""
    std_db: Array
    """``[m, k]``"""
    line_of_sight: Array
    """``[m, k]`` 1 or 0"""
    spacing_m: float
    """side of a cell"""

    @classmethod
    def made(
        cls,
        model: PathModel,
        grid: PositionGrid,
        height_m: Array,
        spacing_m: float,
        altitude_m: float,
        cells: NDArray[np.int64],
    ) -> PathPredictions:
        """For ``cells`` at ``altitude_m`` in a city of ``height_m``."""
        features = path_features(height_m, spacing_m, grid.position, cells, altitude_m)
        mean, std = model.of_features(features)
        return cls(cells, mean, std, np.ascontiguousarray(features[..., LINE_OF_SIGHT]), spacing_m)


@dataclass(frozen=True, eq=False)
class EvidenceSums:
    """Sums over the readings so far, for every position. Growing them leaves older ones valid."""

    grid: PositionGrid
    """the positions"""
    sums: Array
    """``[set, sum, k]``; the sets count all readings alike and crowded ones less, the sums are
    `SUMS`"""
    cells: NDArray[np.int64]
    """``[n, (row, col)]`` of the readings"""
    gain_db: NDArray[np.float64]
    """``[n]``"""

    @classmethod
    def none(cls, grid: PositionGrid) -> EvidenceSums:
        """Before the first reading."""
        nothing = np.zeros((2, len(SUMS), len(grid.index)), dtype=np.float32)
        return cls(grid, nothing, np.empty((0, 2), dtype=np.int64), np.empty(0))

    def grown(
        self,
        model: PathModel,
        height_m: Array,
        spacing_m: float,
        altitude_m: float,
        cells: NDArray[np.int64],
        gain_db: NDArray,
    ) -> EvidenceSums:
        """After readings ``gain_db[m]`` (as at the model's carrier) at ``cells[m, (row, col)]``."""
        return self.taken(
            PathPredictions.made(model, self.grid, height_m, spacing_m, altitude_m, cells), gain_db
        )

    def taken(self, predicted: PathPredictions, gain_db: NDArray) -> EvidenceSums:
        """The same with the predictions at those cells given; they serve every transmitter of the
        city."""
        mean, std, cells = predicted.mean_db, predicted.std_db, predicted.cells
        error = gain_db.astype(np.float32)[:, None] - mean
        z = error / std
        soft = (SOFTEN * np.arcsinh(z / SOFTEN)) ** 2
        log_std = np.log(std) + 0.5 * np.log1p((z / SOFTEN) ** 2)
        los = predicted.line_of_sight
        terms = (np.ones_like(z), z, soft, log_std, error, error**2, los, los * z, los * soft)
        weight = np.stack(
            [np.ones(len(cells), np.float32), self._thinning(cells, predicted.spacing_m)]
        )
        new = np.stack([weight @ term for term in terms], axis=1)
        return replace(
            self,
            sums=self.sums + new,
            cells=np.concatenate([self.cells, cells]),
            gain_db=np.append(self.gain_db, gain_db),
        )

    def _thinning(self, cells: NDArray[np.int64], spacing_m: float) -> Array:
        everything = np.concatenate([self.cells, cells])
        old = len(self.cells)
        near = ((cells[:, None] - everything[None]) ** 2).sum(axis=-1) * spacing_m**2 <= CROWD_M**2
        near &= np.arange(len(everything))[None] < (old + np.arange(len(cells)))[:, None]
        return (1.0 / (1.0 + near.sum(axis=1))).astype(np.float32)


def path_features(
    height_m: Array,
    spacing_m: float,
    position: NDArray[np.float64],
    cells: NDArray[np.int64],
    altitude_m: float,
) -> Array:
    """``[cell, position, channel]`` of `path_features.fill_cells`."""
    out = np.empty((len(cells), len(position), len(CHANNELS)), dtype=np.float32)
    height = np.ascontiguousarray(height_m, dtype=np.float32)
    fill_cells(
        height,
        float(spacing_m),
        position,
        np.ascontiguousarray(cells, dtype=np.int64),
        float(altitude_m),
        out,
    )
    return out


def evidence_channels(
    sums: EvidenceSums, height_m: Array, spacing_m: float, altitude_m: float
) -> Array:
    """``[channel, row, col]`` maps over the grid's squares, all of order one; see
    `EVIDENCE_CHANNELS`."""
    grid, n = sums.grid, len(sums.cells)
    out = []
    for part in sums.sums:
        weight, z, soft, log_std, error, square, los, los_z, los_soft = part
        total = np.maximum(weight, 1e-6)
        log_likelihood = -0.5 * soft - log_std
        log_likelihood = log_likelihood - log_likelihood.max()
        spread = np.sqrt(np.maximum(square / total - (error / total) ** 2, 0.0))
        out += [
            np.clip(z / total, -4, 4) / 2,
            np.clip(soft / total, 0, 12) / 3,
            log_std / total - 2.3,
            spread / 10,
            los / total,
            np.clip(los_z / (los + 0.3), -4, 4) / 2,
            np.clip(los_soft / (los + 0.3), 0, 12) / 3,
            np.maximum(log_likelihood, -60) / 20,
            np.maximum(log_likelihood / np.sqrt(total), -15) / 5,
        ]
    dense = grid.dense(np.stack(out))
    rows, cols = grid.shape
    open_ = grid.dense(np.ones(len(grid.index)))
    on_map, height = np.zeros((2, rows * grid.side, cols * grid.side), dtype=np.float32)
    inside = (
        slice(-grid.start, -grid.start + height_m.shape[0]),
        slice(-grid.start, -grid.start + height_m.shape[1]),
    )
    on_map[inside], height[inside] = 1.0, height_m / 20.0
    measured, gain = np.zeros((2, rows, cols), dtype=np.float32)
    mean = sums.gain_db.mean() if n else -110.0
    distance = np.full((rows, cols), 1.0, dtype=np.float32)
    if n:
        at = tuple(grid.square_of(sums.cells).T)
        np.add.at(measured, at, 1.0)
        np.add.at(gain, at, (sums.gain_db - mean) / 20.0)
        from scipy.ndimage import distance_transform_edt

        distance = (distance_transform_edt(measured == 0) * grid.side * spacing_m / 100.0).astype(
            np.float32
        )
    count = np.maximum(measured, 1.0)
    flat = [
        open_,
        _blocks(on_map, grid.side),
        _blocks(height, grid.side),
        np.full((rows, cols), np.log1p(n) / 5.0),
        np.full((rows, cols), altitude_m / 20.0 - 1.0),
        np.minimum(measured, 4.0) / 2.0,
        gain / count,
        np.full((rows, cols), (mean + 110.0) / 20.0),
        distance,
    ]
    return np.concatenate([dense, np.stack(flat)]).astype(np.float32)


def _blocks(map_: Array, side: int) -> Array:
    rows, cols = map_.shape
    return map_.reshape(rows // side, side, cols // side, side).mean(axis=(1, 3))
