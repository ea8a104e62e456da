"""Scenes of Sionna RT: those that come with it (Munich, Paris around the Etoile, Florence, San
Francisco and a street canyon) and a ``scene.xml`` of one's own.

The height map is found by casting a ray straight down through every cell's centre: the first thing
it meets is the roof (or the street), and a second ray that sees the ground alone says how high the
street lies there. Their difference is the height above the local ground, so a city on hills keeps
only its buildings. The city stays in the scene's own metres, without a CRS, and its name is
``"scene:<name>"``, so that a ray tracer can take the original mesh of `load_scene` instead of boxes
made from the raster.
"""

from __future__ import annotations

__all__ = [
    "SCENES",
    "TOWNS",
    "load_scene",
    "read_scene",
    "scene_city",
    "scene_heights",
    "scene_part",
]

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.cities.reading import CityOptions, Reading, city_name, existing_file
from skygain.city import City
from skygain.frames import Bounds, box_in_metres, grid_over
from skygain.grid import Grid, random_corner
from skygain.ground.errors import InputError, require

SCENES = {
    "munich": "ground",
    "etoile": "Plane",
    "florence": "ground",
    "san_francisco": "Terrain",
    "simple_street_canyon": "floor",
    "simple_street_canyon_with_cars": "floor",
}
"""scenes that are cities, and which object of each is the ground"""

TOWNS = ("munich", "etoile", "florence", "san_francisco")
"""those that are large enough to take parts from"""

_STREAM = 1867
"""parts are drawn from this stream of random numbers and their seed"""
_BUILT_SHARE = (0.15, 0.6)
"""least and most of a part that is built up, so that it is neither a park nor one block"""
_NOTHING_M = 0.1
"""what rises less above the ground is ground: the seams of the mesh"""


_GROUND_NAMES = ("ground", "terrain", "plane", "floor", "street", "road")


def read_scene(spec: str, options: CityOptions | None = None) -> Reading:
    """The city of a scene: one of `SCENES`, or the path of a ``scene.xml``.

    Raises:
        InputError: there is no such scene, it cannot be read, an option does not apply, or the ray
            tracer cannot be used here.
    """
    options = options or CityOptions()
    options.refuse(spec, "crs", "layer", "default_height_m", "height_field", "terrain", "skip_bad")
    spacing_m = 4.0 if options.spacing_m is None else options.spacing_m
    if spec.removeprefix("scene:") in SCENES:
        return Reading(scene_city(spec, spacing_m=spacing_m, box=options.box))
    path = existing_file(spec)
    try:
        return _own_scene(path, spacing_m, options.box)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error


def _own_scene(path: Path, spacing_m: float, box: Bounds | None) -> Reading:
    scene = _loaded(path)
    if not scene.objects:
        raise InputError(
            "the scene has no objects; expected a Mitsuba scene whose meshes (.ply) lie beside it"
        )
    areas = {name: _area(thing.mi_mesh) for name, thing in scene.objects.items()}
    named = [name for name in areas if any(word in name.lower() for word in _GROUND_NAMES)]
    ground = max(named or areas, key=lambda name: areas[name])
    city, remarks = _city_of(scene, ground, spacing_m, box, city_name(path), True), []
    how = "named so" if named else "the widest, for none is named ground, terrain or floor"
    remarks.append(f"the object {ground!r} is taken as the ground ({how})")
    if not city.height_m.any():
        remarks.append("nothing rises above the ground: every cell is open ground")
    return Reading(city, {"objects": len(areas)}, tuple(remarks))


def _loaded(path: Path) -> Any:
    from skygain.ground.llvm import activate

    activate()
    rt = require("sionna.rt", "raytrace")
    try:
        return rt.load_scene(str(path), merge_shapes=False)
    # Mitsuba answers foreign bytes with several kinds of error; each says the file is unusable
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"not readable as a scene of Sionna RT ({reason}); export it again from Blender with "
            "the Mitsuba add-on, meshes beside the .xml"
        ) from error


def _area(mesh: Any) -> float:
    low, high = _corners(mesh)
    return float((high[0] - low[0]) * (high[1] - low[1]))


def load_scene(name: str, *, merge_shapes: bool = True) -> Any:
    """The scene as a ``sionna.rt.Scene``, with its own mesh and materials.

    Args:
        name: one of `SCENES`, or the name of a city made from one (``"scene:munich"``).
        merge_shapes: whether objects of one material become one, which traces faster; their names
            are lost.

    Raises:
        InputError: there is no such scene, or the ray tracer cannot be used here.
    """
    name = _known(name)
    from skygain.ground.llvm import activate

    activate()
    rt = require("sionna.rt", "raytrace")
    return rt.load_scene(getattr(rt.scene, name), merge_shapes=merge_shapes)


def scene_city(name: str, *, spacing_m: float = 4.0, box: Bounds | None = None) -> City:
    """The city of one of Sionna RT's scenes.

    Args:
        name: one of `SCENES`.
        spacing_m: side of a cell.
        box: (west, south, east, north) of the part wanted, in the scene's metres; the whole ground
            when left out.

    Raises:
        InputError: there is no such scene, the box misses it, or the map would be too large.
    """
    name = _known(name)
    scene = load_scene(name, merge_shapes=False)
    return _city_of(scene, SCENES[name], spacing_m, box, f"scene:{name}")


def scene_part(name: str, seed: int, *, side: int = 121, spacing_m: float = 4.0) -> City:
    """A random square of one of `TOWNS`, which begins a frame of its own.

    Args:
        name: one of `TOWNS`.
        seed: the same seed gives the same square.
        side: cells along a side.
        spacing_m: side of a cell.

    Raises:
        InputError: there is no such scene, it is smaller, or the ray tracer cannot be used here.
    """
    whole, rng = _whole(_known(name), spacing_m), np.random.default_rng([_STREAM, seed])
    while True:
        row, col = random_corner(whole.grid.shape, (side, side), rng)
        part = whole.cropped(row, col, (side, side), rebase=True)
        if _BUILT_SHARE[0] <= (part.height_m > 0).mean() <= _BUILT_SHARE[1]:
            return replace(part, name=f"{name}-{seed}")


@lru_cache(maxsize=len(TOWNS))
def _whole(name: str, spacing_m: float) -> City:
    return scene_city(name, spacing_m=spacing_m)


def _city_of(
    scene: Any,
    ground_name: str,
    spacing_m: float,
    box: Bounds | None,
    name: str,
    keep_ground: bool = False,
) -> City:
    low, high = _corners(scene.objects[ground_name].mi_mesh)
    whole: Bounds = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    bounds = whole if box is None else box_in_metres(box, None)
    if (
        bounds[0] >= whole[2]
        or bounds[2] <= whole[0]
        or bounds[1] >= whole[3]
        or bounds[3] <= whole[1]
    ):
        shown = ", ".join(f"{v:.0f}" for v in whole)
        raise InputError(
            f"the box {box} misses the scene {name!r}, which covers [{shown}] m; choose a `box` "
            "inside it"
        )
    grid = grid_over(bounds, spacing_m, None)
    top, ground = scene_heights(scene, grid, ground=ground_name)
    height = np.where(top - ground < _NOTHING_M, 0.0, top - ground).astype(np.float32)
    city = City(grid=grid, height_m=height, name=name)
    return replace(city, ground_m=ground.astype(np.float32)) if keep_ground else city


def scene_heights(
    scene: Any, grid: Grid, *, ground: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Surface and ground of a scene under each cell's centre.

    Args:
        scene: a ``sionna.rt.Scene`` loaded with ``merge_shapes=False``.
        grid: in the scene's metres.
        ground: name of the object that is the ground.

    Returns:
        ``[row, col]`` the highest z of anything, and ``[row, col]`` the z of the ground. Beyond the
        edge of the ground it is continued at its lowest, and where there is nothing at all, both
        are that.
    """
    mi = require("mitsuba", "raytrace")
    mesh = scene.objects[ground].mi_mesh
    floor = float(_corners(mesh)[0][2])
    ceiling = float(_corners(scene.mi_scene)[1][2]) + 1.0
    street = _first_hit(mi.load_dict({"type": "scene", "ground": mesh}), grid, ceiling)
    street = np.where(np.isfinite(street), street, floor)
    surface = _first_hit(scene.mi_scene, grid, ceiling)
    return np.where(np.isfinite(surface), np.maximum(surface, street), street), street


def _first_hit(mi_scene: Any, grid: Grid, ceiling_m: float) -> NDArray[np.float64]:
    """``[row, col]`` z where a ray from ``ceiling_m`` straight down first meets the scene, not
    finite where it does not."""
    mi = require("mitsuba", "raytrace")
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    origin = mi.Point3f(mi.Float(x.ravel()), mi.Float(y.ravel()), mi.Float(ceiling_m))
    hit = mi_scene.ray_intersect_preliminary(mi.Ray3f(origin, mi.Vector3f(0.0, 0.0, -1.0)))
    depth = np.where(np.array(hit.is_valid()), np.array(hit.t, dtype=np.float64), np.inf)
    return (ceiling_m - depth).reshape(grid.shape)


def _corners(shape: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    box = shape.bbox()
    return np.array(box.min, dtype=np.float64).ravel(), np.array(box.max, dtype=np.float64).ravel()


def _known(name: str) -> str:
    name = name.removeprefix("scene:")
    if name not in SCENES:
        raise InputError(f"there is no scene {name!r}; the scenes are {', '.join(SCENES)}")
    return name
