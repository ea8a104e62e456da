"""The launcher's own map as the trend of Kriging (external drift).

With the transmitter and the buildings known, the propagation model that surveys are simulated on
predicts the gain: g(q) = θ₀ + θ₁ · launched(q) + residual. The level θ₀ is whatever the readings
say, for nobody knows the radiated power. The slope θ₁ and the residual's covariance start from one
of three priors, that of a map that is right, of one that is roughly right, and of one that says
nothing; the readings choose.
"""

from __future__ import annotations

__all__ = ["launched_columns", "launched_priors"]

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.predictors.kriging.parameters import FLAT_DB2, KrigingParameters
from skygain.scenario import Scenario

Array = NDArray[np.float64]

LEVEL_DB2 = 100.0
"""prior variance of the level before the first reading"""
PRIORS = (
    # slope, its standard deviation, sill in dB², range in m, nugget in dB², log odds
    (1.0, 0.05, 25.0, 15.0, 9.0, 0.0),
    (1.0, 0.25, 200.0, 30.0, 16.0, -1.0),
    (0.0, 0.10, 500.0, 50.0, 16.0, -2.0),
)
LOG_SPREAD = (1.0, 0.7, 1.0)


def launched_columns(scenario: Scenario, altitude_m: float) -> Array:
    """``[cell, 2]`` ones and the launched gain in dB at every cell, in raveled order.

    Raises:
        InputError: the scenario has no transmitter, or one that cannot be launched from.
    """
    if scenario.transmitter_m is None:
        raise InputError(
            "`predictor=launched` needs the transmitter's position; give `transmitter`, or "
            "`predictor=operator`, which finds it"
        )
    gain = _launched(scenario, scenario.transmitter_m, altitude_m)
    return np.column_stack([np.ones(gain.size), gain])


@lru_cache(maxsize=8)
def _launched(
    scenario: Scenario, transmitter_m: tuple[float, float, float], altitude_m: float
) -> Array:
    from skygain.propagation.truth import trace_truth

    truth = trace_truth(
        scenario.city, transmitter_m, [altitude_m], frequency_hz=scenario.frequency_hz
    )
    return truth.gain_db[0, 0].astype(float).ravel()


def launched_priors(*, flat: bool = True) -> list[tuple[KrigingParameters, float]]:
    """What a survey chooses from, the likeliest first, with the logarithm of the odds; with
    ``flat`` the level may be anything."""
    level = FLAT_DB2 if flat else LEVEL_DB2
    return [
        (
            KrigingParameters(
                (0.0, slope), ((level, 0.0), (0.0, std**2)), sill, range_m, nugget, LOG_SPREAD
            ),
            odds,
        )
        for slope, std, sill, range_m, nugget, odds in PRIORS
    ]
