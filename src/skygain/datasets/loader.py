"""Batches of random crops for training, in plain NumPy.

A batch is a function of the seed and the step alone: a training run that stops and goes on later
sees the batches it would have seen, and every link is used once before any is used again.
"""

from __future__ import annotations

__all__ = ["CropBatch", "CropLoader"]

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skygain.datasets.store import ChannelDataset
from skygain.ground.errors import InputError

_ORDER, _CROP = range(2)
"""the random streams of the loader"""


@dataclass(frozen=True, eq=False)
class CropBatch:
    """Crops of several links, each in a frame whose (0, 0) is the centre of the crop's cell (0,
    0)."""

    height_m: NDArray[np.float32]
    """``[item, row, col]`` building heights"""
    gain_db: NDArray[np.float32]
    """``[item, row, col]`` channel gain, 0 inside buildings so that nothing can be learned there"""
    outdoor: NDArray[np.bool_]
    """``[item, row, col]`` cells unobstructed at the item's altitude, where the gain means
    something"""
    ray_traced: NDArray[np.bool_]
    """``[item, row, col]`` whether a ray reached the cell"""
    transmitter_m: NDArray[np.float32]
    """``[item, (x, y, z)]`` transmitters; many lie outside their crop"""
    altitude_m: NDArray[np.float32]
    """``[item]`` altitude of the receivers"""
    link: NDArray[np.int64]
    """``[item]`` position of the link in the data set"""


class CropLoader:
    """Endless batches of random crops of one split, turned and mirrored unless told otherwise.

    The maps of the split are held in memory as single-precision numbers: about 60 kB per link and
    altitude.
    """

    def __init__(
        self,
        dataset: ChannelDataset,
        split: str,
        *,
        altitudes_m: Sequence[float] = (10.0,),
        batch_size: int = 32,
        shape: tuple[int, int] = (96, 96),
        augment: bool = True,
        seed: int = 0,
    ) -> None:
        """Read the maps.

        Args:
            dataset: where the links are.
            split: ``"T1"`` to ``"T4"``.
            altitudes_m: a link counts once for each of these altitudes at which it was computed.
            batch_size: items per batch.
            shape: rows and columns of the crop.
            augment: turn by random quarters and mirror with probability 1/2.
            seed: another seed gives another order and other crops.

        Raises:
            InputError: unknown split or altitude, no such link, a crop larger than the map, or a
                batch of nothing.
        """
        rows, cols = dataset.grid.shape
        if not (
            min(shape) >= 1
            and shape[0] <= rows
            and shape[1] <= cols
            and max(shape) <= min(rows, cols)
        ):
            raise InputError(
                f"a crop of {shape} cells does not fit into the maps of {(rows, cols)} cells; "
                "choose a smaller crop"
            )
        if batch_size < 1:
            raise InputError(f"batch_size must be 1 or more, got {batch_size}")
        items = [
            (link, altitude) for altitude in altitudes_m for link in dataset.links(split, altitude)
        ]
        if not items:
            raise InputError(
                f"split {split} of {dataset.path} has no links at {altitudes_m} m; choose another "
                "split or altitude"
            )
        self.batch_size, self.shape, self.augment, self.seed = batch_size, shape, augment, seed
        self._grid = dataset.grid
        self._links = np.array([link for link, _ in items], dtype=np.int64)
        self._altitudes_m = np.array([altitude for _, altitude in items], dtype=np.float32)
        cities, self._city = np.unique(dataset.city_index[self._links], return_inverse=True)
        self._heights_m = np.stack([dataset.city(int(i)).height_m for i in cities])
        self._gain_db = np.empty((len(items), rows, cols), dtype=np.float32)
        self._traced = np.empty((len(items), rows, cols), dtype=bool)
        for k, (index, altitude) in enumerate(items):
            link = dataset.link(index, altitude)
            self._gain_db[k] = np.where(link.outdoor, link.truth_db, 0.0)
            self._traced[k] = link.ray_traced
        self._transmitters_m = dataset.transmitters_m[self._links]
        self._order = lru_cache(maxsize=2)(self._drawn_order)

    @property
    def n_items(self) -> int:
        """Number of maps: links times the altitudes at which each was computed."""
        return len(self._links)

    @property
    def steps_per_epoch(self) -> int:
        """Batches until every map has been used at least once."""
        return -(-self.n_items // self.batch_size)

    def __iter__(self) -> Iterator[CropBatch]:
        step = 0
        while True:
            yield self.batch(step)
            step += 1

    def batch(self, step: int) -> CropBatch:
        """The batch of training step ``step`` (0, 1, 2, …)."""
        epochs, places = np.divmod(
            np.arange(step * self.batch_size, (step + 1) * self.batch_size), self.n_items
        )
        items = np.array(
            [
                self._order(epoch)[place]
                for epoch, place in zip(epochs.tolist(), places.tolist(), strict=True)
            ]
        )
        rng = np.random.default_rng([self.seed, _CROP, step])
        quarters = rng.integers(4, size=len(items)) * self.augment
        mirror = rng.integers(2, size=len(items)) * self.augment == 1
        # a crop that is turned by an odd number of quarters is cut out lying down, so that it ends
        # up with the shape asked for
        size = np.where((quarters % 2 == 1)[:, None], self.shape[::-1], self.shape)
        corner = rng.integers(np.array(self._grid.shape) - size + 1)
        height, gain = (np.empty((len(items), *self.shape), dtype=np.float32) for _ in range(2))
        traced = np.empty((len(items), *self.shape), dtype=bool)
        for k, item in enumerate(items):
            (row, col), (rows, cols) = corner[k], size[k]
            for target, source in (
                (height, self._heights_m[self._city[item]]),
                (gain, self._gain_db[item]),
                (traced, self._traced[item]),
            ):
                image = np.rot90(source[row : row + rows, col : col + cols], -quarters[k])
                target[k] = image[:, ::-1] if mirror[k] else image
        return CropBatch(
            height_m=height,
            gain_db=gain,
            outdoor=height < self._altitudes_m[items, None, None],
            ray_traced=traced,
            transmitter_m=self._moved_transmitters(items, corner, size, quarters, mirror),
            altitude_m=self._altitudes_m[items],
            link=self._links[items],
        )

    def _moved_transmitters(
        self,
        items: NDArray[np.int64],
        corner: NDArray[np.int64],
        size: NDArray[np.int64],
        quarters: NDArray[np.int64],
        mirror: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        """``[item, (x, y, z)]`` transmitters in the frames of their crops."""
        xyz = self._transmitters_m[items].copy()
        xyz[:, :2] -= self._grid.xy_m(corner)
        span = self._grid.spacing_m * (size - 1)  # [item, rows/cols]
        for done in range(3):
            turned = quarters > done
            x, y = xyz[turned, 0].copy(), xyz[turned, 1].copy()
            xyz[turned, 0], xyz[turned, 1] = span[turned, done % 2] - y, x
        xyz[mirror, 0] = self._grid.spacing_m * (self.shape[1] - 1) - xyz[mirror, 0]
        return xyz.astype(np.float32)

    def _drawn_order(self, epoch: int) -> NDArray[np.int64]:
        return np.random.default_rng([self.seed, _ORDER, epoch]).permutation(self.n_items)
