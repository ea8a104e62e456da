"""A recording can be flown over: readings only where recorded, and every recorded cell within reach
of the others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from skygain.city import City
from skygain.flight.ways import steps_between
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments import (
    GriddedRecording,
    Recording,
    ReplayInstrument,
    on_grid,
    replay_scenario,
    replay_truth,
)
from skygain.instruments.replay import _links
from skygain.testing import check_instrument

GRID = Grid((30, 40), 4.0, (2.0, 2.0))


def recording_at(cells, grid: Grid = GRID) -> GriddedRecording:
    cells = np.asarray(cells)
    level = -80.0 - np.arange(len(cells))
    return on_grid(
        Recording(
            level, "gain", "walk.csv", xy_m=grid.xy_m(cells), noise_std_db=np.full(len(cells), 1.5)
        ),
        grid,
    )


def streets(seed: int, n: int = 60) -> GriddedRecording:
    rng = np.random.default_rng(seed)
    return recording_at(np.unique(rng.integers((0, 0), GRID.shape, size=(n, 2)), axis=0))


def test_replay_keeps_the_contract():
    gridded = streets(0)
    check_instrument(lambda rng: ReplayInstrument(gridded), GRID.shape)


def test_answers_only_where_something_was_recorded():
    gridded = recording_at([[3, 4], [3, 5], [10, 20]])
    found = ReplayInstrument(gridded).measure([[3, 5], [9, 9], [10, 20]], uav=[7, 8, 9], time_s=4.0)
    assert found.cell.tolist() == [[3, 5], [10, 20]]
    assert found.gain_db.tolist() == [-81.0, -82.0]
    assert found.noise_std_db.tolist() == [1.5, 1.5]
    assert found.uav.tolist() == [7, 9]
    assert found.time_s.tolist() == [4.0, 4.0]


def test_truth_is_the_recording_and_nothing_else():
    gridded = streets(1)
    truth = replay_truth(gridded)
    np.testing.assert_array_equal(
        np.isfinite(truth), ReplayInstrument(gridded).available(GRID.shape)
    )
    np.testing.assert_array_equal(truth[gridded.cell[:, 0], gridded.cell[:, 1]], gridded.level_db)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(1, 40),
    reach_m=st.sampled_from([0.0, 4.0, 8.0, 30.0, None]),
)
def test_on_open_ground_every_recorded_cell_can_be_flown_to(seed, n, reach_m):
    gridded = streets(seed, n)
    scenario = replay_scenario(gridded, reach_m=reach_m)
    ways = steps_between(scenario.flyable, gridded.cell[0])
    assert (ways[gridded.recorded] >= 0).all()
    assert (ways[scenario.flyable] >= 0).all()  # one region
    if reach_m is None:
        assert scenario.flyable.all()


def test_uavs_stay_near_the_recording():
    line = [[15, col] for col in range(5, 35)]
    flyable = replay_scenario(recording_at(line), reach_m=8.0).flyable
    assert flyable[13:18, 5:35].all()
    assert not flyable[:13].any()
    assert not flyable[18:].any()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(2, 9))
def test_corridors_are_a_minimum_spanning_tree(seed, n):
    # Against the brute force: all pairwise flights by steps_between, and Prim's tree over them.
    rng = np.random.default_rng(seed)
    free = rng.random((14, 16)) < 0.75
    parts, n_free = label(free)
    free = parts == np.bincount(parts.ravel(), minlength=n_free + 1)[1:].argmax() + 1
    near = np.zeros_like(free)
    cells = np.argwhere(free)
    chosen = cells[rng.choice(len(cells), min(n, len(cells)), replace=False)]
    near[tuple(chosen.T)] = True
    groups, n_groups = label(near)
    gap = np.full((n_groups, n_groups), np.inf)
    for cell in chosen:
        steps = steps_between(free, cell)
        for j in range(n_groups):
            i = groups[tuple(cell)] - 1
            gap[i, j] = min(gap[i, j], steps[groups == j + 1].min())
    inside, total = {0}, 0.0
    while len(inside) < n_groups:
        length, nearest = min((gap[i, j], j) for i in inside for j in set(range(n_groups)) - inside)
        inside.add(nearest)
        total += length - 1  # a way of k moves has k - 1 cells between its ends
    ways = _links(near, free)
    assert not (ways & ~free).any()
    assert label(ways | near)[1] == 1
    assert (ways & ~near).sum() <= total  # ways may share cells, never exceed the tree


def test_corridors_go_around_buildings_and_cut_off_parts_are_left_out():
    height = np.zeros(GRID.shape, dtype=np.float32)
    height[:, 20] = 30.0
    height[25, 20] = 0.0  # one gap in the wall
    height[0:7, 30:37] = 30.0
    height[1:6, 31:36] = 0.0  # a courtyard without a gate
    gridded = recording_at([[5, 10], [5, 11], [5, 25], [3, 33]])
    scenario = replay_scenario(gridded, City(GRID, height), reach_m=4.0)
    ways = steps_between(scenario.flyable, [5, 10])
    assert ways[5, 25] > 0
    assert scenario.flyable[25, 20]
    assert not scenario.flyable[3, 33]
    assert np.isfinite(replay_truth(gridded)[3, 33])  # it still counts in the error


def test_two_uavs_can_pass_in_a_corridor():
    flyable = replay_scenario(recording_at([[15, 5], [15, 35]]), reach_m=0.0).flyable
    assert (flyable[:, 10:30].sum(axis=0) >= 3).all()


def test_scenario_carries_what_is_known():
    scenario = replay_scenario(
        streets(2), uav_altitude_m=1.5, transmitter_m=(10.0, 20.0, 30.0), frequency_hz=3.6e9
    )
    assert scenario.transmitter_m == (10.0, 20.0, 30.0)
    assert (scenario.uav_altitude_m, scenario.prediction_altitude_m, scenario.frequency_hz) == (
        1.5,
        1.5,
        3.6e9,
    )
    assert scenario.city.name == "walk"


def test_unusable_settings():
    gridded = recording_at([[3, 4]])
    with pytest.raises(InputError, match="another grid"):
        replay_scenario(gridded, City(Grid((30, 40), 4.0), np.zeros((30, 40), dtype=np.float32)))
    with pytest.raises(InputError, match="inside a building"):
        replay_scenario(gridded, City(GRID, np.where(gridded.recorded, 50, 0).astype(np.float32)))
    with pytest.raises(InputError, match="reach_m"):
        replay_scenario(gridded, reach_m=-1.0)
    with pytest.raises(InputError, match="must agree"):
        ReplayInstrument(gridded).available((3, 3))
