"""A belief that looks ahead: readings not taken yet are taken to be what is expected.

Such readings say how sure the map will be, not what it will show. A Kriging belief that fitted its
covariance to them would take their agreement for a smooth field, so its parameters stay as the real
readings left them.
"""

from __future__ import annotations

__all__ = ["ahead_of", "with_expected"]

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.predictors.base import Belief
from skygain.predictors.kriging.known_source import KrigingBelief
from skygain.predictors.kriging.local import LocalKrigingBelief, LocalKrigingPredictor

EXPECTED_STD_DB = 1.0
"""noise of a reading that is only expected"""


def ahead_of(belief: Belief) -> Belief:
    """``belief`` made ready for readings that are only expected."""
    if isinstance(belief, KrigingBelief):
        settled = replace(belief.predictor, refit=False)
        return KrigingBelief(settled, belief.scenario, belief.measurements, belief.state)
    if isinstance(belief, LocalKrigingBelief):
        settled_local = LocalKrigingPredictor(parameters=belief.parameters, refit=False)
        try:
            return settled_local.begin(belief.scenario).updated(belief.measurements)
        except InputError:  # parameters of a map that is larger than the trained path-loss line
            return belief
    return belief


def with_expected(belief: Belief, cells: NDArray[np.int64]) -> Belief:
    """The belief after what it expects was read at ``cells[n, (row, col)]``."""
    cells = np.unique(np.asarray(cells, dtype=np.int64).reshape(-1, 2), axis=0)
    gain = belief.posterior().mean_db[cells[:, 0], cells[:, 1]]
    return belief.updated(Measurements.at(cells, gain, noise_std_db=EXPECTED_STD_DB))
