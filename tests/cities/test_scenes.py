"""Cities from Sionna RT's scenes: buildings where the scene has them, upright, and as high."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from skygain.cities import open_city, read_city
from skygain.cities.scenes import SCENES, load_scene, scene_city, scene_heights, scene_part
from skygain.grid import Grid
from skygain.ground.errors import InputError

if (
    find_spec("sionna") is None
):  # not imported here: Dr.Jit looks for LLVM when it is, and must be told first where it is
    pytest.skip("the extra 'raytrace' is not installed", allow_module_level=True)


def test_the_street_canyon_has_its_six_houses() -> None:
    """Every house is a box in the scene; the height map is those boxes."""
    city = scene_city("simple_street_canyon", spacing_m=1.0)
    scene = load_scene("simple_street_canyon", merge_shapes=False)
    expected = np.zeros(city.grid.shape)
    near_wall = np.zeros(city.grid.shape, dtype=bool)
    x, y = np.meshgrid(city.grid.x_m, city.grid.y_m)
    for name, house in scene.objects.items():
        if name == SCENES["simple_street_canyon"]:
            continue
        box = house.mi_mesh.bbox()
        (x0, y0, z0), (x1, y1, z1) = (np.array(corner).ravel() for corner in (box.min, box.max))
        expected[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = z1 - z0
        near_wall |= (np.minimum(abs(x - x0), abs(x - x1)) < 0.05) | (
            np.minimum(abs(y - y0), abs(y - y1)) < 0.05
        )
    np.testing.assert_allclose(city.height_m[~near_wall], expected[~near_wall], atol=0.05)
    assert len(np.unique(np.round(expected, 1))) == 4  # the ground and three heights


def test_a_scene_of_ones_own_is_read_from_its_file() -> None:
    """The file of a scene that ships gives the same roofs; its ground is found by its name."""
    import sionna.rt as rt

    ours = read_city(str(rt.scene.simple_street_canyon), spacing_m=4.0)
    np.testing.assert_array_equal(
        ours.city.height_m, scene_city("simple_street_canyon", spacing_m=4.0).height_m
    )
    assert "the object 'floor' is taken as the ground (named so)" in ours.notes
    assert ours.counts["objects"] == 7


def test_a_scene_that_is_none_is_refused(tmp_path: Path) -> None:
    for text, message in (
        ('<scene version="2.1.0"></scene>', "no objects"),
        ("<scene", "not readable as a scene"),
        ('<scene version="2.1.0"><shape type="ply" id="a"/></scene>', "not readable as a scene"),
    ):
        (tmp_path / "s.xml").write_text(text)
        with pytest.raises(InputError, match=message) as error:
            open_city(tmp_path / "s.xml")
        assert "\n" not in str(error.value)


def test_the_arch_stands_where_it_stands() -> None:
    """The Arc de Triomphe is 49.5 m high, and the Champs-Elysees leave it to the east-south-east,
    clear of buildings."""
    city = open_city("etoile", box=(-300, -250, 300, 250))
    assert (city.name, city.crs, city.buildings) == ("scene:etoile", None, ())
    arch = city.grid.cells_at([-127.0, 38.0])
    around = city.height_m[arch[0] - 5 : arch[0] + 6, arch[1] - 5 : arch[1] + 6]
    assert around.max() == pytest.approx(49.5, abs=1.0)
    along = np.array([-127.0, 38.0]) + np.linspace(60, 380, 81)[:, None] * np.array(
        [np.cos(np.radians(26)), -np.sin(np.radians(26))]
    )
    assert not city.height_m[tuple(city.grid.cells_at(along).T)].any()
    mirrored = along * (1, -1) + (
        0,
        76,
    )  # the same street to the east-north-east would cut through houses
    assert city.height_m[tuple(city.grid.cells_at(mirrored).T)].any()
    assert 0.1 < (city.height_m > 0).mean() < 0.5


def test_ground_is_continued_beyond_its_edge() -> None:
    scene = load_scene("scene:simple_street_canyon", merge_shapes=False)
    top, ground = scene_heights(scene, Grid((3, 3), 1000.0, (-1000.0, -1000.0)), ground="floor")
    np.testing.assert_allclose(ground, ground[0, 0], atol=1e-3)
    np.testing.assert_allclose(top[0], ground[0], atol=1e-3)


def test_unknown_scenes_and_boxes() -> None:
    with pytest.raises(InputError, match="munich, etoile"):
        scene_city("atlantis")
    with pytest.raises(InputError, match="misses the scene"):
        scene_city("simple_street_canyon", box=(1000, 1000, 1100, 1100))
    with pytest.raises(InputError, match="smaller `box` or a larger `spacing_m`"):
        scene_city("simple_street_canyon", spacing_m=0.01)


def test_parts_of_a_scene_differ_by_seed_alone() -> None:
    one, again, other = (scene_part("etoile", seed, side=96) for seed in (4, 4, 5))
    assert np.array_equal(one.height_m, again.height_m)
    assert not np.array_equal(one.height_m, other.height_m)
    assert one.grid == other.grid == Grid((96, 96), 4.0)
    whole = scene_city("etoile").height_m
    windows = np.lib.stride_tricks.sliding_window_view(whole, (96, 96))
    assert any((window == other.height_m).all() for row in windows for window in row)
    assert 0.15 <= (other.height_m > 0).mean() <= 0.6
