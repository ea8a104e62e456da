"""A signal is heard wherever it meets the program."""

from __future__ import annotations

import os
import signal
import time

import pytest

from skygain.app.signals import Terminated, told_of_signals

ENDS = {signal.SIGTERM: Terminated, signal.SIGHUP: Terminated, signal.SIGINT: KeyboardInterrupt}


class EndingSlowly:
    """Gets a signal where Python ignores what is raised."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __del__(self) -> None:
        os.kill(os.getpid(), self.number)
        for _ in range(100):
            time.sleep(0.001)


@pytest.mark.skipif(os.name != "posix", reason="this system has no such signals")
@pytest.mark.parametrize("number", ENDS)
def test_a_signal_during_a_finaliser_still_ends_the_work(
    number: signal.Signals, capfd: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(number)
    if number == signal.SIGINT:  # a job in the background begins with it ignored
        signal.signal(number, signal.default_int_handler)
    try:
        with pytest.raises(ENDS[number]), told_of_signals(lambda: "stopping", "kept"):  # noqa: PT012
            EndingSlowly(number)
            time.sleep(10)
    finally:
        signal.signal(number, before)
    told = capfd.readouterr().err.split("\n")
    assert [line for line in told if line] == ["stopping" if number == signal.SIGINT else "kept"]
