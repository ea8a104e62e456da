from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.city import Building, City
from skygain.grid import Grid
from skygain.propagation.mesh import (
    SINK_M,
    Mesh,
    buildings_of_raster,
    city_buildings,
    clear_of_plane,
    ground_mesh,
    prism_mesh,
)

from .conftest import box, city_of

pytest.importorskip("shapely", reason="pip install 'skygain[raytrace]'")


def volume_m3(mesh: Mesh) -> float:
    """Signed volume by the divergence theorem; right only if every triangle is wound outwards and
    nothing is missing."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def directed_edges(mesh: Mesh) -> Counter[tuple[int, int]]:
    f = mesh.faces
    return Counter(
        (int(a), int(b)) for i in range(3) for a, b in zip(f[:, i], f[:, (i + 1) % 3], strict=True)
    )


def test_a_floating_prism_with_a_courtyard_is_closed_and_has_its_volume() -> None:
    outer = np.array([[0, 0], [20, 0], [20, 10], [8, 10], [8, 16], [0, 16]], dtype=float)
    hole = np.array([[2, 2], [6, 2], [6, 6], [2, 6]], dtype=float)
    mesh = prism_mesh(Building(outer, 12.0, base_m=5.0, holes_m=(hole,)))
    edges = directed_edges(mesh)
    # Each edge is used once in each direction: closed, and consistently oriented.
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    assert volume_m3(mesh) == pytest.approx((20 * 10 + 8 * 6 - 16) * 7.0)


@pytest.mark.parametrize("reverse", [False, True])
def test_a_building_on_the_ground_is_open_below_whatever_the_order_of_its_corners(
    reverse: bool,
) -> None:
    ring = np.array([[0, 0], [10, 0], [10, 5], [0, 5]], dtype=float)
    mesh = prism_mesh(Building(ring[::-1] if reverse else ring, 20.0))
    assert mesh.vertices_m[:, 2].min() == -SINK_M
    assert mesh.area_m2 == pytest.approx(30 * (20 + SINK_M) + 50)
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    outwards = (a + b + c) / 3 - np.array([5.0, 2.5, 10.0])
    assert (np.einsum("ij,ij->i", normals, outwards) > 0).all()


def test_an_outline_that_crosses_itself_is_repaired_and_one_without_area_is_nothing() -> None:
    bow_tie = np.array([[0, 0], [10, 10], [10, 0], [0, 10]], dtype=float)
    mesh = prism_mesh(Building(bow_tie, 10.0, base_m=1.0))
    assert volume_m3(mesh) == pytest.approx(50 * 9.0)
    assert (
        len(prism_mesh(Building(np.array([[0, 0], [5, 5], [10, 10]], dtype=float), 10.0)).faces)
        == 0
    )
    assert len(prism_mesh(box(0, 0, 5, 5, height_m=3.0, base_m=3.0)).faces) == 0


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), rows=st.integers(1, 9), cols=st.integers(1, 9))
def test_the_boxes_of_a_raster_cover_each_built_cell_once_at_its_height(
    seed: int, rows: int, cols: int
) -> None:
    levels = np.random.default_rng(seed).choice([0.0, 0.2, 6.0, 6.2, 9.0], size=(rows, cols))
    grid = Grid((rows, cols), 4.0, (100.0, -50.0))
    boxes = buildings_of_raster(City(grid=grid, height_m=levels), step_m=0.5)
    seen = np.zeros((rows, cols))
    for b in boxes:
        (west, south), (east, north) = b.footprint_m.min(axis=0), b.footprint_m.max(axis=0)
        inside = (
            (grid.x_m > west)
            & (grid.x_m < east)
            & ((grid.y_m > south) & (grid.y_m < north))[:, None]
        )
        assert not seen[inside].any()
        seen[inside] = b.height_m
    assert np.array_equal(seen, np.round(levels * 2) / 2)


def test_equal_neighbours_become_one_box() -> None:
    height = np.zeros((6, 7))
    height[1:4, 2:6] = 10.0
    (only,) = buildings_of_raster(City(grid=Grid((6, 7), 2.0), height_m=height))
    assert only.footprint_m.tolist() == [[3.0, 1.0], [11.0, 1.0], [11.0, 7.0], [3.0, 7.0]]


def test_a_city_is_meshed_from_polygons_if_it_has_them_and_the_ground_reaches_beyond() -> None:
    city = city_of([box(20, 20, 40, 60, 15.0)])
    polygons, raster = (
        Mesh.joined(prism_mesh(b) for b in city_buildings(c))
        for c in (city, City(grid=city.grid, height_m=city.height_m))
    )
    assert city_buildings(city) == city.buildings
    assert polygons.area_m2 == pytest.approx(raster.area_m2)
    ground = ground_mesh(city, 100.0)
    assert ground.vertices_m.min(axis=0).tolist() == [-100, -100, 0]
    assert ground.vertices_m.max(axis=0).tolist() == [220, 220, 0]


def test_roofs_are_moved_away_from_the_plane_without_changing_what_is_indoors() -> None:
    heights = [3.0, 9.4, 9.95, 10.0, 10.3, 10.5, 25.0]
    moved = [b.height_m for b in clear_of_plane([box(0, 0, 1, 1, h) for h in heights], 10.0, 0.5)]
    assert moved == [3.0, 9.4, 9.5, 10.5, 10.5, 10.5, 25.0]
    (bridge,) = clear_of_plane([box(0, 0, 1, 1, 14.0, base_m=9.9)], 10.0, 0.5)
    assert (bridge.base_m, bridge.height_m) == (9.5, 14.0)
    assert clear_of_plane([box(0, 0, 1, 1, 0.3)], 0.2, 0.5)[0].height_m == 0.7
