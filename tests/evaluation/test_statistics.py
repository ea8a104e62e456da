"""The bootstrap covers what it should, resamples cities rather than surveys, and flight saved
follows its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from skygain.evaluation.statistics import bootstrap_mean, city_weights, flight_saved


def test_interval_matches_scipy_when_every_city_has_one_survey(rng: np.random.Generator) -> None:
    values = rng.normal(5, 2, 40)
    ours = bootstrap_mean(values, np.arange(40), resamples=20_000)
    theirs = stats.bootstrap(
        (values,), np.mean, n_resamples=20_000, method="percentile", rng=rng
    ).confidence_interval
    assert ours.mean == pytest.approx(values.mean())
    assert ours.low == pytest.approx(theirs.low, abs=0.06)
    assert ours.high == pytest.approx(theirs.high, abs=0.06)


def test_copies_of_a_survey_in_its_city_add_no_certainty(rng: np.random.Generator) -> None:
    values, cities = rng.normal(size=12), np.arange(12)
    once = bootstrap_mean(values, cities)
    many = bootstrap_mean(np.repeat(values, 50), np.repeat(cities, 50))
    assert (many.low, many.high) == pytest.approx((once.low, once.high))


def test_one_city_has_a_mean_and_no_interval() -> None:
    """Its surveys say nothing about other cities; a width of zero would claim certainty."""
    interval = bootstrap_mean([3.0, 5.0], [4, 4])
    assert interval.mean == 4.0
    assert math.isnan(interval.low)
    assert math.isnan(interval.high)
    assert str(interval) == "4.00 [–]"


def test_weights_sum_to_one_and_keep_cities_together() -> None:
    weights = city_weights([0, 0, 1, 2], resamples=50)
    assert np.allclose(weights.sum(axis=1), 1)
    assert np.allclose(weights[:, 0], weights[:, 1])


def test_flight_saved_interpolates_and_admits_defeat() -> None:
    steps = [50, 100, 150, 200]
    assert flight_saved(steps, [12.0, 8.0, 6.0, 5.0], [16.0, 14.0, 12.0, 10.0]) == pytest.approx(
        200 / 75
    )
    assert math.isnan(flight_saved(steps, [16.0, 14.0, 12.0, 11.0], [16.0, 14.0, 12.0, 10.0]))
    assert flight_saved(steps, [9.0, 9.0, 9.0, 9.0], [16.0, 14.0, 12.0, 10.0]) == 4.0
