"""GPyTorch: an exact process on PyTorch, its covariance by gradient steps on the likelihood."""

from __future__ import annotations

__all__ = ["GPyTorchPredictor"]

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from skygain.fields.offsets import ExponentialKernel
from skygain.ground.errors import require
from skygain.predictors.rivals.base import Answer, Array, RivalPredictor

LENGTH_M = 50.0
"""unit of length, and the range the fit begins with"""
SMALLEST_NOISE = 1e-6
"""of a reading; the library allows no less"""
AT_ONCE = 2000
"""places asked for together: the library holds the covariance between all of them"""
STEPS, RATE = 60, 0.1
"""of Adam, as in the library's own examples"""


def _model(xy: Any, gain: Any, noise: Any, told: ExponentialKernel | None) -> Any:
    """An exact process with an exponential covariance; a nugget counts as noise that all readings
    share."""
    import gpytorch

    shared = told is None or told.nugget_db2 > 0
    likelihood = gpytorch.likelihoods.FixedNoiseGaussianLikelihood(
        noise, learn_additional_noise=shared
    )

    class Exponential(gpytorch.models.ExactGP):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(xy, gain, likelihood)
            self.mean_module = gpytorch.means.ConstantMean()
            self.covar_module = gpytorch.kernels.ScaleKernel(gpytorch.kernels.MaternKernel(nu=0.5))

        def forward(self, x: Any) -> Any:
            return gpytorch.distributions.MultivariateNormal(
                self.mean_module(x), self.covar_module(x)
            )

    model = Exponential().double()
    if shared:
        likelihood.second_noise = 0.05 if told is None else told.nugget_db2
    if told is not None:
        model.covar_module.outputscale = told.sill_db2
        model.covar_module.base_kernel.lengthscale = told.range_m / LENGTH_M
    else:
        model.covar_module.base_kernel.lengthscale = 1.0
    return model


def _nugget(model: Any) -> float:
    shared = getattr(model.likelihood, "second_noise", 0.0)  # a plain 0 where none was asked for
    return float(shared.detach() if hasattr(shared, "detach") else shared)


def _fit(model: Any, xy: Any, gain: Any) -> None:
    """Raise the marginal likelihood by `STEPS` steps."""
    import gpytorch
    import torch

    likelihood = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)
    optimiser = torch.optim.Adam(model.parameters(), lr=RATE)
    model.train()
    for _ in range(STEPS):
        optimiser.zero_grad()
        loss = -likelihood(model(xy), gain)
        loss.backward()
        optimiser.step()


@dataclass(frozen=True)
class GPyTorchPredictor(RivalPredictor):
    """See the module. The answer is exact: no Lanczos, no conjugate gradients."""

    package: ClassVar[str] = "gpytorch"

    def fitted(
        self, xy_m: Array, gain_db: Array, noise_db2: Array, told: ExponentialKernel | None
    ) -> Answer:
        gpytorch, torch = require("gpytorch", "rivals"), require("torch", "rivals")
        xy, gain, noise = (
            torch.as_tensor(a)
            for a in (xy_m / LENGTH_M, gain_db, np.maximum(noise_db2, SMALLEST_NOISE))
        )
        exact = gpytorch.settings.fast_computations(False, False, False)
        with exact:
            model = _model(xy, gain, noise, told)
            if told is None:
                _fit(model, xy, gain)
            model.eval()
            nugget = _nugget(model)

        def answer(at: Array) -> tuple[Array, Array]:
            mean, variance = np.empty((2, len(at)))
            for first in range(0, len(at), AT_ONCE):
                part = slice(first, first + AT_ONCE)
                with torch.no_grad(), gpytorch.settings.fast_pred_var(), exact:
                    found = model(torch.as_tensor(at[part] / LENGTH_M))
                    mean[part], variance[part] = found.mean.numpy(), found.variance.numpy()
            return mean, variance + nugget

        return answer
