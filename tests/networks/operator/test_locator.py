"""Evidence about the transmitter, and the network that weighs it."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from skygain.networks.operator.evidence import (
    EVIDENCE_CHANNELS,
    EvidenceSums,
    PositionGrid,
    evidence_channels,
)
from skygain.networks.operator.locator import LocatorNet
from skygain.networks.operator.path_model import USED, PathModel


@pytest.fixture(scope="module")
def model():
    rng = np.random.default_rng(0)
    sizes = (len(USED), 8, 2)
    return PathModel(
        tuple(
            (rng.normal(size=(a, b)).astype(np.float32) / 4, np.zeros(b, np.float32))
            for a, b in pairwise(sizes)
        )
    )


@pytest.fixture
def heights(rng):
    height = np.zeros((24, 20), dtype=np.float32)
    height[3:9, 4:11] = 25.0
    height[14:15, 13] = 12.0
    return height


def test_squares_cover_the_open_ground_of_map_and_margin(heights):
    grid = PositionGrid.over(heights, 4.0, margin_m=40.0)
    assert grid.start == -10
    assert grid.shape == (22, 20)
    row, col = np.divmod(grid.index, grid.shape[1])
    corner = np.stack([row, col], axis=-1) * 2 - 10
    inside = (
        (grid.position[:, :2] >= corner - 0.01) & (grid.position[:, :2] <= corner + 1.01)
    ).all(axis=1)
    assert inside.all()
    blocked = {(r, c) for r, c in np.argwhere(heights > 0).tolist()}
    on_cell = (grid.position[:, :2] % 1 == 0).all(axis=1)
    assert not any(tuple(p) in blocked for p in grid.position[on_cell, :2].astype(int).tolist())
    assert len(grid.index) == 22 * 20 - sum(
        heights[r : r + 2, c : c + 2].all() for r in range(0, 24, 2) for c in range(0, 20, 2)
    )


def test_the_prior_is_that_of_a_map_cut_at_random(heights):
    grid = PositionGrid.over(heights, 4.0, margin_m=40.0)
    prior = grid.dense(grid.prior)
    assert prior.max() == 4.0
    assert prior[0].max() < prior[2].max() < prior[4].max()


def test_evidence_does_not_depend_on_how_the_readings_came(model, heights, rng):
    grid = PositionGrid.over(heights, 4.0, margin_m=40.0)
    free = np.argwhere(heights < 10)
    cells = free[rng.permutation(len(free))[:12]]
    gain = rng.uniform(-130, -70, size=12)

    def after(*sizes):
        sums, at = EvidenceSums.none(grid), 0
        for size in sizes:
            sums = sums.grown(
                model, heights, 4.0, 10.0, cells[at : at + size], gain[at : at + size]
            )
            at += size
        return sums

    assert np.allclose(after(12).sums, after(1, 4, 7).sums, rtol=1e-4, atol=1e-3)
    maps = evidence_channels(after(12), heights, 4.0, 10.0)
    assert maps.shape == (len(EVIDENCE_CHANNELS), *grid.shape)
    assert np.isfinite(maps).all()
    assert np.isfinite(evidence_channels(EvidenceSums.none(grid), heights, 4.0, 10.0)).all()


def test_a_crowd_of_readings_counts_less(model, heights):
    sums = EvidenceSums.none(PositionGrid.over(heights, 4.0, margin_m=40.0))
    crowd = np.array([[12, 10], [12, 11], [12, 12]])
    after = sums.grown(model, heights, 4.0, 10.0, crowd, np.full(3, -90.0))
    assert np.allclose(after.sums[0, 0], 3.0)
    assert np.allclose(after.sums[1, 0], 1.0 + 1 / 2 + 1 / 3)


def test_an_untrained_network_gives_the_tempered_likelihood(model, heights, rng):
    grid = PositionGrid.over(heights, 4.0, margin_m=40.0)
    sums = EvidenceSums.none(grid).grown(
        model, heights, 4.0, 10.0, np.array([[12, 2], [20, 15]]), np.array([-80.0, -110.0])
    )
    maps = evidence_channels(sums, heights, 4.0, 10.0)
    with torch.inference_mode():
        log_probability = (
            LocatorNet().eval()(torch.from_numpy(maps[None]))[0].numpy().reshape(grid.shape)
        )
    assert np.isclose(np.exp(log_probability).sum(), 1, atol=1e-4)
    assert np.isneginf(log_probability[maps[EVIDENCE_CHANNELS.index("open")] == 0]).all()
    open_ = maps[EVIDENCE_CHANNELS.index("open")] > 0
    difference = (
        log_probability[open_] - 5.0 * maps[EVIDENCE_CHANNELS.index("tempered/thinned")][open_]
    )
    assert np.ptp(difference) < 1e-3
