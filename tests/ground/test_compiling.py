"""Compiling is told and is no part of a measured time."""

from __future__ import annotations

import time

from numba import njit

from skygain.ground.compiling import Stopwatch, on_compiling


def test_the_first_call_of_a_kernel_costs_what_later_ones_cost() -> None:
    @njit
    def total(n: int) -> float:
        found = 0.0
        for k in range(n):
            found += k**0.5
        return found

    told: list[bool] = []
    began, watch = time.perf_counter(), Stopwatch()
    with on_compiling(told.append):
        total(10)
    assert watch.seconds < 0.5 * (time.perf_counter() - began)
    assert told[0] is True
    assert told[-1] is False
    assert told.count(True) == told.count(False)
    told.clear()
    with on_compiling(told.append):
        total(20)
    assert not told


def test_other_work_counts_in_full() -> None:
    began, watch = time.perf_counter(), Stopwatch()
    sum(k * k for k in range(200_000))
    passed = time.perf_counter() - began
    assert 0.5 * passed <= watch.seconds <= 2 * passed + 1e-3
