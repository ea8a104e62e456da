"""Truth: the stronger of two models, with an account of which."""

from __future__ import annotations

import numpy as np

from skygain.propagation.diffraction import over_rooftop_gain_db
from skygain.propagation.launching.launch import launch_gain_db
from skygain.propagation.truth import trace_truth

from .conftest import box, city_of


def test_truth_is_the_stronger_of_both_and_finite_everywhere() -> None:
    city = city_of([box(20, 40, 40, 80, 25.0), box(80, 40, 100, 80, 25.0)])
    positions, altitudes = [(60.0, 60.0, 1.5), (10.0, 10.0, 1.5)], [10.0, 20.0]
    truth = trace_truth(city, positions, altitudes)
    rays = launch_gain_db(city, positions, altitudes)
    roof = over_rooftop_gain_db(city, positions, altitudes)
    assert np.isfinite(truth.gain_db).all()
    assert np.array_equal(truth.gain_db, np.maximum(rays.gain_db, roof))
    assert np.array_equal(truth.ray_traced, rays.ray_reached & (rays.gain_db >= roof))
    assert truth.gain_db.dtype == np.float32
    assert 0.2 < truth.ray_traced.mean() < 1
    assert truth.settings.facts["model"] == "launch"
