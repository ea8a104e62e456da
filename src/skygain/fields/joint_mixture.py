"""The posterior of a mixture of beliefs, as one joint distribution of all cells.

Belief i, of weight w_i, has mean m_i(x) and covariance K_i(x, x'). The first two moments of the
mixture are

    m(x) = Σ w_i m_i(x),   K(x, x') = Σ w_i [a_i K_i(x, x') + (m_i(x) − m(x)) (m_i(x') − m(x'))],

where a_i is what the variance of belief i is multiplied by. A cell that every belief knows exactly
has no variance left.
"""

from __future__ import annotations

__all__ = ["JointMixture", "mixed"]

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.fields.planning import FALLBACK_RANGE_M
from skygain.posterior import JointPosterior, Posterior

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class JointMixture(JointPosterior):
    """See the module; made by `mixed`."""

    weight: Array = field(repr=False)
    """``[i]`` w_i, summing to 1"""
    factor: Array = field(repr=False)
    """``[i]`` a_i"""
    beliefs: tuple[Posterior, ...] = field(repr=False)
    """what each believes"""
    spacing_m: float
    """side of a cell, for beliefs that know variances alone"""

    def covariance(self, cells: ArrayLike, others: ArrayLike | None = None) -> Array:
        cells = np.asarray(cells, dtype=np.int64)
        others = cells if others is None else np.asarray(others, dtype=np.int64)
        joint = np.zeros((len(cells), len(others)))
        for weight, factor, belief in zip(self.weight, self.factor, self.beliefs, strict=True):
            joint += weight * factor * self._of(belief, cells, others)
            apart = belief.mean_db - self.mean_db
            joint += weight * np.outer(apart[tuple(cells.T)], apart[tuple(others.T)])
        return joint

    def _of(self, belief: Posterior, cells: NDArray, others: NDArray) -> Array:
        if isinstance(belief, JointPosterior):
            return belief.covariance(cells, others)
        gap = np.hypot(*(cells[:, None] - others[None]).transpose(2, 0, 1)) * self.spacing_m
        std = belief.std_db
        product = np.outer(std[tuple(cells.T)], std[tuple(others.T)])
        return product * np.exp(-gap / FALLBACK_RANGE_M)


def mixed(
    beliefs: Sequence[Posterior], weight: Array, factor: Array, spacing_m: float
) -> JointMixture:
    """The mixture of ``beliefs``.

    Args:
        beliefs: on one map.
        weight: ``[i]`` of each, not negative.
        factor: ``[i]`` what its variance is multiplied by.
        spacing_m: side of a cell.

    >>> low, high = (Posterior(np.full((1, 1), m), np.ones((1, 1))) for m in (-1.0, 1.0))
    >>> both = mixed([low, high], np.array([1.0, 1.0]), np.array([1.0, 3.0]), 4.0)
    >>> both.mean_db.item(), both.variance_db2.item()
    (0.0, 3.0)
    """
    weight = np.asarray(weight, dtype=float) / np.sum(weight)
    mean = sum(w * b.mean_db for w, b in zip(weight, beliefs, strict=True))
    variance = sum(
        w * (a * b.variance_db2 + (b.mean_db - mean) ** 2)
        for w, a, b in zip(weight, factor, beliefs, strict=True)
    )
    return JointMixture(
        np.asarray(mean), np.asarray(variance), weight, factor, tuple(beliefs), spacing_m
    )
