"""Ray-traced gain of a whole map, by Sionna RT's radio-map solver.

The scene is the city's real building polygons as prisms (`skygain.propagation.mesh`) on a flat
ground, all of ITU-R P.2040 concrete: walls 0.3 m thick, the ground 1 m. Antennas are isotropic and
vertically polarised.

What the solver computes. For each cell C of a horizontal plane at the chosen altitude it estimates,
by Monte Carlo over rays,

    g = 1/|C| ∫_C Σ_n |a_n(s)|² ds

the power of all paths n added without their phases and averaged over the cell. So the result is a
local mean, free of fast fading; inside one cell (4 m) the linear mean of the power is taken, and 10
log10 after it.

Depth. Sionna's ``max_depth`` counts the interactions with the scene of a path without diffraction:
``max_depth = max_reflections`` gives the line of sight and up to that many specular reflections.
First-order diffraction is a second stage, which follows paths transmitter - edge - cell with no
reflection before or after, whatever ``max_depth`` (at least 1) is. "Three reflections and one
diffraction" therefore means here: at most three reflections, or one diffraction. Refraction into
walls, which Sionna has on unless told otherwise, and diffuse scattering are off; diffraction is
evaluated in the lit region too.

Transmitters. Several can share a solver call. They then share its diffraction samples too: edges
are drawn from those that any of the transmitters sees, so each gets fewer useful samples and a
noisier map. On a processor a shared call is no faster than a loop, so one transmitter per call is
the default; on a graphics card sharing saves overhead. docs/propagation.md has the measurements.

Too much gain. Left alone, the solver puts single cells up to 50 dB above free space where a roof
edge nearly lies in the plane of the cells; such roofs are moved away a little before tracing
(`_clearance_m`). What too few rays or a street canyon still lift above free space + `GUARD_DB` is
cut to it, and the number of cells touched is reported. docs/propagation.md tells the whole story.

Reproducibility. Rays add up their power with atomic operations, so with several threads the last
bits of a sum, and which of two edges wins a slot of the solver's edge table, depend on the order in
which threads arrive: runs with one seed then differ by up to some tenths of a dB in single cells.
With ``threads=1``, the default, the same seed gives the same bytes on the same processor type and
LLVM release. Dataset building therefore runs one process per core instead of several threads.
"""

from __future__ import annotations

__all__ = [
    "DEFAULT_SAMPLES",
    "GUARD_DB",
    "RayTraced",
    "RayTracing",
    "check_release",
    "load_backend",
    "raytrace",
    "scene_object",
    "trace_gain_db",
]

import importlib
import importlib.metadata
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.city import City
from skygain.ground import llvm
from skygain.ground.errors import InputError, require
from skygain.propagation.base import (
    check_altitudes,
    check_frequency,
    check_transmitters,
)
from skygain.propagation.diffraction import free_space_gain_db
from skygain.propagation.mesh import Mesh, city_buildings, clear_of_plane, ground_mesh, prism_mesh

DEFAULT_SAMPLES = 10_000_000
"""rays per transmitter; docs/propagation.md has the measurements behind it"""

GUARD_DB = 6.0
"""most that a cell may exceed free space by; what is above is cut to it"""

FIRST_GOOD_RELEASE = (2, 1, 0)
"""first release of Sionna RT with the corrected diffraction coefficients"""

LARGEST_CLEARANCE_M = 1.5
"""roofs are never moved further than this from the plane of the cells"""

GROUND_MARGIN_M = 500.0
"""how far the ground reaches beyond the map and the transmitters"""

_VARIANTS = ("cuda_ad_mono_polarized", "llvm_ad_mono_polarized")


@dataclass(frozen=True)
class RayTracing:
    """How a map was traced."""

    frequency_hz: float = 5e9
    """carrier frequency"""
    samples: int = DEFAULT_SAMPLES
    """rays per transmitter"""
    seed: int = 0
    """seed of the solver"""
    max_reflections: int = 3
    """most specular reflections on one path"""
    diffraction: bool = True
    """whether paths over one diffracting edge are added"""
    threads: int = 1
    """processor threads; more than one gives up bitwise reproducibility"""
    transmitters_per_call: int = 1
    """transmitters that share a solver call"""


@dataclass(frozen=True)
class RayTraced:
    """Ray-traced maps."""

    gain_db: NDArray[np.float32]
    """``[transmitter, altitude, row, col]``; -inf where no ray reached, so that a maximum with
    another model works; means nothing inside buildings"""
    ray_reached: NDArray[np.bool_]
    """``[transmitter, altitude, row, col]`` whether a ray reached the cell"""
    guarded: int
    """outdoor cells whose gain was cut to free space + `GUARD_DB`"""
    settings: RayTracing
    """how it was traced"""
    release: str = ""
    """release of Sionna RT"""
    variant: str = field(default="")
    """Mitsuba variant, tells processor from graphics card"""


def raytrace(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    seed: int = 0,
    samples: int = DEFAULT_SAMPLES,
) -> NDArray[np.float32]:
    """The model ``raytrace``: the gain of `trace_gain_db`, -inf where no ray arrived."""
    return trace_gain_db(
        city, transmitters_m, altitudes_m, frequency_hz=frequency_hz, seed=seed, samples=samples
    ).gain_db


def trace_gain_db(
    city: City,
    transmitters_m: ArrayLike,
    altitudes_m: Sequence[float],
    *,
    frequency_hz: float = 5e9,
    samples: int = DEFAULT_SAMPLES,
    seed: int = 0,
    max_reflections: int = 3,
    diffraction: bool = True,
    threads: int = 1,
    transmitters_per_call: int = 1,
) -> RayTraced:
    """Trace the gain from each transmitter to each cell of the city's grid at each altitude.

    Args:
        city: polygons, or a height raster to build boxes from.
        transmitters_m: ``[transmitter, (x, y, z)]`` in the city's metres, z above the street.
        altitudes_m: heights of the receiving planes above the street.
        frequency_hz: carrier frequency, 1 to 100 GHz (the validity of the ITU concrete).
        samples: rays per transmitter.
        seed: not negative; the same seed gives the same bytes with one thread.
        max_reflections: most specular reflections on one path.
        diffraction: add the paths over one edge.
        threads: processor threads of the solver.
        transmitters_per_call: how many transmitters share one solver call; each altitude is a call
            of its own.

    Raises:
        InputError: an argument that cannot be used, or a Sionna RT or LLVM that is missing or too
            old; the message names the remedy.
    """
    settings = RayTracing(
        check_frequency(frequency_hz),
        samples,
        seed,
        max_reflections,
        diffraction,
        threads,
        transmitters_per_call,
    )
    _check(settings)
    if not city.is_level:
        raise InputError(
            "Sionna RT is given level ground only; give `propagation=union`, whose rays go over "
            "relief, or `above_sea=True` with an altitude above sea level"
        )
    transmitters = check_transmitters(city, transmitters_m)
    altitudes = check_altitudes(altitudes_m)
    rt = load_backend()
    check_release()
    # Single precision: coordinates must be small, so the scene is centred on the map.
    west, south, east, north = city.grid.bounds_m
    origin = np.array([(west + east) / 2, (south + north) / 2, 0.0])
    with _threads(threads):
        power = np.empty((len(transmitters), len(altitudes), *city.grid.shape), dtype=np.float32)
        for j, altitude in enumerate(altitudes):
            scene = _scene(rt, city, float(altitude), transmitters, origin, settings)
            for first in range(0, len(transmitters), transmitters_per_call):
                part = slice(first, first + transmitters_per_call)
                _place(rt, scene, transmitters[part] - origin)
                power[part, j] = _solve(
                    rt, scene, city, float(altitude), settings, _call_seed(seed, first, j)
                )
    gain, guarded = _guarded(power, city, transmitters, altitudes, settings.frequency_hz)
    return RayTraced(
        gain, power > 0, guarded, settings, importlib.metadata.version("sionna-rt"), _variant()
    )


def load_backend() -> ModuleType:
    """Import `sionna.rt` on the fastest backend there is: a CUDA graphics card, else the processor
    through LLVM.

    A Mitsuba variant that the caller has set is kept if Sionna RT can use it.

    Raises:
        InputError: Sionna RT is not installed, or no backend works; the message names the remedy.
    """
    if "drjit" not in sys.modules:
        llvm.activate()  # Dr.Jit reads the location of LLVM when it is imported
    mitsuba = require("mitsuba", "raytrace")
    drjit = require("drjit", "raytrace")
    if mitsuba.variant() not in _VARIANTS:
        cuda = drjit.has_backend(drjit.JitBackend.CUDA)
        try:
            mitsuba.set_variant(_VARIANTS[0] if cuda else _VARIANTS[1])
        except ImportError as error:
            raise InputError(
                f"ray tracing needs an LLVM library of release {llvm.OLDEST_LLVM} or newer and "
                f"found none; {llvm.llvm_remedy()}"
            ) from error
    if mitsuba.variant().startswith("llvm"):
        llvm.check_loaded(importlib.import_module("drjit.detail").llvm_version())
    return require("sionna.rt", "raytrace")


def check_release() -> str:
    """The installed release of Sionna RT, if its diffraction is right.

    Releases before 2.1.0 passed the wave number where the reflection coefficients of a wedge expect
    the wavelength, which all but removed the reflected part of the diffracted field, and weighted
    diffraction too low when several transmitters shared a call. The release number decides;
    `skygain doctor` also measures it (see `skygain.app.doctor`).

    Raises:
        InputError: the release is older.
    """
    try:
        release = importlib.metadata.version("sionna-rt")
    except importlib.metadata.PackageNotFoundError:
        require("sionna.rt", "raytrace")
        raise
    numbers = tuple(int(part) for part in release.split(".")[:3] if part.isdigit())
    if numbers < FIRST_GOOD_RELEASE:
        wanted = ".".join(map(str, FIRST_GOOD_RELEASE))
        raise InputError(
            f"sionna-rt {release} computes diffraction wrongly (fixed in {wanted}); install it "
            f"with: pip install 'sionna-rt>={wanted}'"
        )
    return release


def _check(settings: RayTracing) -> None:
    for name, least in (
        ("samples", 1),
        ("seed", 0),
        ("max_reflections", 0),
        ("threads", 1),
        ("transmitters_per_call", 1),
    ):
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise InputError(f"{name} must be a whole number of at least {least}, got {value!r}")
    if not 1e9 <= settings.frequency_hz <= 100e9:
        raise InputError(
            "ray tracing covers 1 to 100 GHz (the range of ITU concrete), got "
            f"{settings.frequency_hz / 1e9:g} GHz"
        )


def _variant() -> str:
    return str(require("mitsuba", "raytrace").variant())


@contextmanager
def _threads(count: int) -> Iterator[None]:
    drjit = require("drjit", "raytrace")
    before = drjit.thread_count()
    drjit.set_thread_count(count)
    try:
        yield
    finally:
        drjit.set_thread_count(before)


def _scene(
    rt: ModuleType,
    city: City,
    altitude_m: float,
    transmitters: NDArray[np.float64],
    origin: NDArray[np.float64],
    settings: RayTracing,
) -> Any:
    scene = rt.load_scene()
    scene.frequency = settings.frequency_hz
    scene.tx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    beyond = np.abs(transmitters[:, :2] - origin[:2]).max()
    buildings = clear_of_plane(city_buildings(city), altitude_m, _clearance_m(city))
    walls = Mesh.joined(prism_mesh(b) for b in buildings)
    parts = [
        ("ground", ground_mesh(city, GROUND_MARGIN_M + beyond), 1.0),
        ("buildings", walls, 0.3),
    ]
    scene.add(
        [
            scene_object(rt, mesh, name, origin, thickness)
            for name, mesh, thickness in parts
            if len(mesh.faces)
        ]
    )
    return scene


def _clearance_m(city: City) -> float:
    """How far roofs must stay away from the plane of the cells.

    The solver starts a diffracted ray beside its edge, displaced by 6e-6 (1 + largest coordinate),
    and aims it at a point one metre away, but weights it for the undisplaced direction. Over the
    width of the map the error of direction grows to this height.
    """
    west, south, east, north = city.grid.bounds_m
    half = max(east - west, north - south) / 2
    return min(
        6e-6 * math.sqrt(0.5) * (1 + half) * math.hypot(east - west, north - south),
        LARGEST_CLEARANCE_M,
    )


def scene_object(
    rt: ModuleType, mesh: Mesh, name: str, origin_m: NDArray[np.float64], thickness_m: float
) -> Any:
    """A ``sionna.rt.SceneObject`` of ITU concrete from a mesh, moved so that ``origin_m`` becomes
    (0, 0, 0).

    Args:
        rt: what `load_backend` returned.
        mesh: its triangles.
        name: name of the object in the scene.
        origin_m: (x, y, z).
        thickness_m: thickness of the slab in the reflection coefficient.
    """
    mitsuba = require("mitsuba", "raytrace")
    properties = mitsuba.Properties()
    properties["face_normals"] = True
    shape = mitsuba.Mesh(name, len(mesh.vertices_m), len(mesh.faces), props=properties)
    values = mitsuba.traverse(shape)
    values["vertex_positions"] = mitsuba.Float(
        (mesh.vertices_m - origin_m).astype(np.float32).ravel()
    )
    values["faces"] = mitsuba.UInt32(mesh.faces.astype(np.uint32).ravel())
    values.update()
    concrete = rt.ITURadioMaterial(f"{name}-concrete", "concrete", thickness=thickness_m)
    return rt.SceneObject(mi_mesh=shape, name=name, radio_material=concrete)


def _place(rt: Any, scene: Any, positions: NDArray[np.float64]) -> None:
    mitsuba = require("mitsuba", "raytrace")
    scene.remove(list(scene.transmitters))
    for number, position in enumerate(positions):
        scene.add(
            rt.Transmitter(f"transmitter-{number}", position=mitsuba.Point3f(*map(float, position)))
        )


def _call_seed(seed: int, transmitter: int, altitude: int) -> int:
    """Every solver call gets a seed of its own, so that the noise of two maps is independent."""
    return int(np.random.SeedSequence([seed, transmitter, altitude]).generate_state(1)[0] >> 1)


def _solve(
    rt: Any, scene: Any, city: City, altitude_m: float, settings: RayTracing, seed: int
) -> NDArray[np.float32]:
    """Mean power of every cell, ``[transmitter, row, col]``, linear."""
    mitsuba = require("mitsuba", "raytrace")
    rows, cols = city.grid.shape
    spacing = city.grid.spacing_m
    radio_map = rt.RadioMapSolver()(
        scene,
        center=mitsuba.Point3f(0.0, 0.0, altitude_m),
        orientation=mitsuba.Point3f(0.0, 0.0, 0.0),
        size=mitsuba.Point2f(cols * spacing, rows * spacing),
        cell_size=mitsuba.Point2f(spacing, spacing),
        samples_per_tx=int(settings.samples),
        max_depth=int(settings.max_reflections),
        los=True,
        specular_reflection=settings.max_reflections > 0,
        diffuse_reflection=False,
        refraction=False,
        diffraction=settings.diffraction,
        edge_diffraction=False,
        diffraction_lit_region=True,
        seed=seed,
    )
    return np.asarray(radio_map.path_gain.numpy(), dtype=np.float32)


def _guarded(
    power: NDArray[np.float32],
    city: City,
    transmitters: NDArray[np.float64],
    altitudes: NDArray[np.float64],
    frequency_hz: float,
) -> tuple[NDArray[np.float32], int]:
    """Gain in dB with the guard applied, and how many outdoor cells it touched."""
    y, x = np.meshgrid(city.grid.y_m, city.grid.x_m, indexing="ij")
    across = np.hypot(x - transmitters[:, 0, None, None], y - transmitters[:, 1, None, None])[
        :, None
    ]  # [transmitter, 1, row, col]
    up = altitudes[None, :, None, None] - transmitters[:, 2, None, None, None]
    # In the transmitter's own cell the mean over the cell is below the value at the nearest point,
    # so that is a safe bound.
    bound = free_space_gain_db(np.maximum(np.hypot(across, up), 1e-2), frequency_hz) + GUARD_DB
    outdoor = ~np.stack([city.obstructed(float(a)) for a in altitudes])
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = 10 * np.log10(np.maximum(np.nan_to_num(power, nan=0.0), 0.0))
    over = gain > bound
    return np.where(over, bound, gain).astype(np.float32), int((over & outdoor).sum())
