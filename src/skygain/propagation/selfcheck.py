"""Small scenes with a known answer, to prove that the installed ray tracer works and computes
diffraction rightly.

`skygain doctor` runs them. The answers come from the theory, not from an earlier run of ours:
Friis' equation where there is a line of sight, and half the reflected field on the boundary where a
wall's reflection ends (uniform theory of diffraction).
"""

from __future__ import annotations

__all__ = ["TwoBoxes", "corner_fields", "reflection_boundary_db", "trace_two_boxes", "two_box_city"]

import time
from dataclasses import dataclass

import numpy as np

from skygain.city import Building, City
from skygain.grid import Grid
from skygain.propagation.diffraction import free_space_gain_db
from skygain.propagation.mesh import prism_mesh
from skygain.propagation.sionna import load_backend, scene_object, trace_gain_db

_FREQUENCY_HZ = 5e9


@dataclass(frozen=True)
class TwoBoxes:
    """What tracing the two-box scene gave."""

    seconds: float
    """wall time, with compiling"""
    line_of_sight_error_db: float
    """median absolute difference from Friis of the cells in sight, when only the direct path is
    traced"""
    shadow_db: float
    """median gain relative to free space of the cells that only reflected or diffracted rays
    reached; negative"""
    reached: float
    """fraction of the outdoor cells that a ray reached"""


def two_box_city() -> City:
    """A square of 120 m with two boxes of 20 × 40 m, 25 m high, left and right of its middle."""
    grid = Grid(shape=(30, 30), spacing_m=4.0, origin_m=(2.0, 2.0))
    boxes, height = [], np.zeros(grid.shape, dtype=np.float32)
    for west in (20.0, 80.0):
        boxes.append(
            Building(
                np.array([[west, 40.0], [west + 20, 40.0], [west + 20, 80.0], [west, 80.0]]), 25.0
            )
        )
        height[10:20, int(west / 4) : int(west / 4) + 5] = 25.0
    return City(grid=grid, height_m=height, buildings=tuple(boxes), name="two boxes")


def trace_two_boxes(samples: int = 300_000) -> TwoBoxes:
    """Trace the two-box scene from a transmitter between the boxes and compare with what must come
    out."""
    started = time.perf_counter()
    city = two_box_city()
    transmitter, altitude = (60.0, 60.0, 1.5), 10.0
    direct = trace_gain_db(
        city, transmitter, [altitude], samples=samples, max_reflections=0, diffraction=False
    )
    full = trace_gain_db(city, transmitter, [altitude], samples=samples)
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    friis = free_space_gain_db(np.sqrt((x - 60.0) ** 2 + (y - 60.0) ** 2 + (altitude - 1.5) ** 2))
    outdoor = ~city.obstructed(altitude)
    between = (np.abs(x - 60.0) < 18.0) & (np.abs(y - 60.0) < 18.0)
    shadow = outdoor & full.ray_reached[0, 0] & ~direct.ray_reached[0, 0]
    return TwoBoxes(
        seconds=time.perf_counter() - started,
        line_of_sight_error_db=float(np.median(np.abs(direct.gain_db[0, 0] - friis)[between])),
        shadow_db=float(np.median((full.gain_db[0, 0] - friis)[shadow])),
        reached=float(full.ray_reached[0, 0][outdoor].mean()),
    )


def reflection_boundary_db() -> tuple[float, float]:
    """Diffracted gain on a reflection's shadow boundary, relative to free space: (traced,
    expected), both in dB.

    A wall of concrete ends in a vertical edge. Where its reflection ends, the diffracted field is
    half the reflected one, so the expected value is 20 log10(|R| / 2) with the Fresnel coefficient
    R of the polarisation along the edge. Releases of Sionna RT with the wrong wavelength in that
    coefficient trace about 20 dB less.
    """
    cos_incidence, ghz = 0.6, _FREQUENCY_HZ / 1e9
    angle = np.arcsin(cos_incidence)
    (_reflected, diffracted) = corner_fields(angle, np.pi - angle)
    permittivity = 5.24 - 1j * 17.98 * 0.0462 * ghz**0.7822 / ghz  # concrete of ITU-R P.2040
    root = np.sqrt(permittivity - (1 - cos_incidence**2))
    reflection = (cos_incidence - root) / (cos_incidence + root)
    return float(20 * np.log10(abs(diffracted))), float(20 * np.log10(abs(reflection) / 2))


def corner_fields(angle_in: float, angle_out: float) -> tuple[complex, complex]:
    """The reflected and the diffracted field at a vertical corner of concrete, over that of the
    direct path unfolded, both ends 25 m from it; the angles go round it from a face."""
    rt = load_backend()
    import mitsuba

    distance_m = 25.0
    corner = np.array([[0.0, -40.0], [40.0, -40.0], [40.0, 0.0], [0.0, 0.0]])
    scene = rt.load_scene()
    scene.frequency = _FREQUENCY_HZ
    scene.tx_array = scene.rx_array = rt.PlanarArray(
        num_rows=1, num_cols=1, pattern="iso", polarization="V"
    )
    # So tall that only the vertical edge matters.
    scene.add(
        scene_object(
            rt, prism_mesh(Building(corner, 400.0)), "wall", np.array([0.0, 0.0, 200.0]), 0.3
        )
    )
    for kind, name, angle in (
        (rt.Transmitter, "transmitter", angle_in),
        (rt.Receiver, "receiver", angle_out),
    ):
        place = distance_m * np.array([np.cos(angle), np.sin(angle)])
        scene.add(kind(name, position=mitsuba.Point3f(float(place[0]), float(place[1]), 0.0)))
    paths = rt.PathSolver()(
        scene,
        max_depth=1,
        los=False,
        refraction=False,
        diffraction=True,
        diffraction_lit_region=True,
        samples_per_src=100_000,
        seed=1,
    )
    real, imaginary = (part.numpy().ravel() for part in paths.a)
    kinds = paths.interactions.numpy().ravel()
    turned = np.exp(-2j * np.pi * _FREQUENCY_HZ * paths.tau.numpy().ravel().clip(0.0))
    field = (
        (real + 1j * imaginary)
        * turned
        / 10 ** (free_space_gain_db(2 * distance_m, _FREQUENCY_HZ) / 20)
    )
    return complex(field[kinds == 1].sum()), complex(field[kinds == 8].sum())
