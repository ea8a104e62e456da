"""The operator's inputs are facts of geometry."""

import numpy as np

from skygain.networks.operator.features import CHANNELS, PROFILE_CHANNELS, operator_inputs


def channel(inputs, name):
    return inputs[:, CHANNELS.index(name)]


def test_open_ground_is_in_sight_everywhere():
    inputs = operator_inputs(
        np.zeros((20, 30), np.float32), 4.0, np.array([[3.3, 12.7, 1.5]]), 10.0
    )
    assert (channel(inputs, "line_of_sight") == 1).all()
    assert (channel(inputs, "blocked_share") == 0).all()
    assert (channel(inputs, "outside") == 0).all()


def test_distance_is_the_slant_range():
    inputs = operator_inputs(
        np.zeros((20, 30), np.float32), 4.0, np.array([[3.0, 12.0, 1.5]]), 10.0
    )
    assert np.isclose(10 ** (channel(inputs, "log_distance")[0, 8, 12] + 2), np.hypot(20.0, 8.5))


def test_a_wall_casts_a_shadow_that_ends_where_the_ray_over_its_top_comes_down():
    height = np.zeros((5, 60), np.float32)
    height[:, 10] = 12.0
    inputs = operator_inputs(height, 4.0, np.array([[2.0, 0.0, 1.5]]), 30.0)
    sight = channel(inputs, "line_of_sight")[0, 2]
    # The line to column c clears the wall, whose far edge is at 10.5 cells, where 1.5 + 28.5·10/c >
    # 12, that is c < 27.
    assert sight[:10].all()
    assert sight[12:25].all()
    assert not sight[30:].any()
    assert (channel(inputs, "buildings_crossed")[0, 2, 30:] > 0).all()


def test_turning_the_city_turns_the_inputs(rng):
    height = (30 * (rng.random((16, 16)) < 0.3)).astype(np.float32)
    plain = operator_inputs(height, 4.0, np.array([[4.2, 9.1, 1.5]]), 10.0)[0]
    turned = operator_inputs(height.T, 4.0, np.array([[9.1, 4.2, 1.5]]), 10.0)[0]
    expected = plain.transpose(0, 2, 1).copy()
    r, c = CHANNELS.index("direction_row"), CHANNELS.index("direction_col")
    expected[[r, c]] = expected[[c, r]]
    assert np.allclose(turned, expected, atol=1e-5)


def test_ground_off_the_map_is_counted_as_such():
    inputs = operator_inputs(
        np.zeros((10, 10), np.float32), 4.0, np.array([[5.0, -20.0, 1.5]]), 10.0
    )
    outside = channel(inputs, "outside")[0, 5]
    assert np.all(np.diff(outside) < 0)
    assert outside[0] > 0.9
    assert outside[-1] < 0.75


def test_without_profile_the_heights_along_the_path_do_not_enter(rng):
    height = (30 * (rng.random((16, 16)) < 0.3)).astype(np.float32)
    inputs = operator_inputs(height, 4.0, np.array([[4.0, 9.0, 1.5]]), 10.0, profile=False)
    for name in PROFILE_CHANNELS:
        assert (channel(inputs, name) == 0).all()


def test_several_transmitters_at_once_are_the_same_as_one_by_one(rng):
    height = (30 * (rng.random((12, 14)) < 0.3)).astype(np.float32)
    transmitters = np.array([[4.0, 9.0, 1.5], [-7.0, 3.0, 1.5], [11.0, 0.0, 1.5]])
    together = operator_inputs(height, 4.0, transmitters, 20.0)
    assert all(
        np.array_equal(together[k], operator_inputs(height, 4.0, transmitters[k : k + 1], 20.0)[0])
        for k in range(3)
    )
