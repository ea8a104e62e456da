"""What readings along streets would teach about the map: sites, targets, and what is planned."""

from __future__ import annotations

__all__ = ["Lessons"]

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from skygain.fields.planning import planning_field
from skygain.planners.search.reach import target_cells
from skygain.planners.search.volatility import volatility
from skygain.predictors.base import Belief

Floats = NDArray[np.float32]

MOST_TARGETS = 500
"""cells that stand for the map"""
MOST_READINGS = 500
"""readings conditioned on, spread over the map"""


@dataclass(eq=False)
class Lessons:
    """What readings at sites would teach about the map, given those that are planned."""

    among: Floats
    """``[s, s + x]`` covariance of sites with sites and weighted targets, before any plan"""
    noise_db2: float
    """of a planned reading"""
    anyway: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """sites whose readings ``among`` takes as given"""

    def __post_init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self.now = self.among.copy()
        self.planned = np.zeros(len(self.among), dtype=bool)
        self.planned[self.anyway] = True

    def after(self, sites: NDArray[np.int64]) -> Lessons:
        """What is left when sites are read in any case; forgets all plans."""
        self.begin(sites)
        return Lessons(self.now.copy(), self.noise_db2, np.flatnonzero(self.planned))

    @classmethod
    def about(
        cls, belief: Belief, sites: NDArray[np.int64], noise_db2: float, *, weighted: bool = True
    ) -> Lessons:
        """The lessons that sites hold for what ``belief`` does not know; ``weighted`` as in
        `SequentialGreedyPlanner`."""
        field = planning_field(belief)
        scenario = belief.scenario
        visited = belief.measurements.visited(scenario.grid.shape)
        weight = (scenario.outdoor & ~visited).astype(float)
        if field.kernel and weighted:
            weight *= volatility(field.posterior.mean_db)
        middle = (np.array(weight.shape) - 1) / 2
        targets, mass = target_cells(weight, middle, float(max(weight.shape)), MOST_TARGETS)
        thinned = field
        side = 1
        while len(thinned.cells) > MOST_READINGS:
            side += 1
            square = field.cells // side
            _, first = np.unique(square[:, 0] * weight.shape[1] + square[:, 1], return_index=True)
            thinned = replace(field, cells=field.cells[first], noise_db2=field.noise_db2[first])
        source = thinned.conditioned(np.float32)
        white = source.whitened(np.concatenate([sites, targets]))
        mine, theirs = white[:, : len(sites)], white[:, len(sites) :]
        among = np.concatenate(
            [
                source.covariance(sites, sites, mine, mine),
                source.covariance(sites, targets, mine, theirs) * np.sqrt(mass),
            ],
            axis=1,
        )
        return cls(np.ascontiguousarray(among, dtype=np.float32), noise_db2)

    @property
    def single(self) -> Floats:
        """``[s]`` what each site alone would teach now; nothing where it is planned."""
        n = len(self.now)
        variance = np.maximum(self.now[:, :n].diagonal(), 0.0) + self.noise_db2
        gain = (self.now[:, n:] ** 2).sum(axis=1) / variance
        return np.where(self.planned, 0.0, gain).astype(np.float32)

    def gain(self, sites: NDArray[np.int64]) -> float:
        """What sites together would teach now."""
        white = self._white(sites, self.now[sites, len(self.now) :])
        return float((white**2).sum())

    def plan(self, sites: NDArray[np.int64]) -> None:
        """Take readings at sites as planned."""
        sites = sites[~self.planned[sites]]
        if len(sites):
            white = self._white(sites, self.now[sites])
            self.now -= white[:, : len(self.now)].T @ white
            self.planned[sites] = True

    def begin(self, sites: NDArray[np.int64]) -> None:
        """Forget all plans but readings at sites."""
        self._forget()
        self.plan(sites)

    def _white(self, sites: NDArray[np.int64], cross: Floats) -> Floats:
        gram = self.now[np.ix_(sites, sites)].astype(float)
        gram[np.diag_indices_from(gram)] += self.noise_db2
        factor = np.linalg.cholesky(gram).astype(np.float32)
        return solve_triangular(factor, cross, lower=True, check_finite=False)
