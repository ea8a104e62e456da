"""What a predictor believes about the gain at every cell.

Inference returns an object: a mean and a variance per cell, with samples, intervals and entropy
derived from them. A posterior that knows how cells vary together is a `JointPosterior` and also
answers `covariance`; planners that need it ask for that type.

Planning asks a belief for three things, the first that it has: a stationary prior
(`HasStationaryPrior`, a method of the belief), a joint posterior (`JointPosterior`), or just the
variances. `skygain.fields.planning` makes one field of whatever it gets.
"""

from __future__ import annotations

__all__ = ["GaussianProcessPosterior", "HasStationaryPrior", "JointPosterior", "Posterior"]

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from skygain.ground.shown import Shown

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Shown):
    """Independent normal beliefs, one per cell.

    >>> belief = Posterior(np.zeros((1, 2)), np.array([[4.0, 0.0]]))
    >>> low, high = belief.interval(0.9)
    >>> np.round(high, 2)
    array([[3.29, 0.  ]])
    """

    mean_db: Array
    """``[row, col]`` expected gain"""
    variance_db2: Array
    """``[row, col]`` variance of the gain, never negative"""

    def __post_init__(self) -> None:
        mean, variance = (
            np.asarray(self.mean_db, dtype=float),
            np.asarray(self.variance_db2, dtype=float),
        )
        if mean.shape != variance.shape:
            raise ValueError(
                f"mean_db has shape {mean.shape}, variance_db2 has {variance.shape}; they must "
                "agree"
            )
        for name, value in (("mean_db", mean), ("variance_db2", variance)):
            view = value.view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    def __repr__(self) -> str:
        rows, cols = self.mean_db.shape
        return (
            f"{type(self).__name__} of {rows} × {cols} cells: mean {self.mean_db.min():.1f} to "
            f"{self.mean_db.max():.1f} dB, standard deviation {self.std_db.mean():.1f} dB on "
            "average"
        )

    def to_xarray(self) -> xr.Dataset:
        """``mean_db`` and ``std_db`` over (row, col)."""
        import xarray as xr

        maps = {"mean_db": (self.mean_db, "mean"), "std_db": (self.std_db, "standard deviation")}
        return xr.Dataset(
            {
                name: (("row", "col"), values, {"units": "dB", "long_name": text})
                for name, (values, text) in maps.items()
            },
            coords={"row": np.arange(len(self.mean_db)), "col": np.arange(self.mean_db.shape[1])},
        )

    @property
    def std_db(self) -> Array:
        """``[row, col]`` standard deviation."""
        return np.sqrt(self.variance_db2)

    def expected_rmse_db(self, where: NDArray[np.bool_]) -> float:
        """Root mean square of the standard deviation over the cells ``where[row, col]``: what the
        root mean squared error there is, if the belief is right about itself."""
        return float(np.sqrt(self.variance_db2[where].mean()))

    def interval(self, level: float = 0.9) -> tuple[Array, Array]:
        """Central credible interval: (low, high), each ``[row, col]``, that holds the gain with
        probability ``level``."""
        if not 0 < level < 1:
            raise ValueError(
                f"level must lie between 0 and 1, got {level}; give 0.9 for a 90 % interval"
            )
        half = ndtri(0.5 + level / 2) * self.std_db
        return self.mean_db - half, self.mean_db + half

    def sample(self, rng: np.random.Generator, n: int = 1) -> Array:
        """``[n, row, col]`` draws of the whole map."""
        return self.mean_db + self.std_db * rng.standard_normal((n, *self.mean_db.shape))

    def entropy(self, cells: ArrayLike) -> float:
        """Differential entropy in nats of the gains at ``cells[n, (row, col)]``: Σ ½ log(2πe σ²);
        −inf if one is known exactly."""
        cells = np.asarray(cells, dtype=np.int64)
        with np.errstate(divide="ignore"):
            return float(
                0.5
                * np.sum(np.log(2 * np.pi * math.e * self.variance_db2[cells[:, 0], cells[:, 1]]))
            )


@runtime_checkable
class HasStationaryPrior(Protocol):
    """A belief that began with the same covariance function everywhere, as Kriging does.

    A planner then conditions that function on the readings near each UAV by itself: what a path
    would teach depends on where was measured, not on what.
    """

    def prior_covariance_db2(self, distance_m: ArrayLike) -> Array:
        """Prior covariance in dB² of the gains at two cells ``distance_m`` apart, in the shape of
        ``distance_m``."""


class JointPosterior(Posterior):
    """A posterior that also knows how the gains at different cells vary together."""

    @abstractmethod
    def covariance(self, cells: ArrayLike, others: ArrayLike | None = None) -> Array:
        """``[n, m]`` covariance in dB² of the gains at ``cells[n, (row, col)]`` and ``others[m,
        (row, col)]`` (default ``cells``)."""

    def entropy(self, cells: ArrayLike) -> float:
        """Joint differential entropy in nats of the gains at distinct ``cells``: ½ log det(2πe Σ);
        −inf if Σ is singular."""
        sign, log_det = np.linalg.slogdet(2 * np.pi * math.e * self.covariance(cells))
        return float(0.5 * log_det) if sign > 0 else -np.inf


@dataclass(frozen=True, eq=False, repr=False)
class GaussianProcessPosterior(JointPosterior):
    """A Gaussian-process posterior: joint, with exact samples of the whole map."""

    covariance_of: Callable[[NDArray[np.int64], NDArray[np.int64]], Array] = field(repr=False)
    """``(cells[n, 2], others[m, 2]) -> [n, m]`` posterior covariance in dB²"""

    def covariance(self, cells: ArrayLike, others: ArrayLike | None = None) -> Array:
        cells = np.asarray(cells, dtype=np.int64)
        return self.covariance_of(
            cells, cells if others is None else np.asarray(others, dtype=np.int64)
        )

    def sample_at(self, cells: ArrayLike, rng: np.random.Generator, n: int = 1) -> Array:
        """``[n, k]`` joint draws of the gains at ``cells[k, (row, col)]``."""
        cells = np.asarray(cells, dtype=np.int64)
        values, vectors = np.linalg.eigh(self.covariance(cells))
        root = vectors * np.sqrt(np.clip(values, 0, None))
        return (
            self.mean_db[cells[:, 0], cells[:, 1]] + rng.standard_normal((n, len(cells))) @ root.T
        )
