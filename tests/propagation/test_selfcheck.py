from __future__ import annotations

import numpy as np
import pytest

from skygain.propagation.selfcheck import corner_fields, reflection_boundary_db

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


@needs_rays
def test_a_reflection_and_its_diffracted_field_do_not_join_in_sionna() -> None:
    """The sum should not jump where the reflection ends; with the opposite sign it does not.

    When this fails Sionna RT has mended its wedge, and ``Launching(wedge="sionna")`` can go.
    """
    angle = np.radians(50.0)
    (reflected, before), (nothing, after) = (
        corner_fields(angle, np.pi - angle + d) for d in (-2e-4, 2e-4)
    )
    assert abs(reflected) > 0.4
    assert nothing == 0
    jump = abs(reflected + before - after)
    assert jump == pytest.approx(2 * abs(reflected), rel=0.05)
    assert abs(reflected - before + after) < 0.05 * abs(reflected)
