"""What the networks are trained to maximise, and the scores they are judged by while they train."""

from __future__ import annotations

__all__ = ["gaussian_loss", "gaussian_scores"]

import math

import torch
from torch import Tensor


def gaussian_loss(
    mean: Tensor, log_variance: Tensor, truth: Tensor, mask: Tensor, scale_db: float = 0.0
) -> Tensor:
    """Mean over the masked cells of ½(log σ² + Δ²/σ²), the negative log-likelihood without its
    constant.

    With ``scale_db`` > 0, ½ Δ²/scale² is added: the likelihood alone lets the mean stay wrong
    wherever the variance has learned to be large, a plain squared error does not. The paper's
    equation 4 takes the logarithm of a sum over cells instead of the sum of logarithms, which is no
    likelihood; see the docs page.
    """
    weight = mask.to(mean.dtype)
    square = (mean - truth) ** 2
    loss = 0.5 * (log_variance + square * torch.exp(-log_variance))
    if scale_db > 0:
        loss = loss + 0.5 * square / scale_db**2
    return (loss * weight).sum() / weight.sum().clamp(min=1.0)


def gaussian_scores(
    mean: Tensor, log_variance: Tensor, truth: Tensor, mask: Tensor, ray_traced: Tensor
) -> dict[str, Tensor]:
    """Sums per map ``[batch]`` from which `train` forms RMSE, NLL, goodness of fit and the cover of
    the 90 % interval."""
    weight = mask.to(mean.dtype)
    square = (mean - truth) ** 2
    ratio = square * torch.exp(-log_variance)
    traced = weight * ray_traced.to(mean.dtype)

    def per_map(x: Tensor) -> Tensor:
        return x.flatten(1).sum(1).double()

    return {
        "cells": per_map(weight),
        "square": per_map(square * weight),
        "traced_cells": per_map(traced),
        "traced_square": per_map(square * traced),
        "nll": per_map(0.5 * (log_variance + ratio + math.log(2 * math.pi)) * weight),
        "ratio": per_map(ratio * weight),
        "covered": per_map((ratio <= 1.6448536**2).to(mean.dtype) * weight),
    }
