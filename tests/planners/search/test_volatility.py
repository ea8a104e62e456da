"""The ratio of squared error to variance, by predicted gain."""

from __future__ import annotations

import numpy as np

from skygain.planners.search.volatility import GAIN_DB, RATIO, volatility


def test_the_table_is_met_and_the_ends_hold():
    np.testing.assert_allclose(volatility(GAIN_DB), RATIO)
    np.testing.assert_allclose(volatility([-300.0, 0.0]), RATIO[[0, -1]])
    assert (np.diff(GAIN_DB) > 0).all()


def test_between_two_gains_it_lies_between_their_ratios(rng):
    gain = rng.uniform(GAIN_DB[0], GAIN_DB[-1], (7, 9))
    ratio = volatility(gain)
    assert ratio.shape == gain.shape
    k = np.searchsorted(GAIN_DB, gain) - 1
    assert (ratio <= np.maximum(RATIO[k], RATIO[k + 1]) + 1e-12).all()
    assert (ratio >= np.minimum(RATIO[k], RATIO[k + 1]) - 1e-12).all()


def test_it_is_rougher_at_the_edge_of_the_light_than_in_the_shadow():
    assert volatility(-115.0) > 3 * volatility(-165.0)
    assert volatility(-115.0) > volatility(-65.0)
