"""The public check accepts what keeps the contract and names what breaks it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skygain.instruments import PerfectInstrument
from skygain.measurements import Measurements
from skygain.testing import check_instrument

TRUTH = -70.0 - np.arange(8.0 * 9).reshape(8, 9)


class TwiceTheReadings(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        found = super().measure(cells, uav=uav, time_s=time_s)
        return found.extended(found)


class ForgetsTime(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        return super().measure(cells, uav=uav)


class ForgetsUavs(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        return super().measure(cells, time_s=time_s)


class ClaimsNoNoise(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        found = super().measure(cells, uav=uav, time_s=time_s)
        return replace(found, gain_db=found.gain_db + 0.5)


class HiddenRandomness(PerfectInstrument):
    def __init__(self, truth):
        super().__init__(truth)
        self.rng = np.random.default_rng()

    def measure(self, cells, *, uav=None, time_s=0.0):
        found = super().measure(cells, uav=uav, time_s=time_s)
        return replace(
            found,
            gain_db=found.gain_db + self.rng.normal(size=len(found)),
            noise_std_db=np.ones(len(found)),
        )


class ChangesItsArguments(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        if isinstance(cells, np.ndarray):
            cells.flags.writeable = True
            cells[:] = 0
        return super().measure(cells, uav=uav, time_s=time_s)


class AnswersOffTheMap(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        return super().measure(
            np.clip(cells, 0, np.array(self.truth_db.shape) - 1), uav=uav, time_s=time_s
        )


class NeverAnswers(PerfectInstrument):
    def measure(self, cells, *, uav=None, time_s=0.0):
        super().measure(cells, uav=uav, time_s=time_s)
        return Measurements.none()


class AvailableLeaksItsState(PerfectInstrument):
    def __init__(self, truth):
        super().__init__(truth)
        self.mask = np.ones(truth.shape, dtype=bool)

    def available(self, shape):
        return self.mask


class DeniesWhatItReads(PerfectInstrument):
    def available(self, shape):
        mask = np.ones(shape, dtype=bool)
        mask[0] = False
        return mask


@pytest.mark.parametrize(
    ("broken", "sentence"),
    [
        (TwiceTheReadings, "at most one"),
        (ForgetsTime, "time_s"),
        (ForgetsUavs, "uav column"),
        (ClaimsNoNoise, "claims no noise"),
        (HiddenRandomness, "same seed"),
        (ChangesItsArguments, "changed the arrays"),
        (AnswersOffTheMap, "off the map"),
        (NeverAnswers, "brought none"),
        (AvailableLeaksItsState, "return a copy"),
        (DeniesWhatItReads, "denies cell"),
    ],
)
def test_each_broken_promise_is_named(broken, sentence):
    with pytest.raises(AssertionError, match=sentence):
        check_instrument(lambda rng: broken(TRUTH), TRUTH.shape, truth_db=TRUTH)
