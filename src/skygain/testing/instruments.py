"""What every instrument promises, checked on any instrument: simulated, replayed, or your own."""

from __future__ import annotations

__all__ = ["check_instrument"]

from collections import Counter
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skygain.ground.errors import InputError
from skygain.instruments.base import Instrument
from skygain.measurements import Measurements

TOLERANCE_DB = 1e-9
"""how far an exact reading may lie from the truth"""


def _columns(measurements: Measurements) -> list[bytes]:
    return [getattr(measurements, f.name).tobytes() for f in fields(measurements)]


def _check_reading(
    found: Any,
    asked: NDArray[np.int64],
    uav: NDArray[np.int64],
    time_s: float,
    shape: tuple[int, int],
) -> None:
    assert isinstance(found, Measurements), (
        f"measure() must return skygain.measurements.Measurements, got {type(found)}"
    )
    assert len(found) <= len(asked), (
        f"asked at {len(asked)} cells, got {len(found)} readings; at most one each is allowed"
    )
    on_map = np.all((found.cell >= 0) & (found.cell < shape), axis=1)
    assert on_map.all(), (
        f"a reading is filed under {found.cell[~on_map][:1].tolist()}, off the map of {shape} cells"
    )
    assert np.isfinite(found.gain_db).all(), "a gain is NaN or infinite; leave such readings out"
    assert (np.isfinite(found.noise_std_db) & (found.noise_std_db >= 0)).all(), (
        "a noise standard deviation is negative or not finite"
    )
    assert (found.time_s == time_s).all(), (
        f"asked at time_s={time_s}, got readings stamped {np.unique(found.time_s).tolist()}"
    )
    extra = Counter(found.uav.tolist()) - Counter(uav.tolist())
    assert not extra, (
        f"readings name UAVs {sorted(extra)} more often than these were asked; carry the uav "
        "column through"
    )


def _check_truth(found: Measurements, truth_db: NDArray[np.float64]) -> None:
    exact = found.taken((found.noise_std_db == 0) & ~found.censored)
    error = np.abs(exact.gain_db - truth_db[exact.cell[:, 0], exact.cell[:, 1]])
    assert (error <= TOLERANCE_DB).all(), (
        f"a reading that claims no noise is {error.max():g} dB off the truth; report its noise, or "
        "read it exactly"
    )


def _available(instrument: Instrument, shape: tuple[int, int]) -> NDArray[np.bool_]:
    available = instrument.available(shape)
    assert isinstance(available, np.ndarray), (
        f"available() must return an array, got {type(available)}"
    )
    assert available.dtype == bool, f"available() must return booleans, got {available.dtype}"
    assert available.shape == shape, f"available({shape}) has shape {available.shape}"
    kept = available.copy()
    if available.flags.writeable:
        available[:] = ~available
        again = instrument.available(shape)
        assert (again == kept).all(), (
            "writing into what available() returned changed the instrument; return a copy"
        )
    return kept


def check_instrument(
    make_instrument: Callable[[np.random.Generator], Instrument],
    shape: tuple[int, int],
    *,
    truth_db: ArrayLike | None = None,
    seed: int = 0,
) -> None:
    """Raise `AssertionError` naming the first broken promise of
    `skygain.instruments.base.Instrument`.

    Args:
        make_instrument: builds the instrument with the randomness given; called several times. A
            deterministic instrument ignores its argument.
        shape: of the instrument's map.
        truth_db: ``[row, col]`` what is measured, where it is known: a reading without noise that
            is not censored must equal it at its cell.
        seed: of the cells asked for and of the instrument's randomness.

    Checked: at most one reading per cell asked, filed under cells of the map; finite gains; noise
    not negative; the UAV and time columns carried, UAVs numbered 0, 1, 2, … by default; the same
    seed gives the same bytes; arguments untouched and earlier readings not changed by later ones; a
    cell where nothing is available answers with nothing or an `InputError`; a cell off the map is
    an `InputError`; asking at no cells gives no readings.

    >>> from skygain.instruments import PerfectInstrument
    >>> truth = -np.arange(60.0, 120.0).reshape(6, 10)
    >>> check_instrument(lambda rng: PerfectInstrument(truth), truth.shape, truth_db=truth)
    """
    rng = np.random.default_rng(seed)
    first, second = (make_instrument(np.random.default_rng(seed)) for _ in range(2))
    available = _available(first, shape)
    where = np.argwhere(available)
    assert len(where), "available() has no cell at all, so there is nothing to measure"
    truth = None if truth_db is None else np.asarray(truth_db, dtype=float)
    heard = 0
    for step in range(8):
        asked = where[
            rng.integers(len(where), size=min(12, len(where)))
        ]  # with repeats, as when UAVs share a cell
        uav = rng.permutation(40)[: len(asked)]
        kept = asked.copy(), uav.copy()
        asked.flags.writeable = uav.flags.writeable = False
        found = first.measure(asked, uav=uav, time_s=2.5 * step)
        untouched = (asked == kept[0]).all() and (uav == kept[1]).all()
        assert untouched, "measure() changed the arrays it was given; work on copies"
        _check_reading(found, asked, uav, 2.5 * step, shape)
        if truth is not None:
            _check_truth(found, truth)
        before = _columns(found)
        assert _columns(second.measure(asked, uav=uav, time_s=2.5 * step)) == before, (
            "two instruments made with the same seed read differently; draw from the generator "
            "given and from nothing else"
        )
        one = first.measure([asked[0].tolist()])
        second.measure([asked[0].tolist()])  # keeps both at the same place in their random streams
        _check_reading(one, asked[:1], np.array([0]), 0.0, shape)
        assert _columns(found) == before, "measuring again changed readings handed out earlier"
        heard += len(found)
    _check_default_uavs(first, where, shape)
    assert len(first.measure(np.empty((0, 2), dtype=np.int64))) == 0, (
        "asked at no cells, the instrument returned readings"
    )
    _check_refusals(first, available, shape)
    assert heard, "available() promises readings, but 8 rounds of asking brought none"


def _check_default_uavs(
    instrument: Instrument, where: NDArray[np.int64], shape: tuple[int, int]
) -> None:
    asked = where[: min(5, len(where))]
    _check_reading(instrument.measure(asked), asked, np.arange(len(asked)), 0.0, shape)


def _check_refusals(
    instrument: Instrument, available: NDArray[np.bool_], shape: tuple[int, int]
) -> None:
    for cell in ((-1, 0), (0, shape[1]), (shape[0], 0)):
        try:
            instrument.measure([cell])
        except InputError:
            continue
        raise AssertionError(
            f"measuring at {cell}, off the map of {shape} cells, must raise InputError"
        )
    missing = np.argwhere(~available)[:3]
    for k in range(len(missing)):
        try:
            found = instrument.measure(missing[k : k + 1])
        except InputError:
            continue
        assert len(found) == 0, (
            f"available() denies cell {tuple(missing[k].tolist())}, yet measuring there gave a "
            "reading"
        )
