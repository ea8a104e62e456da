"""PyKrige: ordinary Kriging with a variogram fitted by least squares. It knows no noise of single
readings."""

from __future__ import annotations

__all__ = ["PyKrigePredictor"]

import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skygain.fields.offsets import ExponentialKernel
from skygain.predictors.rivals.base import Answer, Array, RivalPredictor


@dataclass(frozen=True)
class PyKrigePredictor(RivalPredictor):
    """See the module. The mean is always estimated; that of given ``parameters`` is not used."""

    package: ClassVar[str] = "pykrige"

    def fitted(
        self, xy_m: Array, gain_db: Array, noise_db2: Array, told: ExponentialKernel | None
    ) -> Answer:
        from pykrige.ok import OrdinaryKriging

        if told is not None and len(xy_m) == 1:
            return _single(xy_m, gain_db, told)
        parameters = None
        if told is not None:  # its range is where 95 % of the sill is reached
            parameters = {
                "psill": told.sill_db2,
                "range": 3 * told.range_m,
                "nugget": told.nugget_db2,
            }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = OrdinaryKriging(
                *xy_m.T, gain_db, variogram_model="exponential", variogram_parameters=parameters
            )

        def answer(xy: Array) -> tuple[Array, Array]:
            mean, variance = model.execute("points", *xy.T, backend="vectorized")
            return np.asarray(mean), np.asarray(variance)

        return answer


def _single(xy_m: Array, gain_db: Array, told: ExponentialKernel) -> Answer:
    """Ordinary Kriging from one reading, which the library refuses: the reading everywhere, with
    twice the variogram."""

    def answer(xy: Array) -> tuple[Array, Array]:
        distance = np.linalg.norm(xy - xy_m, axis=1)
        variogram = told.nugget_db2 + told.sill_db2 * (1 - np.exp(-distance / told.range_m))
        return np.full(len(xy), gain_db[0]), 2 * variogram

    return answer
