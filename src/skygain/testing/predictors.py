"""What every predictor promises, checked on a small made-up city."""

from __future__ import annotations

__all__ = ["check_predictor", "example_scenario"]

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skygain.city import City
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.posterior import JointPosterior, Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.scenario import Scenario

TOLERANCE_DB = 1e-3
"""how far apart two answers may lie that should be equal but for rounding"""


def example_scenario(shape: tuple[int, int] = (24, 20), *, transmitter: bool = True) -> Scenario:
    """A city of four blocks at 10 m altitude with a transmitter at the crossing of its two
    streets."""
    rows, cols = shape
    height = np.zeros(shape, dtype=np.float32)
    for row in (slice(2, rows // 2 - 1), slice(rows // 2 + 2, rows - 2)):
        for col in (slice(2, cols // 2 - 1), slice(cols // 2 + 2, cols - 2)):
            height[row, col] = 25.0
    grid = Grid(shape=shape, spacing_m=4.0)
    x, y = grid.xy_m((rows // 2, cols // 2))
    return Scenario(
        City(grid, height, name="four blocks"),
        transmitter_m=(float(x), float(y), 1.5) if transmitter else None,
    )


def _readings(scenario: Scenario, n: int, rng: np.random.Generator) -> Measurements:
    """Exact readings of a smooth field at n distinct flyable cells, fewer if the map has fewer."""
    free = np.argwhere(scenario.flyable)
    cells = free[rng.permutation(len(free))[:n]]
    x, y = scenario.grid.xy_m(cells).T
    gain = -110.0 + 12.0 * np.sin(x / 31.0) * np.cos(y / 23.0) - 0.05 * x
    return Measurements.at(
        cells, gain, uav=np.arange(len(cells)) % 3, time_s=np.arange(len(cells)) // 3
    )


def _bytes(belief: Belief) -> tuple[bytes, bytes]:
    posterior = belief.posterior()
    return posterior.mean_db.tobytes(), posterior.variance_db2.tobytes()


def _columns(measurements: Measurements) -> list[bytes]:
    return [getattr(measurements, f.name).tobytes() for f in fields(measurements)]


def _check_posterior(posterior: Any, scenario: Scenario, when: str) -> None:
    assert isinstance(posterior, Posterior), (
        f"posterior() {when} must return a skygain.posterior.Posterior, got {type(posterior)}"
    )
    for name in ("mean_db", "variance_db2"):
        values: NDArray[np.float64] = getattr(posterior, name)
        assert values.shape == scenario.grid.shape, (
            f"{name} {when} has shape {values.shape}, the map has {scenario.grid.shape}"
        )
        assert np.isfinite(values).all(), (
            f"{name} {when} is NaN or infinite at {int((~np.isfinite(values)).sum())} cells"
        )
        assert not values.flags.writeable, (
            f"{name} {when} must be read-only, so that nobody can change a belief through it"
        )
    lowest = float(posterior.variance_db2.min())
    assert lowest >= 0, f"variance_db2 {when} is negative: {lowest:g} dB²"


def _check_covariance(
    posterior: JointPosterior, scenario: Scenario, rng: np.random.Generator
) -> None:
    free = np.argwhere(scenario.outdoor)
    cells, others = rng.choice(free, 7), rng.choice(free, 5)
    cross, own = posterior.covariance(cells, others), posterior.covariance(cells)
    assert cross.shape == (7, 5), (
        f"covariance of 7 and 5 cells has shape {cross.shape}, expected (7, 5)"
    )
    scale = max(float(posterior.variance_db2.max()), 1.0)
    variance = posterior.variance_db2[cells[:, 0], cells[:, 1]]
    error = float(np.abs(np.diag(own) - variance).max())
    assert error <= 1e-6 * scale, (
        f"the diagonal of covariance differs from variance_db2 by {error:g} dB²"
    )
    assert np.abs(own - own.T).max() <= 1e-6 * scale, (
        "covariance of cells with themselves is not symmetric"
    )
    lowest = float(np.linalg.eigvalsh((own + own.T) / 2).min())
    assert lowest >= -1e-6 * scale, f"covariance has a negative eigenvalue, {lowest:g} dB²"
    assert np.abs(cross - posterior.covariance(others, cells).T).max() <= 1e-6 * scale, (
        "covariance(a, b) differs from covariance(b, a).T"
    )


def check_predictor(predictor: Predictor, scenario: Scenario | None = None, seed: int = 0) -> None:
    """Check that ``predictor`` keeps the promises of the seam; an `AssertionError` says which one
    it breaks.

    Checked are shapes, finite values, variance >= 0, read-only arrays; that beliefs and
    measurements never change, that one belief can be updated twice, that equal data in another
    order and equal calls give equal answers, that updates may be empty or repeat cells, and that
    exact readings are reproduced if ``predictor.interpolates``.

    Args:
        predictor: what to check.
        scenario: where; a small city with a known transmitter when left out. At least 12 cells must
            be flyable.
        seed: of the cells that are measured.
    """
    scenario = example_scenario() if scenario is None else scenario
    rng = np.random.default_rng(seed)
    data = _readings(scenario, 30, rng)
    n = len(data)
    assert n >= 12, f"the scenario has {n} flyable cells; the check needs at least 12"
    first, second, third = (
        data.taken(np.arange(1)),
        data.taken(np.arange(1, n - 3)),
        data.taken(np.arange(n - 3, n)),
    )
    untouched = _columns(data)

    known = ("required", "optional", "unused")
    assert predictor.transmitter in known, (
        f"predictor.transmitter must be one of {known}, got {predictor.transmitter!r}"
    )
    if predictor.transmitter != "required":
        hidden = scenario.without_transmitter()
        _check_posterior(
            predictor.begin(hidden).updated(data).posterior(), hidden, "without the transmitter"
        )

    start = predictor.begin(scenario)
    assert isinstance(start, Belief), (
        f"begin() must return a skygain.predictors.Belief, got {type(start)}"
    )
    assert start.scenario is scenario, "belief.scenario must be the scenario given to begin()"
    assert len(start.measurements) == 0, (
        f"a new belief must hold no measurements, it holds {len(start.measurements)}"
    )
    _check_posterior(start.posterior(), scenario, "before any measurement")

    one = start.updated(first)
    _check_posterior(one.posterior(), scenario, "after one measurement")
    many = one.updated(second)
    _check_posterior(many.posterior(), scenario, f"after {n - 3} measurements")
    assert len(many.measurements) == n - 3, (
        f"belief.measurements holds {len(many.measurements)} rows after {n - 3} were taken in"
    )
    assert _columns(many.measurements) == _columns(data.taken(np.arange(n - 3))), (
        "belief.measurements differs from what was taken in"
    )

    # An old belief stays as it was, and updating it again tells the same.
    before = _bytes(many)
    covariance_before = many.posterior()
    grown = many.updated(third)
    assert _bytes(many) == before, "updated() changed the posterior of the belief it was called on"
    assert len(many.measurements) == n - 3, (
        "updated() changed the measurements of the belief it was called on"
    )
    again = many.updated(third)
    assert _bytes(grown) == _bytes(again), (
        "updating one belief twice with equal measurements gave two answers"
    )
    other = many.updated(third.taken([2]))
    assert _bytes(grown) == _bytes(many.updated(third)), (
        "a belief's answer changed after another branch was taken from it"
    )
    _check_posterior(other.posterior(), scenario, "on a second branch")
    assert _columns(data) == untouched, "the predictor wrote into the measurements it was given"
    if isinstance(covariance_before, JointPosterior):
        _check_covariance(covariance_before, scenario, rng)
        _check_covariance(grown.posterior(), scenario, rng)  # type: ignore[arg-type]

    # The same calls from the start give the same bytes.
    replayed = predictor.begin(scenario).updated(first).updated(second).updated(third)
    assert _bytes(replayed) == _bytes(grown), (
        "the same calls gave different bytes; predictors must be deterministic"
    )

    # The order of readings in an update carries no information.
    order = rng.permutation(n - 3)
    shuffled = start.updated(data.taken(order)).posterior()
    straight = start.updated(data.taken(np.arange(n - 3))).posterior()
    worst = float(np.abs(shuffled.mean_db - straight.mean_db).max())
    assert worst <= TOLERANCE_DB, f"the order of equal data moved the mean by {worst:g} dB"
    worst = float(np.abs(shuffled.std_db - straight.std_db).max())
    assert worst <= TOLERANCE_DB, (
        f"the order of equal data moved the standard deviation by {worst:g} dB"
    )

    # No data, no news.
    same = many.updated(Measurements.none())
    assert _bytes(same) == before, "an empty update changed the posterior"
    assert len(same.measurements) == n - 3, "an empty update changed the number of measurements"

    # Cells may come twice, within one update and across updates, exact or noisy.
    twice = many.updated(third.extended(third)).updated(second)
    _check_posterior(twice.posterior(), scenario, "after cells were measured twice")
    worst = float(np.abs(twice.posterior().mean_db - grown.posterior().mean_db).max())
    if predictor.interpolates:
        assert worst <= TOLERANCE_DB, f"repeating exact readings moved the mean by {worst:g} dB"
    noisy = Measurements.at(third.cell, third.gain_db + 1.0, noise_std_db=2.0)
    _check_posterior(
        many.updated(noisy).updated(noisy).updated(third).posterior(),
        scenario,
        "after noisy and exact readings of a cell",
    )
    floor = Measurements.at(third.cell, third.gain_db - 5.0, noise_std_db=1.0, censored=True)
    _check_posterior(
        many.updated(floor).posterior(), scenario, "after readings at the receiver's floor"
    )

    if predictor.interpolates and scenario.uav_altitude_m == scenario.prediction_altitude_m:
        posterior, rows, cols = grown.posterior(), data.cell[:, 0], data.cell[:, 1]
        worst = float(np.abs(posterior.mean_db[rows, cols] - data.gain_db).max())
        assert worst <= 1e-6, (
            f"the mean misses exact measurements by up to {worst:g} dB; set interpolates = False "
            "if it should"
        )
        worst = float(posterior.variance_db2[rows, cols].max())
        assert worst <= 1e-6, (
            f"the variance at exactly measured cells is up to {worst:g} dB², expected 0"
        )
