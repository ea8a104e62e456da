"""Legal moves are exactly those the rules allow, and an illegal path is named."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.city import City
from skygain.flight.starts import cluster_start, spread_start, start_cells
from skygain.flight.swarm import FlightRules, Swarm
from skygain.flight.ways import steps_between
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.scenario import Scenario


def scenario(
    blocked: list[tuple[int, int]] | None = None, shape: tuple[int, int] = (5, 5)
) -> Scenario:
    height = np.zeros(shape)
    for cell in blocked or []:
        height[cell] = 30.0
    return Scenario(City(Grid(shape, 4.0), height))


def test_next_cells_avoid_map_edge_buildings_and_other_uavs() -> None:
    swarm = Swarm.deployed(scenario([(1, 0)]), [(0, 0), (0, 2)], 5)
    assert swarm.next_cells(0).tolist() == [[0, 1]]
    assert swarm.next_cells(1, decided={0: (0, 1)}).tolist() == [[1, 2], [0, 3]]


def test_a_swap_is_neither_offered_nor_accepted() -> None:
    swarm = Swarm.deployed(scenario(), [(2, 2), (2, 3)], 5)
    assert [2, 2] not in swarm.next_cells(1, decided={0: (2, 3)}).tolist()
    with pytest.raises(ValueError, match="swap"):
        swarm.advanced([(2, 3), (2, 2)])


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ([(2, 3), (2, 3)], "share"),
        ([(2, 4), (2, 3)], "jumps"),
        ([(2, 2), (2, 4)], "hovers"),
        ([(1, 2), (1, 4)], None),
        ([(3, 2), (1, 4)], "building"),
    ],
)
def test_steps_are_checked(cells: list, message: str | None) -> None:
    swarm = Swarm.deployed(scenario([(3, 2)]), [(2, 2), (2, 4)], 5)
    if message is None:
        assert swarm.advanced(cells).steps_flown == 1
    else:
        with pytest.raises(ValueError, match=message):
            swarm.advanced(cells)


def test_paths_off_the_map_are_named() -> None:
    with pytest.raises(ValueError, match=r"leaves the map: expected cells within \(5, 5\)"):
        Swarm.deployed(scenario(), [(0, 0)], 5).advanced([(-1, 0)])


def test_a_spent_uav_stays_and_stops_being_an_obstacle() -> None:
    swarm = Swarm.deployed(scenario(), [(0, 0), (0, 1)], [0, 3])
    assert len(swarm.next_cells(0)) == 0
    assert [0, 0] in swarm.next_cells(1).tolist()
    assert swarm.advanced([(0, 0), (0, 0)]).steps_left.tolist() == [0, 2]


def test_hovering_is_legal_only_when_boxed_in() -> None:
    boxed = Swarm.deployed(scenario([(1, 0)]), [(0, 0), (0, 1)], 5)
    assert len(boxed.next_cells(0, decided={})) == 0
    boxed.advanced([(0, 0), (0, 2)])


def test_minimum_distance_is_kept() -> None:
    swarm = Swarm.deployed(scenario(), [(0, 0), (0, 3)], 5, FlightRules(min_distance_m=10.0))
    assert [0, 2] not in swarm.next_cells(1).tolist()
    with pytest.raises(ValueError, match=r"within 8\.\d m"):
        swarm.check([[(0, 0), (1, 0)], [(0, 3), (0, 2)]])


def test_return_to_start_never_lets_a_uav_strand(rng: np.random.Generator) -> None:
    swarm = Swarm.deployed(
        scenario([(1, 1), (1, 2)]), [(0, 0), (4, 4)], 12, FlightRules(return_to_start=True)
    )
    home = swarm.cells.copy()
    while swarm.flying.any():
        decided: dict[int, tuple[int, int]] = {}
        for uav in range(2):
            options = swarm.next_cells(uav, decided=decided)
            choice = options[rng.integers(len(options))] if len(options) else swarm.cells[uav]
            decided[uav] = tuple(choice)
        swarm = swarm.advanced([decided[0], decided[1]])
    assert np.abs(swarm.cells - home).sum() == 0


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_random_legal_steps_always_pass_the_check(seed: int, n_uavs: int) -> None:
    rng = np.random.default_rng(seed)
    height = np.where(rng.random((7, 7)) < 0.3, 30.0, 0.0)
    height[3, 3] = 0.0
    setting = Scenario(City(Grid((7, 7), 4.0), height))
    free = np.argwhere(setting.flyable)
    swarm = Swarm.deployed(
        setting, free[rng.choice(len(free), min(n_uavs, len(free)), replace=False)], 10
    )
    for _ in range(10):
        decided: dict[int, tuple[int, int]] = {}
        for uav in range(swarm.n_uavs):
            options = swarm.next_cells(uav, decided=decided)
            decided[uav] = tuple(
                options[rng.integers(len(options))] if len(options) else swarm.cells[uav]
            )
        swarm = swarm.advanced([decided[u] for u in range(swarm.n_uavs)])
    assert swarm.steps_flown == 10


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_fewest_steps_agree_with_networkx(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flyable = rng.random((8, 9)) < 0.7
    flyable[4, 4] = True
    graph = nx.grid_graph((9, 8))
    graph.remove_nodes_from([tuple(c) for c in np.argwhere(~flyable)])
    expected = np.full(flyable.shape, -1)
    for cell, steps in nx.single_source_shortest_path_length(graph, (4, 4)).items():
        expected[cell] = steps
    assert (steps_between(flyable, (4, 4)) == expected).all()


def test_cluster_starts_lie_in_one_connected_square(rng: np.random.Generator) -> None:
    setting = scenario([(r, 10) for r in range(40)], (40, 40))
    for _ in range(20):
        cells = cluster_start(setting, 5, rng)
        assert len({tuple(c) for c in cells}) == 5
        assert (np.ptp(cells, axis=0) < 10).all()
        assert (steps_between(setting.flyable, cells[0])[cells[:, 0], cells[:, 1]] >= 0).all()


def test_spread_starts_are_distinct_and_free(rng: np.random.Generator) -> None:
    setting = scenario([(0, 0)])
    cells = spread_start(setting, 24, rng)
    assert len({tuple(c) for c in cells}) == 24
    assert setting.flyable[cells[:, 0], cells[:, 1]].all()


@pytest.mark.parametrize(
    ("kind", "n", "message"),
    [
        ("cluster", 26, "fewer than"),
        ("spread", 26, "fewer than"),
        ("ring", 2, "unknown `start`"),
        ("spread", 0, "at least one"),
    ],
)
def test_impossible_starts_are_refused(
    kind: str, n: int, message: str, rng: np.random.Generator
) -> None:
    with pytest.raises(InputError, match=message):
        start_cells(kind, scenario(), n, rng)


@pytest.mark.parametrize(
    ("cells", "steps", "message"),
    [
        ([(9, 9)], 5, "off the map"),
        ([(1, 1)], 5, "inside a building"),
        ([(0, 0), (0, 0)], 5, "share"),
        ([(0, 0)], -1, "0 or more"),
        ([], 5, "at least one"),
    ],
)
def test_impossible_deployments_are_refused(cells: list, steps: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Swarm.deployed(scenario([(1, 1)]), cells, steps)


@pytest.mark.parametrize("metres", [float("nan"), float("inf"), -1.0])
def test_a_distance_that_is_none_is_refused(metres: float) -> None:
    with pytest.raises(InputError, match="min_distance_m"):
        FlightRules(min_distance_m=metres)
