from __future__ import annotations

import numpy as np
import pytest

from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.environments.worlds import LinkWorlds
from skygain.predictors import create_predictor
from skygain.training.policies.replay import Replay, ReplayConfig

STEPS = 5


@pytest.fixture
def flown(tmp_path, rng):
    """A replay of 17 joint steps of two lanes, and the same written down as plain lists."""
    surveys = SurveyBatch(
        LinkWorlds(side=32), create_predictor("idw"), EnvironmentConfig(2, STEPS), 2
    )
    replay = Replay(tmp_path, ReplayConfig(lanes=2, n_uavs=2, side=32, steps=STEPS, capacity=1000))
    diary = []
    for _ in range(17):
        moves = np.argmax(surveys.masks() * rng.random((2, 2, 4)), axis=-1)
        before = {
            "obs": surveys.observations(),
            "masks": surveys.masks(),
        }
        replay.remember(surveys, np.full((2, 2), -1))
        step = surveys.step(moves)
        replay.complete(moves, step.reward, step.ended)
        diary.append({**before, "moves": moves, "reward": step.reward, "ended": step.ended})
    return replay, diary


def test_returns_stop_at_the_end_of_the_episode(flown):
    replay, diary = flown
    batch = replay.sample(np.random.default_rng(0), 400, 3, 0.9)
    rng = np.random.default_rng(0)
    rows, lanes, uavs = (
        rng.integers(0, 14, size=400),
        rng.integers(2, size=400),
        rng.integers(2, size=400),
    )
    for i, (row, lane, uav) in enumerate(zip(rows, lanes, uavs, strict=True)):
        total, factor = 0.0, 1.0
        for m in range(3):
            total += factor * diary[row + m]["reward"][lane, uav]
            factor *= 0.9
            if diary[row + m]["ended"][lane]:
                factor = 0.0
                break
        assert batch.reward[i] == pytest.approx(total, rel=1e-5)
        assert batch.discount[i] == pytest.approx(factor, rel=1e-5)
        assert batch.move[i] == diary[row]["moves"][lane, uav]
        if factor:
            assert np.array_equal(batch.mask[i], diary[row + 3]["masks"][lane, uav])
    assert (batch.discount == 0).any()
    assert (batch.discount > 0).any()


def test_what_was_seen_comes_back(flown):
    from skygain.networks.policies.planes import planes

    replay, diary = flown
    for row in (0, 4, 5, 16):
        for lane in range(2):
            seen = replay.seen(np.full(2, lane), np.full(2, row), np.arange(2))
            again = planes(seen.mean, seen.std, seen.height, seen.cells, seen.uav)
            assert np.array_equal(again, diary[row]["obs"][lane])
            assert (seen.left == STEPS - row % STEPS).all()


def test_a_full_ring_forgets_the_oldest_and_keeps_the_guard(tmp_path):
    config = ReplayConfig(lanes=1, n_uavs=1, side=8, steps=STEPS, capacity=6, guard=4)
    surveys = SurveyBatch(LinkWorlds(side=32), None, EnvironmentConfig(1, STEPS), 1)
    config = ReplayConfig(lanes=1, n_uavs=1, side=32, steps=STEPS, capacity=6, guard=4)
    replay = Replay(tmp_path, config)
    for k in range(23):
        replay.remember(surveys, np.full((1, 1), -1))
        step = surveys.step(np.argmax(surveys.masks(), axis=-1))
        replay.complete(np.zeros((1, 1)), np.full((1, 1), float(k)), step.ended)
    assert len(replay) == 6
    rewards = replay.sample(np.random.default_rng(1), 200, 1, 1.0).reward
    assert set(rewards.tolist()) == {17.0, 18.0, 19.0, 20.0, 21.0}
    assert replay.config.slots == 10
    # a run resumed four joint steps earlier still finds all it could sample then
    resumed = Replay(tmp_path, config, written=19)
    assert set(resumed.sample(np.random.default_rng(1), 200, 1, 1.0).reward.tolist()) == {
        13.0,
        14.0,
        15.0,
        16.0,
        17.0,
    }


def test_bytes_per_transition_at_full_size():
    config = ReplayConfig(lanes=8, n_uavs=3, side=96, steps=200, capacity=60_000)
    per_joint_step = 2 * 96 * 96 + 3 * (4 + 1 + 1 + 4) + 4 + 2 + 1
    heights = config.episodes * 2 * 96 * 96 / config.slots
    assert (per_joint_step + heights) / 3 < 6300
