"""Receivers in a simulated world: they look the truth up, and spoil it the way real receivers do.

The order in which `NoisyInstrument` spoils a reading is that of a receiver's chain: the gain at the
UAV's true cell, Gaussian noise, the floor below which nothing is detected, the steps of the
reported scale; then the navigation error, which decides the cell the reading is filed under, and
the radio link to the base, which may lose it. See docs/instruments.md.
"""

from __future__ import annotations

__all__ = ["NoiseConfig", "NoisyInstrument", "PerfectInstrument"]

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError
from skygain.instruments.asked import asked_cells, asked_uavs
from skygain.instruments.base import Instrument
from skygain.measurements import Measurements


class _TruthInstrument(Instrument):
    """An instrument that looks a truth up."""

    def __init__(self, truth_db: ArrayLike) -> None:
        truth = np.array(truth_db, dtype=float)
        if truth.ndim != 2:
            raise InputError(
                f"a truth is one map, [row, col], got shape {truth.shape}; pass one transmitter "
                "and one altitude"
            )
        truth.flags.writeable = False
        self.truth_db: NDArray[np.float64] = truth

    def available(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """``[row, col]`` cells where the truth is known.

        Raises:
            InputError: ``shape`` is not that of the truth.
        """
        if tuple(shape) != self.truth_db.shape:
            raise InputError(
                f"the instrument knows a map of {self.truth_db.shape} cells, asked about "
                f"{tuple(shape)}; they must agree"
            )
        return np.isfinite(self.truth_db)

    def _gain_db(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        gain = self.truth_db[cells[:, 0], cells[:, 1]]
        unknown = ~np.isfinite(gain)
        if unknown.any():
            cell, value = tuple(cells[unknown][0].tolist()), gain[unknown][0]
            raise InputError(
                f"the truth at cell {cell} is {value}, so nothing can be measured there; keep UAVs "
                "off it (no-fly) or fill it"
            )
        return gain


class PerfectInstrument(_TruthInstrument):
    """Reads the truth exactly.

    >>> PerfectInstrument([[-80.0, -90.0]]).measure([[0, 1]]).gain_db
    array([-90.])
    """

    def measure(
        self, cells: ArrayLike, *, uav: ArrayLike | None = None, time_s: float = 0.0
    ) -> Measurements:
        """Exact readings at ``cells[n, (row, col)]``, one for each.

        Raises:
            InputError: a cell lies off the map, or its truth is not finite.
        """
        asked = asked_cells(cells, self.truth_db.shape)  # type: ignore[arg-type]
        return Measurements.at(
            asked, self._gain_db(asked), time_s=time_s, uav=asked_uavs(uav, len(asked))
        )


@dataclass(frozen=True)
class NoiseConfig:
    """How a receiver spoils the truth. The defaults spoil nothing.

    Raises:
        InputError: a value is out of its range.
    """

    std_db: float | tuple[float, float] = 0.0
    """standard deviation of the Gaussian noise: a constant, or (low, high) to draw each reading's
    own from uniformly"""
    quantisation_db: float = 0.0
    """step of the reported scale, whose marks are its multiples; 0 for a continuous one"""
    floor_db: float = -math.inf
    """weakest gain the receiver can tell; whatever it hears below is reported as this and marked
    censored"""
    gps_std_m: float = 0.0
    """standard deviation of the position error along x and along y; moves the cell the reading is
    filed under"""
    loss_probability: float = 0.0
    """chance that a reading never arrives"""

    def __post_init__(self) -> None:
        low, high = self.std_range_db
        if not (0 <= low <= high < math.inf):
            raise InputError(
                "std_db must be 0 or more, or a range (low, high) with low <= high, got "
                f"{self.std_db}; give e.g. 2.0"
            )
        for name in ("quantisation_db", "gps_std_m"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(
                    f"{name} must be a finite number from 0, got {getattr(self, name)}; 0 switches "
                    "it off"
                )
        if not self.floor_db < math.inf:
            raise InputError(
                f"floor_db must be a gain in dB, got {self.floor_db}; leave it out for a receiver "
                "without a floor"
            )
        if not 0 <= self.loss_probability <= 1:
            raise InputError(
                f"loss_probability must lie between 0 and 1, got {self.loss_probability}; 0.1 "
                "loses a tenth"
            )

    @property
    def std_range_db(self) -> tuple[float, float]:
        """(low, high) of the standard deviation; equal when it is constant."""
        if isinstance(self.std_db, tuple):
            low, high = self.std_db
            return float(low), float(high)
        return float(self.std_db), float(self.std_db)


class NoisyInstrument(_TruthInstrument):
    """Reads the truth with noise, a floor, a coarse scale, an uncertain position and a lossy link.

    The ``noise_std_db`` it reports is the truth about its own noise: √(σ² + q²/12), the Gaussian
    part and the variance of rounding to a scale of step q, which is exact when σ is not small
    against q. It does not include what the position error adds, which depends on the map and which
    a receiver cannot know, nor does it hold for censored readings, where the floor alone is known.

    A position error is drawn in metres and rounded to cells. A reading whose erroneous cell lies
    off the map or is not flyable keeps its true cell, as a position filter that knows the map would
    put it back. Every reading draws the same number of random values whatever the configuration, so
    that two configurations with one seed share their noise, their errors and their losses.
    """

    def __init__(
        self,
        truth_db: ArrayLike,
        config: NoiseConfig,
        rng: np.random.Generator,
        *,
        spacing_m: float = 4.0,
        flyable: NDArray[np.bool_] | None = None,
    ) -> None:
        """Args:
        truth_db: ``[row, col]`` gain; NaN where it is not known.
        config: what is spoiled and how much.
        rng: draws everything random, and is used up reading by reading.
        spacing_m: side of a cell, which turns position errors into cells.
        flyable: ``[row, col]`` cells a reading may be filed under; every cell with a finite truth
        when left out.

        Raises:
            InputError: the truth is no map, or ``flyable`` has another shape.
        """
        super().__init__(truth_db)
        if flyable is not None and np.shape(flyable) != self.truth_db.shape:
            raise InputError(
                f"flyable has shape {np.shape(flyable)}, but the truth has {self.truth_db.shape}; "
                "they must agree"
            )
        if not 0 < spacing_m < math.inf:
            raise InputError(
                f"spacing_m must be a positive number of metres, got {spacing_m}; 4 is usual"
            )
        self.config = config
        self.rng = rng
        self.spacing_m = spacing_m
        self.flyable = (
            np.isfinite(self.truth_db) if flyable is None else np.array(flyable, dtype=bool)
        )

    def measure(
        self, cells: ArrayLike, *, uav: ArrayLike | None = None, time_s: float = 0.0
    ) -> Measurements:
        """Readings at ``cells[n, (row, col)]``, less those lost.

        Raises:
            InputError: a cell lies off the map, or its truth is not finite.
        """
        asked = asked_cells(cells, self.truth_db.shape)  # type: ignore[arg-type]
        n, c = len(asked), self.config
        truth, which = self._gain_db(asked), asked_uavs(uav, n)
        low, high = c.std_range_db
        std = low + (high - low) * self.rng.random(n)
        heard = truth + std * self.rng.standard_normal(n)
        filed = self._filed(asked, c.gps_std_m * self.rng.standard_normal((n, 2)))
        arrived = self.rng.random(n) >= c.loss_probability
        censored = heard < c.floor_db
        reported = (
            np.round(heard / c.quantisation_db) * c.quantisation_db
            if c.quantisation_db > 0
            else heard
        )
        gain = np.where(censored, c.floor_db, np.maximum(reported, c.floor_db))
        noise = np.sqrt(std**2 + c.quantisation_db**2 / 12)
        return Measurements.at(
            filed, gain, noise_std_db=noise, time_s=time_s, uav=which, censored=censored
        ).taken(arrived)

    def _filed(self, cells: NDArray[np.int64], error_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """The cells that readings at ``cells`` are filed under."""
        rows, cols = self.truth_db.shape
        # An error beyond the map says no more than one that leaves it; clipping keeps the
        # conversion to integers defined.
        steps = np.clip(
            np.rint(error_m[:, ::-1] / self.spacing_m), -max(rows, cols), max(rows, cols)
        ).astype(np.int64)
        moved = cells + steps
        on_map = np.all((moved >= 0) & (moved < (rows, cols)), axis=1)
        moved = np.where(on_map[:, None], moved, cells)
        return np.where(self.flyable[moved[:, 0], moved[:, 1]][:, None], moved, cells)
