"""The judge of candidates: its sums and its inputs."""

import numpy as np
import pytest

from skygain.networks.operator.judge import INPUTS, TERMS, error_terms, judge_inputs


@pytest.fixture
def readings(rng):
    z, whitened = rng.standard_t(2, size=(2, 40, 7)).astype(np.float32)
    return z, whitened, rng.uniform(2, 15, (40, 7)).astype(np.float32), rng.uniform(-150, -60, 40)


def test_terms_add_up_over_sets_of_readings(readings):
    z, whitened, std, gain = readings
    first, second = (
        error_terms(z[part], whitened[part], std[part], gain[part])
        for part in (slice(0, 13), slice(13, 40))
    )
    assert first.shape == (len(TERMS), 7)
    assert np.allclose(first + second, error_terms(*readings), rtol=1e-4, atol=1e-4)


def test_a_candidate_that_agrees_better_looks_better(readings):
    z, whitened, std, gain = readings
    z, whitened, std = (np.repeat(a[:, :1], 2, axis=1) for a in (z, whitened, std))
    z[:, 1] *= 3
    whitened[:, 1] *= 3
    inputs = judge_inputs(
        error_terms(z, whitened, std, gain), 40, np.full(2, 0.5), np.full(2, 10), np.full(2, 8.0)
    )
    assert inputs.shape == (2, INPUTS)
    assert (inputs[0, :17] == 0).all()
    assert (inputs[1, :17] < 0).all()


def test_candidates_are_judged_alike_in_any_order(readings, rng):
    order = rng.permutation(7)
    sums, mass = error_terms(*readings), rng.dirichlet(np.ones(7))
    squares, spread = rng.integers(1, 30, 7), rng.uniform(0, 20, 7)
    plain = judge_inputs(sums, 40, mass, squares, spread)
    assert np.array_equal(
        plain[order], judge_inputs(sums[:, order], 40, mass[order], squares[order], spread[order])
    )
