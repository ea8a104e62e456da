from __future__ import annotations

import numpy as np
import pytest

from skygain.environments import make, make_single
from skygain.environments.rewards import RewardConfig
from skygain.environments.worlds import LinkWorlds
from skygain.flight.moves import MOVES
from skygain.ground.errors import InputError

pettingzoo = pytest.importorskip("pettingzoo", reason="the extra 'rl' is not installed")

WORLDS = LinkWorlds(side=40)


def small(**options):
    return make(**({"worlds": WORLDS, "predictor": "idw", "steps": 12} | options))


def test_passes_pettingzoos_contract():
    from pettingzoo.test import parallel_api_test

    parallel_api_test(small(), num_cycles=14)


def test_same_seed_same_episode():
    from pettingzoo.test import parallel_seed_test

    parallel_seed_test(small, num_cycles=20)


def test_single_view_passes_gymnasiums_contract():
    from gymnasium.utils.env_checker import check_env

    check_env(make_single(worlds=WORLDS, predictor="idw", steps=6), skip_render_check=True)


def test_observation_shows_the_swarm_and_the_mask_keeps_it_out_of_buildings():
    env = small(n_uavs=4)
    seen, infos = env.reset(seed=3)
    for agent, info in infos.items():
        planes, mask = seen[agent]["observation"], seen[agent]["action_mask"]
        assert planes[3].sum() == 4
        assert np.argwhere(planes[4]).tolist() == [list(info["cell"])]
        assert planes[1][info["cell"]] == 0  # measured
        for move, (row, col) in enumerate(np.array(info["cell"]) + MOVES):
            inside = 0 <= row < 40 and 0 <= col < 40
            assert mask[move] == (inside and planes[2][row, col] * 127.5 < 10)


def test_episode_ends_at_step_t_for_everybody_with_the_error_as_reward():
    env = small(steps=3, reward=RewardConfig(explore=0.0, error=0.5))
    env.reset(seed=1)
    for step in range(1, 4):
        _, reward, terminated, truncated, _ = env.step(dict.fromkeys(env.agents, 0))
        assert set(terminated.values()) == {step == 3}
        assert set(truncated.values()) == {False}
        assert (max(reward.values()) < 0) == (step == 3)
        assert len(set(reward.values())) == 1
    assert env.agents == []


def test_a_new_reset_goes_on_to_the_next_episode():
    env = small()
    first, _ = env.reset(seed=5)
    second, _ = env.reset()
    again, _ = env.reset(seed=5)
    assert not np.array_equal(first["uav_0"]["observation"], second["uav_0"]["observation"])
    assert np.array_equal(first["uav_0"]["observation"], again["uav_0"]["observation"])


def test_unknown_start_is_refused():
    with pytest.raises(InputError, match="mixed"):
        LinkWorlds(start="middle")
