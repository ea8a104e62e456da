"""The posterior of a mixture of models, as one joint distribution of all cells.

Model c, of weight w_c, says the gain at x is m_c(x) + s_c(x)·ε(x) with ε a field common to all
models whose correlation given the readings is R(x, x'). The first two moments of the mixture are

    m(x) = Σ_c w_c m_c(x),    K(x, x') = R(x, x') Σ_c w_c s_c(x) s_c(x') + Σ_c w_c (m_c(x) − m(x))
    (m_c(x') − m(x')).

The second sum is what the models disagree about: two far cells are tied by it if the same models
are high at both, which is how a reading in one street teaches something about another. A linear
estimate with K is never better than conditioning the mixture itself, so a fall of variance computed
from K is one that the true belief can be expected to reach or exceed.
"""

from __future__ import annotations

__all__ = ["MixturePosterior"]

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.fields.offsets import at_offsets
from skygain.fields.planning import less_product
from skygain.posterior import JointPosterior

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False, repr=False)
class MixturePosterior(JointPosterior):
    """See the module. The variance is the diagonal of K."""

    weight: Floats = field(repr=False)
    """``[c]`` w_c, summing to 1"""
    means_db: Floats = field(repr=False)
    """``[c, row * col]`` m_c"""
    stds_db: Floats = field(repr=False)
    """``[c, row * col]`` s_c, before the readings"""
    correlation: Floats = field(repr=False)
    """``[|row difference|, |col difference|]`` correlation of ε before the readings"""
    whitened: Floats = field(repr=False)
    """``[n, row * col]`` correlation of the n whitened readings with ε everywhere"""
    tie: float
    """correlation of ε between the altitudes of measurement and prediction"""
    known: NDArray[np.bool_] = field(repr=False)
    """``[row * col]`` cells without any doubt left"""
    factor: float
    """calibration: K is multiplied by this"""

    def covariance(self, cells: ArrayLike, others: ArrayLike | None = None) -> NDArray[np.float64]:
        cells = np.asarray(cells, dtype=np.int64)
        others = cells if others is None else np.asarray(others, dtype=np.int64)
        a, b = self._flat(cells), self._flat(others)
        stds, apart = self._by_cell
        here, there = self._whitened_at(a), self._whitened_at(b)
        joint = less_product(at_offsets(self.correlation, cells, others), here, there)
        joint *= stds[a] @ stds[b].T
        joint += apart[a] @ apart[b].T
        joint[self.known[a]] = 0.0
        joint[:, self.known[b]] = 0.0
        return joint.astype(float)

    @cached_property
    def _by_cell(self) -> tuple[Floats, Floats]:
        """``[row * col, c]`` of every cell: √(factor·w_c) s_c and √(factor·w_c) (m_c − m)."""
        root = np.sqrt(self.factor * self.weight)
        apart = self.means_db - self.weight @ self.means_db
        stds, apart = (np.ascontiguousarray(maps.T) * root for maps in (self.stds_db, apart))
        return stds, apart

    def _whitened_at(self, flat: NDArray[np.int64]) -> Floats:
        """``[n, cell]`` of raveled cells, times the tie."""
        columns = np.take(self.whitened, flat, axis=1)
        return columns if self.tie == 1.0 else columns * np.float32(self.tie)

    def _flat(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        return cells[:, 0] * self.mean_db.shape[1] + cells[:, 1]
