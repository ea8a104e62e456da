"""The probabilistic prediction of Malmirchegini and Mostofi (2012), step by step.

With a known transmitter, path loss is a line over the logarithm of the distance, fitted by least
squares. What it leaves is shadowing with variance φ that decorrelates exponentially over δ, and
multipath with variance ν that differs from cell to cell. φ, δ and ν are fitted to the empirical
correlation of the residuals by weighted least squares, and the gain elsewhere is normal given the
readings. Nothing is trained and nothing is a prior, so few readings make a rough fit.
"""

from __future__ import annotations

__all__ = ["MalmircheginiPredictor"]

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from skygain.measurements import Measurements
from skygain.predictors.interpolators.interpolation import InterpolationBelief, ReadingsPredictor
from skygain.predictors.interpolators.readings import Readings
from skygain.predictors.kriging.known_source import KrigingPredictor
from skygain.predictors.kriging.parameters import KrigingParameters, trend_columns
from skygain.scenario import Scenario

Array = NDArray[np.float64]

FREE_SPACE_DB = 20.0
"""slope in dB per decade where there are too few readings for a line"""
BINS = 24
"""distances at which the correlation is estimated"""
PAIRS = 5
"""pairs of readings that a distance needs to count"""
LEAST_READINGS = 6
"""with fewer, φ, δ and ν are `FIRST`"""
FIRST = (64.0, 40.0, 4.0)
"""φ in dB², δ in m and ν in dB² before they can be estimated"""


@dataclass(frozen=True)
class MalmircheginiPredictor(ReadingsPredictor):
    """See the module; needs the transmitter's position."""

    transmitter: Literal["required", "optional", "unused"] = field(
        init=False, repr=False, default="required"
    )
    """path loss is a line over the distance to it"""

    def begin(self, scenario: Scenario) -> InterpolationBelief:
        """The belief before the first measurement.

        Raises:
            InputError: the scenario has no transmitter.
        """
        trend_columns("log-distance", scenario.grid, 10.0, scenario.transmitter_m)
        return super().begin(scenario)

    def predict(self, scenario: Scenario, readings: Readings) -> tuple[Array, Array]:
        columns = trend_columns(
            "log-distance", scenario.grid, scenario.uav_altitude_m, scenario.transmitter_m
        )
        h, gain = columns[readings.cells], readings.gain_db
        if len(gain) > 2:
            line, *_ = np.linalg.lstsq(h, gain, rcond=None)
        else:
            line = np.array([gain.mean() - FREE_SPACE_DB * h[:, 1].mean(), FREE_SPACE_DB])
        xy = scenario.grid.xy_m(scenario.grid.cells[readings.cells])
        sill, range_m, nugget = estimated(xy, gain - h @ line)
        parameters = KrigingParameters.known_trend(
            *line.tolist(), sill_db2=sill, range_m=range_m, nugget_db2=nugget
        )
        places = scenario.grid.cells[readings.cells]
        data = Measurements.at(places, gain, noise_std_db=np.sqrt(readings.noise_db2))
        kriging = KrigingPredictor(parameters=parameters, refit=False)
        posterior = kriging.begin(scenario).updated(data).posterior()
        return posterior.mean_db.ravel().copy(), posterior.variance_db2.ravel().copy()


def estimated(xy_m: Array, residual_db: Array) -> tuple[float, float, float]:
    """φ in dB², δ in m and ν in dB² of residuals ``[n]`` at ``xy_m[n, 2]``."""
    if len(residual_db) < LEAST_READINGS:
        return FIRST
    variance = max(float(np.mean(residual_db**2)), 1e-6)
    first, second = np.triu_indices(len(residual_db), 1)
    distance = np.hypot(*(xy_m[first] - xy_m[second]).T)
    product = residual_db[first] * residual_db[second]
    edges = np.linspace(0.0, float(distance.max()) / 2 + 1e-9, BINS + 1)
    at = np.digitize(distance, edges) - 1
    inside = at < BINS
    count = np.bincount(at[inside], minlength=BINS)
    used = count >= PAIRS
    if not used.any():
        return variance * 0.9, FIRST[1], variance * 0.1
    middle = np.bincount(at[inside], distance[inside], BINS)[used] / count[used]
    correlation = np.bincount(at[inside], product[inside], BINS)[used] / count[used]
    weight = np.sqrt(count[used] / count.sum())

    def missing(x: Array) -> Array:
        share, log_range = x
        modelled = variance * share * np.exp(-middle / np.exp(log_range))
        return weight * (modelled - correlation) / variance

    bounds = ([0.05, np.log(1.0)], [0.999, np.log(2e3)])
    found = least_squares(missing, (0.8, np.log(FIRST[1])), bounds=bounds)
    share, range_m = float(found.x[0]), float(np.exp(found.x[1]))
    return variance * share, range_m, variance * (1.0 - share)
