from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from skygain.ground.errors import InputError
from skygain.propagation import PROPAGATION, RAYS_ALONE

from .conftest import RAYS, box, city_of


@pytest.mark.parametrize("name", PROPAGATION.names())
def test_each_model_has_the_common_signature(name: str) -> None:
    if name == "raytrace" and not RAYS:
        pytest.skip("Sionna RT, shapely or LLVM is missing: pip install 'skygain[raytrace]'")
    city = city_of([box(20, 20, 40, 60, 15.0)], shape=(20, 22))
    gain = PROPAGATION.create(
        name,
        city=city,
        transmitters_m=[(10.0, 10.0, 1.5), (70.0, 70.0, 1.5)],
        altitudes_m=[10.0, 20.0, 30.0],
        frequency_hz=5e9,
        seed=3,
    )
    assert gain.shape == (2, 3, 20, 22)
    assert gain.dtype == np.float32
    assert not np.isnan(gain).any()
    assert (gain < 0).all()
    if name not in RAYS_ALONE:
        assert np.isfinite(gain).all()


def test_an_unknown_model_is_answered_with_the_names() -> None:
    with pytest.raises(InputError, match="did you mean 'raytrace'"):
        PROPAGATION.factory("ray-trace")


def test_naming_the_models_loads_nothing_heavy() -> None:
    code = (
        "import sys, skygain.propagation; print([m for m in ('numba', 'mitsuba', 'drjit', 'scipy', "
        "'shapely') if m in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )
