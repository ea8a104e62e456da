from __future__ import annotations

import numpy as np
import pytest

from skygain.environments.rewards import RewardConfig, rewards
from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.environments.worlds import LinkWorlds
from skygain.ground.errors import InputError
from skygain.networks.policies.planes import packed_mean, packed_std
from skygain.predictors import create_predictor
from skygain.predictors.base import Predictor
from skygain.predictors.networks.network_belief import NetworkBelief

WORLDS = LinkWorlds(side=40)
IDW = create_predictor("idw")


def legal(surveys, rng):
    return np.argmax(surveys.masks() * rng.random((*surveys.masks().shape[:2], 4)), axis=-1)


def test_lanes_do_not_depend_on_each_other():
    config = EnvironmentConfig(n_uavs=2, steps=6)
    wide, narrow = (
        SurveyBatch(WORLDS, IDW, config, 3, seed=4),
        SurveyBatch(WORLDS, IDW, config, 2, seed=4),
    )
    for step in range(8):  # into the second episode
        actions = np.full((3, 2), step % 4)
        one, two = wide.step(actions), narrow.step(actions[:2])
        assert np.array_equal(one.reward[:2], two.reward)
        assert np.array_equal(wide.observations()[:2], narrow.observations())


def test_restored_lanes_go_on_alike(rng):
    config = EnvironmentConfig(n_uavs=2, steps=9, reward=RewardConfig(shaping=True))
    surveys = SurveyBatch(WORLDS, IDW, config, 2, seed=1)
    for _ in range(13):
        surveys.step(legal(surveys, rng))
    copy = SurveyBatch(WORLDS, IDW, config, 2, seed=1)
    copy.restore(surveys.lanes_state())
    for _ in range(7):
        actions = legal(surveys, rng)
        one, two = surveys.step(actions), copy.step(actions)
        assert np.array_equal(one.reward, two.reward)
        assert np.array_equal(one.returns, two.returns)
        assert np.array_equal(surveys.observations(), copy.observations())


def test_masked_moves_are_flown_as_asked_when_nobody_is_in_the_way(rng):
    surveys = SurveyBatch(WORLDS, None, EnvironmentConfig(n_uavs=1, steps=50), 2)
    moves = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    for _ in range(30):
        actions, before = legal(surveys, rng), surveys.cells.copy()
        surveys.step(actions)
        assert np.array_equal(surveys.cells, before + moves[actions])


def test_shaping_telescopes_to_the_first_error(rng):
    # Σ γ^t (γΦ(s_{t+1}) − Φ(s_t)) = −Φ(s_0) whatever is flown, because Φ is 0 at the end: the best
    # policy stays the best
    for seed in range(3):
        plain, shaped = (
            SurveyBatch(
                WORLDS,
                IDW,
                EnvironmentConfig(1, 8, RewardConfig(shaping=s, discount=0.9)),
                1,
                seed=seed,
                restart=False,
            )
            for s in (False, True)
        )
        first = 0.01 * shaped.error_db[0]
        difference = 0.0
        for t in range(8):
            actions = legal(plain, rng)
            difference += 0.9**t * float(
                (shaped.step(actions).reward - plain.step(actions).reward)[0, 0]
            )
        assert difference == pytest.approx(first, rel=1e-4)


def test_exploration_pays_for_new_cells_before_the_end_only():
    config = RewardConfig(explore=0.5, error=0.01)
    new, ended = np.array([[True, False], [True, True]]), np.array([False, True])
    got = rewards(config, new, ended, np.array([100.0, 100.0]), np.array([90.0, 80.0]))
    assert np.allclose(got, [[0.5, 0.0], [-0.8, -0.8]])


def test_packed_maps_keep_their_meaning():
    gain = np.linspace(-200, -40, 500)
    assert np.abs(packed_mean(gain) * (160 / 255) - 200 - gain).max() < 0.32
    assert packed_std(np.array([0.0, 1e-9]))[0] == 0
    assert packed_std(np.array([0.0, 1e-9]))[1] == 1


def test_network_beliefs_are_evaluated_together(rng):
    calls = []

    def network(scenarios, gain, measured):
        calls.append(len(scenarios))
        level = gain.sum(axis=(1, 2)) / measured.sum(axis=(1, 2))
        return np.broadcast_to(level[:, None, None], gain.shape).copy(), np.full(gain.shape, 100.0)

    class MeanOfReadings(Predictor):
        def begin(self, scenario):
            return NetworkBelief.begun(scenario, network)

    surveys = SurveyBatch(WORLDS, MeanOfReadings(), EnvironmentConfig(2, 5), 3)
    surveys.step(legal(surveys, rng))
    assert calls == [3, 3]  # the start and one step
    alone = [belief.posterior() for belief in surveys.beliefs]
    assert np.array_equal(surveys.mean, packed_mean([p.mean_db for p in alone]))
    assert np.array_equal(surveys.std, packed_std([p.variance_db2 for p in alone]))


def test_wrong_actions_are_refused():
    surveys = SurveyBatch(WORLDS, None, EnvironmentConfig(2, 5), 1)
    with pytest.raises(InputError, match=r"0\.\.3"):
        surveys.step(np.array([[0, 4]]))
