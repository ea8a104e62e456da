"""A belief that listens to its own readings: several methods, weighed by what they foretold.

Each method takes the readings in by itself. How well it foretold those that came later
(`skygain.predictors.adaptive_votes`) gives its weight and what its variance is multiplied by; the
posterior is the mixture (`skygain.fields.joint_mixture`). A method whose map does not depend on the
readings alone, as the operator's does not, also enters a second time with that map moved and scaled
to them (`skygain.predictors.kriging.drift`). Levels may be in dBm: what a network needs to be told
is found on the way (`skygain.predictors.adaptive_level`), so a constant added to every reading is
added to the map.
"""

from __future__ import annotations

__all__ = ["AdaptiveBelief", "AdaptivePredictor"]

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skygain.fields.joint_mixture import JointMixture, mixed
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors.adaptive_level import found_level_db, raw_map
from skygain.predictors.adaptive_votes import GROWTH, Forecast, Votes
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import Readings, checked_flat, combined
from skygain.predictors.kriging.drift import DriftKriging
from skygain.predictors.kriging.survey_fit import fit_is_due
from skygain.predictors.networks.operator import OperatorBelief
from skygain.scenario import Scenario

LEVELS = ("any", "gain")
"""what may be said of the readings' level"""
SECOND_LOG_ODDS = -3.0
"""log odds of the methods that do not lead, before any reading"""
LEAST_BATCH = 6
"""readings that are taken in together at least; more come one part after the other, so that the
later ones judge what the earlier ones taught"""
LEVEL_GROWTH = 2.0
"""the level is looked for again when there are this many times as many readings"""
LEVEL_MOVE_DB = 1.0
"""and a method begun anew when it has moved by this"""
TRAINED_LEVEL_DB = -137.0
"""mean gain of the training cities"""
LEAST_WEIGHT = 1e-3
"""a method of less weight is left out of the posterior"""


@dataclass(frozen=True)
class AdaptivePredictor(Predictor):
    """``adaptive:of=operator,kriging-blind``; see the module.

    Raises:
        InputError: no method, an unknown one, or an unknown level.
    """

    of: str | tuple[Predictor, ...] = "operator,kriging-blind"
    """names of the methods, with commas between them, or predictors built already"""
    level: str = "any"
    """``"any"``: readings of any level, in dBm too, are taken alike; ``"gain"``: they are channel
    gains in dB, as networks are trained on"""
    drift: bool = True
    """whether the operator's map also enters moved and scaled to the readings"""

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise InputError(f"unknown level {self.level!r}; expected one of {', '.join(LEVELS)}")
        if not self.methods:
            raise InputError(
                "the adaptive predictor needs methods to weigh; name them in of=, e.g. "
                "of=operator,kriging-blind"
            )

    @cached_property
    def methods(self) -> tuple[Predictor, ...]:
        """What is weighed."""
        if not isinstance(self.of, str):
            return tuple(self.of)
        from skygain.predictors import create_predictor

        names = [name.strip() for name in self.of.split(",") if name.strip()]
        if "adaptive" in names:
            raise InputError("the adaptive predictor cannot weigh itself; name others in of=")
        return tuple(create_predictor(name) for name in names)

    @property
    def transmitter(self) -> Literal["required", "optional", "unused"]:  # type: ignore[override]
        """As its methods'."""
        asked = [method.transmitter for method in self.methods]
        return "required" if "required" in asked else max(asked, key=lambda a: a == "optional")

    @property
    def interpolates(self) -> bool:  # type: ignore[override]
        """As its methods do."""
        return all(method.interpolates for method in self.methods)

    def memory_bytes(self, cells: int, readings: int) -> float:
        """That of the methods, and of what each foretold."""
        held = sum(method.memory_bytes(cells, readings) for method in self.methods)
        return held + (160.0 + 4.0 * readings) * len(self.methods) * cells

    def begin(self, scenario: Scenario) -> AdaptiveBelief:
        """The beliefs of all methods before the first measurement."""
        beliefs = tuple(method.begin(scenario) for method in self.methods)
        drifts = sum(self.drift and isinstance(belief, OperatorBelief) for belief in beliefs)
        # A network that learned cities has nothing to go by on a map without a building.
        mapped, plain = scenario.city.height_m.any(), [not m.needs_gain for m in self.methods]
        leads = plain if not mapped and any(plain) else [k == 0 for k in range(len(beliefs))]
        prior = [0.0 if lead else SECOND_LOG_ODDS for lead in leads + [False] * drifts]
        nothing = np.empty(0)
        return AdaptiveBelief(
            scenario=scenario,
            measurements=Measurements.none(),
            predictor=self,
            beliefs=beliefs,
            offset_db=(0.0,) * len(beliefs),
            drifts=(None,) * drifts,
            late=(Measurements.none(),) * (len(beliefs) + drifts),
            votes=Votes.none(prior),
            readings=Readings(nothing.astype(np.int64), nothing, nothing),
            fitted_at=0,
            levelled_at=0,
        )


@dataclass(frozen=True, eq=False)
class AdaptiveBelief(Belief):
    """The beliefs of the methods, and what is thought of them."""

    scenario: Scenario
    measurements: Measurements
    predictor: AdaptivePredictor
    """settings"""
    beliefs: tuple[Belief, ...]
    """one of each method, which read ``gain − offset``"""
    offset_db: tuple[float, ...]
    """what is taken off the readings before each method reads them"""
    drifts: tuple[DriftKriging | None, ...]
    """Kriging around the map of each operator; ``None`` before the first fit"""
    late: tuple[Measurements, ...]
    """what each method, then each drift, has yet to take in: one that does not count takes its
    readings when it is asked for a forecast"""
    votes: Votes
    """of the methods, then of the drifts"""
    readings: Readings
    """all of them but those at the receiver's floor, one per cell"""
    fitted_at: int
    """readings at the last fit of the drifts"""
    levelled_at: int
    """readings when the level was last looked for"""

    def updated(self, measurements: Measurements) -> AdaptiveBelief:
        """The belief after ``measurements``. Many at once are taken in part by part, in an order
        that follows from their cells alone."""
        flat = checked_flat(self.scenario.grid, measurements)
        if not len(measurements):
            return self
        belief = self
        for part in _parts(self.scenario.grid, flat, len(self.readings)):
            belief = belief._grown(measurements.taken(part), flat[part])
        return replace(belief, measurements=self.measurements.extended(measurements))

    def posterior(self) -> JointMixture:
        return self._posterior

    @property
    def weight(self) -> NDArray[np.float64]:
        """``[method, then drift]`` weight of each, summing to 1."""
        return self.votes.weight

    @cached_property
    def _posterior(self) -> JointMixture:
        weight = self.weight
        there = [True] * len(self.beliefs) + [drift is not None for drift in self.drifts]
        kept = np.flatnonzero((weight >= LEAST_WEIGHT * weight.max()) & there)
        every = [self._posterior_of(int(k)) for k in kept]
        spacing_m = self.scenario.grid.spacing_m
        return mixed(every, weight[kept], self.votes.factor[kept], spacing_m)

    def _posterior_of(self, k: int) -> Posterior:
        """Of method ``k``, or of the drifts that follow them, at the level of the readings."""
        if k >= len(self.beliefs):
            drift = self.drifts[k - len(self.beliefs)]
            assert drift is not None
            return drift.posterior()
        posterior, offset = self.beliefs[k].posterior(), self.offset_db[k]
        return replace(posterior, mean_db=posterior.mean_db + offset) if offset else posterior

    def _grown(self, news: Measurements, flat: NDArray[np.int64]) -> AdaptiveBelief:
        """With a few readings more."""
        coming, old = _plain(news, flat), self.readings
        fresh = ~np.isin(coming.cells, old.cells[old.noise_db2 == 0])
        coming = Readings(coming.cells[fresh], coming.gain_db[fresh], coming.noise_db2[fresh])
        both = combined(
            np.append(old.cells, coming.cells),
            np.append(old.gain_db, coming.gain_db),
            np.append(old.noise_db2, coming.noise_db2),
        )
        grown = replace(
            self,
            measurements=self.measurements.extended(news),
            votes=self.votes.counted(self.scenario.grid, coming),
            readings=both,
            late=tuple(late.extended(news) for late in self.late),
        )
        return grown._levelled()._caught_up()._fitted()._foretelling()

    def _levelled(self) -> AdaptiveBelief:
        """With the level looked for, when there are enough more readings."""
        size = len(self.readings)
        if self.predictor.level == "gain" or size < LEVEL_GROWTH * self.levelled_at:
            return self
        beliefs, offsets, late = list(self.beliefs), list(self.offset_db), list(self.late)
        for k, method in enumerate(self.predictor.methods):
            if not method.needs_gain:
                continue
            level = self._level_db(beliefs[k], offsets[k])
            if self.levelled_at == 0 or abs(level - offsets[k]) > LEVEL_MOVE_DB:
                offsets[k], late[k] = level, Measurements.none()
                beliefs[k] = method.begin(self.scenario).updated(_moved(self.measurements, level))
        return replace(
            self,
            beliefs=tuple(beliefs),
            offset_db=tuple(offsets),
            late=tuple(late),
            levelled_at=size,
        )

    def _caught_up(self) -> AdaptiveBelief:
        """With the late readings taken in by every method that counts, or by all where a fit or a
        forecast is due."""
        size, n = len(self.readings), len(self.beliefs)
        wanted = self.weight >= LEAST_WEIGHT * self.weight.max()
        if fit_is_due(size, self.fitted_at) or self.votes.due(size):
            wanted[:] = True
        beliefs, drifts, late = list(self.beliefs), list(self.drifts), list(self.late)
        for k, news in enumerate(late):
            if not wanted[k] and not (k < n and isinstance(beliefs[k], OperatorBelief)):
                continue
            late[k] = Measurements.none()
            if k < n:
                beliefs[k] = beliefs[k].updated(_moved(news, self.offset_db[k]))
            elif (drift := drifts[k - n]) is not None:
                drifts[k - n] = _taken(drift, news)
        return replace(self, beliefs=tuple(beliefs), drifts=tuple(drifts), late=tuple(late))

    def _level_db(self, belief: Belief, offset_db: float) -> float:
        """What to take off the readings."""
        readings = self.readings
        if not len(readings):  # all at the receiver's floor
            floor = self.measurements
            flat = self.scenario.grid.flat(floor.cell)
            readings = combined(flat, floor.gain_db, np.zeros(len(floor)))
        if not isinstance(belief, OperatorBelief):
            return float(readings.gain_db.mean()) - TRAINED_LEVEL_DB
        middle = offset_db
        if self.levelled_at == 0:
            flown, _ = raw_map(belief, self.scenario.uav_altitude_m)
            middle = float((readings.gain_db - flown[readings.cells]).mean())
        return found_level_db(belief, readings.cells, readings.gain_db, middle)

    def _fitted(self) -> AdaptiveBelief:
        """With the drifts made anew, when there are enough more readings."""
        size = len(self.readings)
        if not self.drifts or not fit_is_due(size, self.fitted_at):
            return self
        s, found = self.scenario, []
        operators = [b for b in self.beliefs if isinstance(b, OperatorBelief)]
        for belief, drift in zip(operators, self.drifts, strict=True):
            flown = raw_map(belief, s.uav_altitude_m)
            predicted = raw_map(belief, s.prediction_altitude_m)
            readings = self.readings if drift is None else drift.readings()
            found.append(DriftKriging.around(s, flown, predicted, readings))
        return replace(self, drifts=tuple(found), fitted_at=size)

    def _foretelling(self) -> AdaptiveBelief:
        """With a new forecast, when the last one is old."""
        size = len(self.readings)
        if not size or not self.votes.due(size) or None in self.drifts:
            return self
        every = [self._posterior_of(k) for k in range(len(self.late))]
        forecast = Forecast.of(self.scenario, self.readings.cells, every)
        return replace(self, votes=self.votes.with_forecast(forecast))


def _plain(measurements: Measurements, flat: NDArray[np.int64]) -> Readings:
    """Those that are not at the receiver's floor, one per cell, in an order of their own."""
    order = np.lexsort((measurements.gain_db, flat))
    order = order[~measurements.censored[order]]
    noise_db2 = measurements.noise_std_db[order] ** 2
    return combined(flat[order], measurements.gain_db[order], noise_db2)


def _taken(drift: DriftKriging, news: Measurements) -> DriftKriging:
    """``drift`` with ``news``."""
    flat = drift.scenario.grid.flat(news.cell)
    drift = drift.updated(_plain(news, flat))
    for i in np.flatnonzero(news.censored):
        noise_db2 = float(news.noise_std_db[i] ** 2)
        drift = drift.with_floor_reading(int(flat[i]), float(news.gain_db[i]), noise_db2)
    return drift


def _moved(measurements: Measurements, offset_db: float) -> Measurements:
    if not offset_db:
        return measurements
    return replace(measurements, gain_db=measurements.gain_db - offset_db)


def _parts(grid: Grid, flat: NDArray[np.int64], known: int) -> Iterator[NDArray[np.int64]]:
    """Readings in parts, those of one cell together."""
    cells, which = np.unique(flat, return_inverse=True)
    if len(cells) <= max(LEAST_BATCH, (GROWTH - 1) * known):
        yield np.arange(len(flat))
        return
    place = np.empty(len(cells), dtype=np.int64)
    place[np.argsort(np.random.default_rng(0).permutation(grid.size)[cells])] = np.arange(
        len(cells)
    )
    done = 0
    while done < len(cells):
        size = int(max(LEAST_BATCH, (GROWTH - 1) * (known + done)))
        yield np.flatnonzero((place[which] >= done) & (place[which] < done + size))
        done += size
