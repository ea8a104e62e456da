"""What every network that maps (city, measurements) straight to a gain map shares: it collects
readings and runs the network once asked.

The networks know nothing of noise or repeated readings, so readings of one cell enter as their
precision-weighted mean. A cell measured
exactly is answered with its reading and no variance: the network was told the value, and there is
nothing left to predict.
"""

from __future__ import annotations

__all__ = ["MapNetwork", "NetworkBelief", "posteriors_together"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors.base import Belief
from skygain.predictors.interpolators.readings import Readings, checked_flat, combined
from skygain.scenario import Scenario

MapNetwork = Callable[
    [Sequence[Scenario], NDArray[np.float32], NDArray[np.bool_]], tuple[NDArray, NDArray]
]
"""(scenarios of one shape, gain ``[survey, row, col]``, measured ``[survey, row, col]``) → (mean in
dB, variance in dB²), likewise"""


@dataclass(frozen=True, eq=False)
class NetworkBelief(Belief):
    """The readings so far; the network runs when the posterior is first asked for."""

    scenario: Scenario
    measurements: Measurements
    network: MapNetwork
    """the trained network"""

    @classmethod
    def begun(cls, scenario: Scenario, network: MapNetwork) -> NetworkBelief:
        """No readings yet.

        Raises:
            InputError: the map is wanted at another altitude than the UAVs fly at, which such a
                network never saw.
        """
        if scenario.uav_altitude_m != scenario.prediction_altitude_m:
            raise InputError(
                "this predictor maps the altitude it measures at, got flight at "
                f"{scenario.uav_altitude_m:g} m and prediction at "
                f"{scenario.prediction_altitude_m:g} m; make them equal or use the predictor "
                "'operator'"
            )
        return cls(scenario, Measurements.none(), network)

    def updated(self, measurements: Measurements) -> NetworkBelief:
        checked_flat(self.scenario.grid, measurements)
        return (
            replace(self, measurements=self.measurements.extended(measurements))
            if len(measurements)
            else self
        )

    def posterior(self) -> Posterior:
        return self._posterior

    def network_maps(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(mean in dB, variance in dB²) as the network gives them, at measured cells too."""
        means, variances, _ = _answers([self])
        return means[0], variances[0]

    @cached_property
    def _posterior(self) -> Posterior:
        return posteriors_together([self])[0]


def posteriors_together(beliefs: Sequence[NetworkBelief]) -> list[Posterior]:
    """The posteriors of beliefs that share a network and a map's shape, from one run of the network
    over all of them."""
    found = []
    for mean, variance, readings in zip(*_answers(beliefs), strict=True):
        exact = readings.noise_db2 == 0
        mean.ravel()[readings.cells[exact]] = readings.gain_db[exact]
        variance.ravel()[readings.cells[exact]] = 0.0
        found.append(Posterior(mean, variance))
    return found


def _answers(
    beliefs: Sequence[NetworkBelief],
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[Readings]]:
    """Means and variances ``[survey, row, col]`` of the network, and the readings that went in."""
    grid = beliefs[0].scenario.grid
    gain, measured = (
        np.zeros((len(beliefs), grid.size), dtype=np.float32),
        np.zeros((len(beliefs), grid.size), dtype=bool),
    )
    known = []
    for k, belief in enumerate(beliefs):
        data = belief.measurements
        readings = combined(grid.flat(data.cell), data.gain_db, data.noise_std_db**2)
        gain[k, readings.cells], measured[k, readings.cells] = readings.gain_db, True
        known.append(readings)
    whole = (len(beliefs), *grid.shape)
    means, variances = beliefs[0].network(
        [b.scenario for b in beliefs], gain.reshape(whole), measured.reshape(whole)
    )
    return means.astype(float), variances.astype(float), known
