"""scikit-learn's ``GaussianProcessRegressor``: exponential covariance and nugget by maximum
likelihood, without a prior."""

from __future__ import annotations

__all__ = ["ScikitLearnPredictor"]

import warnings
from dataclasses import dataclass
from typing import ClassVar

from skygain.fields.offsets import ExponentialKernel
from skygain.predictors.rivals.base import Answer, Array, RivalPredictor

SMALLEST_NOISE = 1e-9
"""added to the variance of every reading; keeps the factor finite"""


@dataclass(frozen=True)
class ScikitLearnPredictor(RivalPredictor):
    """See the module."""

    package: ClassVar[str] = "sklearn"

    def fitted(
        self, xy_m: Array, gain_db: Array, noise_db2: Array, told: ExponentialKernel | None
    ) -> Answer:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        if told is None:
            kernel = ConstantKernel(1.0, (1e-2, 1e2)) * Matern(50.0, (4.0, 1e3), nu=0.5)
            kernel += WhiteKernel(0.05, (1e-4, 1.0))
        else:
            kernel = ConstantKernel(told.sill_db2, "fixed") * Matern(told.range_m, "fixed", nu=0.5)
            if told.nugget_db2 > 0:
                kernel += WhiteKernel(told.nugget_db2, "fixed")
        model = GaussianProcessRegressor(
            kernel,
            alpha=noise_db2 + SMALLEST_NOISE,
            optimizer="fmin_l_bfgs_b" if told is None else None,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # few readings often end the search on a bound
            model.fit(xy_m, gain_db)

        def answer(xy: Array) -> tuple[Array, Array]:
            mean, std = model.predict(xy, return_std=True)
            return mean, std**2

        return answer
