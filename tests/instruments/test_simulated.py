"""Perfect and noisy receivers do to the truth what they say, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygain.ground.errors import InputError
from skygain.instruments import NoiseConfig, NoisyInstrument, PerfectInstrument
from skygain.testing import check_instrument

TRUTH = -80.0 - 0.37 * np.arange(15 * 20).reshape(15, 20)


def noisy(
    config: NoiseConfig, seed: int = 0, truth: np.ndarray = TRUTH, **options
) -> NoisyInstrument:
    return NoisyInstrument(truth, config, np.random.default_rng(seed), **options)


def everywhere(times: int = 1) -> np.ndarray:
    return np.tile(np.argwhere(np.ones(TRUTH.shape, dtype=bool)), (times, 1))


CONFIGS = [
    NoiseConfig(),
    NoiseConfig(std_db=3.0),
    NoiseConfig(
        std_db=(0.5, 4.0), quantisation_db=1.0, floor_db=-150.0, gps_std_m=5.0, loss_probability=0.3
    ),
    NoiseConfig(floor_db=-120.0),
]


@pytest.mark.parametrize("config", CONFIGS, ids=str)
def test_noisy_instrument_keeps_the_contract(config):
    check_instrument(lambda rng: NoisyInstrument(TRUTH, config, rng), TRUTH.shape, truth_db=TRUTH)


def test_perfect_instrument_keeps_the_contract_on_a_map_with_holes():
    truth = TRUTH.copy()
    truth[3:6, 4:9] = np.nan
    check_instrument(lambda rng: PerfectInstrument(truth), truth.shape, truth_db=truth)


def test_without_any_spoiling_the_noisy_instrument_is_perfect():
    cells = everywhere()
    exact, spoiled = PerfectInstrument(TRUTH).measure(cells), noisy(NoiseConfig()).measure(cells)
    np.testing.assert_array_equal(spoiled.gain_db, exact.gain_db)
    np.testing.assert_array_equal(spoiled.cell, cells)
    assert not spoiled.censored.any()


def test_reported_standard_deviation_is_that_of_the_errors():
    # The claim under test is the sum of Gaussian and quantisation variance.
    for config in (NoiseConfig(std_db=2.0), NoiseConfig(std_db=1.0, quantisation_db=2.5)):
        cells = everywhere(100)
        found = noisy(config, seed=3).measure(cells)
        error = found.gain_db - TRUTH[cells[:, 0], cells[:, 1]]
        assert abs(error.mean()) < 0.05
        assert error.std() == pytest.approx(found.noise_std_db[0], rel=0.02)


def test_errors_divided_by_their_own_standard_deviation_are_standard_normal():
    cells = everywhere(100)
    found = noisy(NoiseConfig(std_db=(0.5, 6.0)), seed=4).measure(cells)
    z = (found.gain_db - TRUTH[cells[:, 0], cells[:, 1]]) / found.noise_std_db
    assert z.std() == pytest.approx(1.0, rel=0.02)
    assert found.noise_std_db.min() < 0.6
    assert found.noise_std_db.max() > 5.9


def test_quantised_readings_lie_on_the_scale():
    found = noisy(NoiseConfig(std_db=2.0, quantisation_db=0.5)).measure(everywhere())
    np.testing.assert_array_equal(found.gain_db, np.round(found.gain_db * 2) / 2)


def test_floor_censors_what_is_heard_below_it():
    found = noisy(NoiseConfig(floor_db=-120.0)).measure(everywhere())
    truth = TRUTH.ravel()
    np.testing.assert_array_equal(found.censored, truth < -120.0)
    assert (found.gain_db[found.censored] == -120.0).all()
    np.testing.assert_array_equal(found.gain_db[~found.censored], truth[truth >= -120.0])


def test_nothing_is_reported_below_the_floor_whatever_the_scale():
    found = noisy(NoiseConfig(std_db=5.0, quantisation_db=7.0, floor_db=-121.3)).measure(
        everywhere(5)
    )
    assert (found.gain_db >= -121.3).all()
    assert (found.gain_db[found.censored] == -121.3).all()


def test_position_error_files_readings_under_nearby_flyable_cells():
    flyable = np.random.default_rng(5).random(TRUTH.shape) < 0.7
    cells = np.argwhere(flyable)
    found = noisy(NoiseConfig(gps_std_m=4.0), flyable=flyable, spacing_m=4.0).measure(cells)
    assert flyable[found.cell[:, 0], found.cell[:, 1]].all()
    moved = np.abs(found.cell - cells).max(axis=1)
    assert 0.2 < (moved > 0).mean() < 0.9
    assert moved.max() <= 5  # five standard deviations
    # The gain is still that of the cell the UAV was really in.
    np.testing.assert_array_equal(found.gain_db, TRUTH[cells[:, 0], cells[:, 1]])


def test_position_error_has_the_stated_size():
    wide = np.zeros((401, 401))
    centre = np.full((20000, 2), 200)
    found = noisy(NoiseConfig(gps_std_m=30.0), truth=wide, spacing_m=2.0).measure(centre)
    np.testing.assert_allclose(2.0 * (found.cell - 200).std(axis=0), 30.0, rtol=0.03)


def test_lost_readings_are_missing_and_the_rest_are_unchanged():
    cells = everywhere()
    uav = np.arange(len(cells))
    kept = noisy(NoiseConfig(std_db=2.0), seed=8).measure(cells, uav=uav)
    some = noisy(NoiseConfig(std_db=2.0, loss_probability=0.25), seed=8).measure(cells, uav=uav)
    assert 0.65 < len(some) / len(cells) < 0.85
    np.testing.assert_array_equal(some.gain_db, kept.gain_db[some.uav])


def test_all_readings_can_be_lost():
    assert len(noisy(NoiseConfig(loss_probability=1.0)).measure(everywhere())) == 0


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(0, 30))
def test_same_seed_same_bytes(seed, n):
    config = NoiseConfig(
        std_db=(0.0, 5.0), quantisation_db=0.25, floor_db=-140, gps_std_m=6.0, loss_probability=0.2
    )
    cells = np.random.default_rng(seed).integers((0, 0), TRUTH.shape, size=(n, 2))
    first, second = (noisy(config, seed).measure(cells, time_s=3.0) for _ in range(2))
    for name in ("cell", "gain_db", "noise_std_db", "uav", "time_s", "censored"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_the_truth_is_copied():
    truth = TRUTH.copy()
    instrument = PerfectInstrument(truth)
    truth[:] = 0
    assert instrument.measure([[0, 0]]).gain_db[0] == TRUTH[0, 0]


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ([[15, 0]], "cannot measure at \\(15, 0\\)"),
        ([[0, -1]], "cannot measure at \\(0, -1\\)"),
        ([[1, 2]], "truth at cell \\(1, 2\\) is nan"),
        ([[0.5, 1.0]], "cells to measure are integers"),
        ([0, 1], "cells to measure are integers"),
    ],
)
def test_cells_that_cannot_be_measured(cells, message):
    truth = TRUTH.copy()
    truth[1, 2] = np.nan
    for instrument in (PerfectInstrument(truth), noisy(NoiseConfig(), truth=truth)):
        with pytest.raises(InputError, match=message):
            instrument.measure(cells)


def test_other_bad_arguments():
    with pytest.raises(InputError, match="one UAV for each"):
        PerfectInstrument(TRUTH).measure([[0, 0]], uav=[1, 2])
    with pytest.raises(InputError, match="one map"):
        PerfectInstrument(TRUTH[0])
    with pytest.raises(InputError, match="must agree"):
        PerfectInstrument(TRUTH).available((3, 3))
    with pytest.raises(InputError, match="must agree"):
        noisy(NoiseConfig(), flyable=np.ones((2, 2), dtype=bool))


@pytest.mark.parametrize(
    "bad",
    [
        {"std_db": -1.0},
        {"std_db": (3.0, 1.0)},
        {"std_db": float("nan")},
        {"quantisation_db": -0.5},
        {"gps_std_m": float("inf")},
        {"floor_db": float("nan")},
        {"loss_probability": 1.5},
    ],
    ids=str,
)
def test_impossible_noise_is_refused(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        NoiseConfig(**bad)
