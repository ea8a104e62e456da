from __future__ import annotations

import numpy as np
import pytest

from skygain.propagation.selfcheck import reflection_boundary_db

from .conftest import needs_rays


@needs_rays
def test_the_boundary_of_a_reflection_tells_right_diffraction_from_wrong(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    traced, expected = reflection_boundary_db()
    assert traced == pytest.approx(expected, abs=0.5)

    # Put the flaw of releases before 2.1.0 back: the wave number in the place of the wavelength.
    import sionna.rt.radio_materials.radio_material as material

    right = material.itu_coefficients_single_layer_slab
    monkeypatch.setattr(
        material,
        "itu_coefficients_single_layer_slab",
        lambda c, eta, d, w: right(c, eta, d, 2 * np.pi / w),
    )
    wrong, _ = reflection_boundary_db()
    assert wrong < expected - 15
