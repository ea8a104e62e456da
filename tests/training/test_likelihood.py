"""The loss is the likelihood."""

import numpy as np
import torch

from skygain.training.likelihood import gaussian_loss


def test_loss_is_the_normal_likelihood_without_its_constant(rng):
    mean, truth = (torch.from_numpy(rng.normal(size=(2, 5, 5))) for _ in range(2))
    log_variance = torch.from_numpy(rng.normal(size=(2, 5, 5)))
    mask = torch.from_numpy(rng.random((2, 5, 5)) < 0.5)
    normal = torch.distributions.Normal(mean, torch.exp(0.5 * log_variance))
    expected = -normal.log_prob(truth)[mask].mean() - 0.5 * np.log(2 * np.pi)
    assert torch.isclose(gaussian_loss(mean, log_variance, truth, mask), expected)
