"""The wedge against what theory says where it says it simply."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import fresnel

from skygain.propagation.launching.materials import slab_table
from skygain.propagation.launching.wedge import diffracted, transition_table

FACES = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # a corner at the origin, solid south-east
EDGE = np.array([0.0, 0.0, 1.0])
WAVE_NUMBER = 2 * np.pi / 0.06


def at(angle_in: float, angle_out: float, near: float, far: float, material: str) -> float:
    """|E|² of a vertical field over that of the free path, angles from east."""
    incoming = -np.array([np.cos(angle_in), np.sin(angle_in), 0.0])
    outgoing = np.array([np.cos(angle_out), np.sin(angle_out), 0.0])
    slabs = slab_table([material], [0.3], 5e9)
    e_out = np.zeros(3, dtype=np.complex128)
    e_in = np.array([0, 0, 1], dtype=np.complex128)
    diffracted(
        incoming, outgoing, EDGE, FACES, near, far, WAVE_NUMBER, 0, e_in, slabs,
        transition_table(), e_out,
    )  # fmt: skip
    return float((np.abs(e_out) ** 2).sum() * (near + far) ** 2)


def test_half_the_field_remains_on_the_boundary_of_light() -> None:
    for angle in (0.6, 1.0, 1.4):
        assert at(angle, angle + np.pi, 60.0, 40.0, "concrete") == pytest.approx(0.25, rel=0.1)


def test_half_the_reflected_field_remains_where_a_reflection_ends() -> None:
    # off the western face the angle of reflection is π - φ' on the other side of the normal
    cosine = np.cos(0.7)
    angle_in, angle_out = np.pi - 0.7, np.pi + 0.7
    te = slab_table(["concrete"], [0.3], 5e9)[0, round(4096 * cosine), 0]
    expected = abs(te) ** 2 / 4
    assert at(angle_in, angle_out, 60.0, 40.0, "concrete") == pytest.approx(expected, rel=0.1)


def test_the_field_is_continuous_across_the_edge_of_the_table() -> None:
    angles = 0.8 + np.pi + np.linspace(0.001, 0.6, 400)
    steps = np.diff(np.log([at(0.8, a, 60.0, 40.0, "concrete") for a in angles]))
    assert np.abs(np.diff(steps)).max() < 0.02


def test_the_transition_function_is_that_of_the_fresnel_integrals() -> None:
    root = np.linspace(0.0, 6.0, 3073)[1::37]
    s, c = fresnel(root * np.sqrt(2 / np.pi))
    tail = np.sqrt(np.pi / 2) * ((0.5 - c) - 1j * (0.5 - s))
    expected = 2j * np.exp(1j * root**2) * tail
    assert np.abs(transition_table()[1::37] - expected).max() < 1e-9


def test_a_direction_inside_the_wedge_gives_nothing() -> None:
    e_out = np.zeros(3, dtype=np.complex128)
    inside = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0])
    args = (EDGE, FACES, 10.0, 10.0, WAVE_NUMBER, 0, np.array([0, 0, 1], dtype=np.complex128))
    slabs = slab_table(["concrete"], [0.3], 5e9)
    came = diffracted(np.array([1.0, 0.0, 0.0]), inside, *args, slabs, transition_table(), e_out)
    assert came < 0
