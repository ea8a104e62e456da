"""The propagation-operator predictor: a learned (city, transmitter) → gain map, a transmitter inferred from the survey, and Kriging on top.

Every candidate position c of the transmitter has a map m_c ± s_c from `skygain.learning.operator_net`. Measurements y reweight the
candidates,

    log w_c = log prior_c − τ [ (ν + n)/2 · log(1 + |u_c|²/ν) + Σ_i log s_c(i) ],   u_c = L⁻¹ (y − m_c)/s_c,

a Student likelihood of the correlated residual (a normal one whose overall scale is unknown), tempered by τ since the operator is
wrong in ways no stationary field describes. Squares of the candidate quadtree that gather weight are cut into finer ones. The
posterior is the mixture of the Kriging-corrected maps, summarised by its mean and its full variance, the disagreement between
candidates included. With the transmitter known there is one candidate and the same code.
"""

from __future__ import annotations

__all__ = ["OperatorBelief", "OperatorPredictor", "OperatorSettings"]

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from skygain.measurements import Measurements
from skygain.posterior import Posterior
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.operator_maps import OperatorMaps, OperatorNetwork
from skygain.predictors.readings import checked_flat, combined
from skygain.predictors.residual_field import CorrelationModel, ResidualField
from skygain.predictors.transmitter_search import Square, coarse_squares, split_square
from skygain.scenario import Scenario

KEPT_SCENARIOS = 2
"""scenarios whose candidate maps a predictor keeps, the latest ones"""
MIXTURE_SHARE = 0.998
"""candidates beyond this share of the weight are left out of the posterior"""
MIXTURE_WORK = 40_000
"""as are those for which candidates × measurements would exceed this"""


@dataclass(frozen=True)
class OperatorSettings:
    """Everything that was chosen on validation cities."""

    correlation: CorrelationModel = field(default_factory=CorrelationModel)
    """of the operator's standardised residual"""
    temper: float = 0.5
    """τ, power of the likelihood"""
    degrees: float = 10.0
    """ν, degrees of freedom of the residual's scale"""
    blur_db_per_m: float = 0.3
    """standard deviation added per metre of a candidate square's side, since its map is that of its middle"""
    margin_m: float = 102.0
    """how far outside the map a transmitter may stand"""
    coarse_m: float = 16.0
    """side of the first squares"""
    at_most: int = 900
    """largest number of first squares"""
    splits: int = 1
    """squares cut into four per update"""
    split_weight: float = 0.02
    """a lighter square is not cut"""
    vertical_m: float = 10.0
    """decay length of the residual's correlation between the measured and the predicted altitude"""
    variance_factor: float = 1.0
    """calibration of the variance"""


@dataclass(frozen=True)
class OperatorPredictor(Predictor):
    """See the module; the transmitter's position is used when the scenario gives it."""

    weights: str | Path = "operator"
    """name or file of the network's weights"""
    settings: OperatorSettings = field(default_factory=OperatorSettings)
    """inference settings"""
    transmitter: Literal["required", "optional", "unused"] = field(init=False, repr=False, default="optional")
    """used when known, inferred when not"""
    _kept: OrderedDict = field(init=False, repr=False, compare=False, default_factory=OrderedDict)

    def begin(self, scenario: Scenario) -> OperatorBelief:
        """The belief before the first measurement; evaluates all first candidates unless this city was the last one used."""
        maps = self._maps(scenario)
        settings = self.settings
        if scenario.transmitter_m is not None:
            x, y, z = scenario.transmitter_m
            spacing, (x0, y0) = scenario.grid.spacing_m, scenario.grid.origin_m
            squares: tuple[Square, ...] = (Square(0, 0, 0, ((y - y0) / spacing, (x - x0) / spacing), 1.0),)
            indices = maps.indices([(*squares[0].position, float(z))])
        else:
            squares = tuple(coarse_squares(scenario, settings.margin_m, settings.coarse_m, settings.at_most))
            indices = maps.indices([square.position for square in squares])
        candidates = Candidates(squares, indices, np.empty((0, len(squares)), np.float32), np.zeros(len(squares)))
        residual = ResidualField.empty(settings.correlation, scenario.grid.shape, scenario.grid.spacing_m)
        nothing = np.empty(0, dtype=np.int64)
        return OperatorBelief(scenario, Measurements.none(), settings, maps, candidates, residual, nothing, np.empty(0), {})

    def _maps(self, scenario: Scenario) -> OperatorMaps:
        key = (id(scenario.city), scenario.uav_altitude_m, scenario.prediction_altitude_m, scenario.frequency_hz)
        if key not in self._kept or self._kept[key].scenario.city is not scenario.city:
            network = next(iter(self._kept.values())).network if self._kept else OperatorNetwork(self.weights)
            self._kept[key] = OperatorMaps(network, scenario)
            while len(self._kept) > KEPT_SCENARIOS:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


@dataclass(frozen=True, eq=False)
class Candidates:
    """The positions under consideration and what the measurements say of each."""

    squares: tuple[Square, ...]
    """where, with the prior"""
    maps: NDArray[np.int64]
    """``[c]`` index of each one's map"""
    whitened: NDArray[np.float32]
    """``[n, c]`` u_c"""
    log_scale: NDArray[np.float64]
    """``[c]`` Σ_i log s_c(i)"""


@dataclass(frozen=True, eq=False)
class OperatorBelief(Belief):
    """Weights of the candidates and the shared residual field. Built by `OperatorPredictor.begin`."""

    scenario: Scenario
    measurements: Measurements
    settings: OperatorSettings
    """inference settings"""
    maps: OperatorMaps
    """candidate maps, shared with other beliefs over the same city"""
    candidates: Candidates
    """positions and their evidence"""
    residual: ResidualField
    """factor of the residual's correlation"""
    cells: NDArray[np.int64]
    """``[n]`` raveled cells taken in"""
    values: NDArray[np.float64]
    """``[n]`` their gains"""
    exact: dict[int, float]
    """raveled cell → gain, of exact readings"""

    def weights(self) -> NDArray[np.float64]:
        """``[c]`` posterior probability of each candidate."""
        s, c = self.settings, self.candidates
        n = len(self.cells)
        square = (c.whitened.astype(np.float64) ** 2).sum(axis=0)
        log_weight = np.log([square_.prior for square_ in c.squares])
        log_weight -= s.temper * (0.5 * (s.degrees + n) * np.log1p(square / s.degrees) + c.log_scale)
        weight = np.exp(log_weight - log_weight.max())
        return weight / weight.sum()

    def updated(self, measurements: Measurements) -> OperatorBelief:
        """The belief after ``measurements``; exact readings of a cell already known exactly carry no news.

        A reading at the receiver's floor is left out where less was expected anyway, and is otherwise taken as one of that value
        with the map's own uncertainty as noise.
        """
        everything = self.measurements.extended(measurements)
        flat = checked_flat(self.scenario.grid, measurements)
        noise = measurements.noise_std_db**2
        news = ~np.isin(flat, list(self.exact))
        if measurements.censored.any():
            expected = self.posterior().mean_db.ravel()[flat]
            news &= ~(measurements.censored & (expected < measurements.gain_db))
            noise = noise + np.where(measurements.censored, self._scale_at(flat), 0.0)
        readings = combined(flat[news], measurements.gain_db[news], noise[news])
        if not len(readings):
            return replace(self, measurements=everything)
        order = np.argsort(readings.cells)  # the same rows of L whatever the order the readings came in
        cells, gain, noise = readings.cells[order], readings.gain_db[order], readings.noise_db2[order]
        grown = self._grown(cells, gain, noise / self._scale_at(cells))
        exact = {int(cell): float(value) for cell, value in zip(cells[noise == 0], gain[noise == 0], strict=True)}
        return replace(grown, measurements=everything, exact={**self.exact, **exact})._refined()

    def posterior(self) -> Posterior:
        """Mean and variance of the mixture; exact at cells measured exactly."""
        weights, n = self.weights(), len(self.cells)
        order = np.argsort(-weights, kind="stable")
        enough = int(np.searchsorted(np.cumsum(weights[order]), MIXTURE_SHARE)) + 1
        kept = order[: min(enough, max(16, MIXTURE_WORK // (n + 16)))]
        weight = (weights[kept] / weights[kept].sum()).astype(np.float32)
        scenario = self.scenario
        mean, variance = self._candidate_maps(kept, scenario.prediction_altitude_m)
        tie = float(np.exp(-abs(scenario.prediction_altitude_m - scenario.uav_altitude_m) / self.settings.vertical_m))
        mean += tie * np.sqrt(variance) * (self.candidates.whitened[:, kept].T @ self.residual.W)
        mixed = weight @ mean
        left = 1.0 - tie**2 * (1.0 - self.residual.left)
        spread = weight @ (variance * left + (mean - mixed) ** 2) * self.settings.variance_factor
        mixed, spread = mixed.astype(float), spread.astype(float)
        if scenario.prediction_altitude_m == scenario.uav_altitude_m:
            cells = np.fromiter(self.exact, dtype=np.int64, count=len(self.exact))
            mixed[cells], spread[cells] = np.fromiter(self.exact.values(), dtype=float, count=len(cells)), 0.0
        return Posterior(mixed.reshape(scenario.grid.shape), spread.reshape(scenario.grid.shape))

    def _blur(self, chosen: NDArray[np.int64]) -> NDArray[np.float32]:
        side_m = self.scenario.grid.spacing_m * np.array([self.candidates.squares[c].side for c in chosen])
        return ((self.settings.blur_db_per_m * side_m) ** 2).astype(np.float32)

    def _candidate_maps(self, chosen: NDArray[np.int64], altitude_m: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        mean, std = self.maps.whole(self.candidates.maps[chosen], altitude_m)
        return mean, std**2 + self._blur(chosen)[:, None]

    def _candidates_at(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        everyone = np.arange(len(self.candidates.squares))
        mean, std = self.maps.at(self.candidates.maps, cells, self.scenario.uav_altitude_m)
        return mean, std**2 + self._blur(everyone)

    def _scale_at(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        return self._candidates_at(cells)[1] @ self.weights()

    def _grown(self, cells: NDArray[np.int64], gain: NDArray[np.float64], noise_share: NDArray[np.float64]) -> OperatorBelief:
        mean, variance = self._candidates_at(cells)
        std = np.sqrt(variance)
        residual, whitened = self.residual, self.candidates.whitened
        cols = self.scenario.grid.shape[1]
        for k, cell in enumerate(cells):
            residual, tie = residual.grown(divmod(int(cell), cols), float(noise_share[k]))
            row = ((gain[k] - mean[k]) / std[k] - tie @ whitened) / residual.diagonal[-1]
            whitened = np.concatenate([whitened, row[None].astype(np.float32)])
        log_scale = self.candidates.log_scale + np.log(std).sum(axis=0, dtype=np.float64)
        candidates = replace(self.candidates, whitened=whitened, log_scale=log_scale)
        return replace(
            self,
            candidates=candidates,
            residual=residual,
            cells=np.append(self.cells, cells),
            values=np.append(self.values, gain),
        )

    def _refined(self) -> OperatorBelief:
        """The heaviest squares cut into quarters, whose maps are computed if no belief over this city has asked for them before."""
        s, c = self.settings, self.candidates
        weight = self.weights()
        heavy = [
            i for i in np.argsort(-weight, kind="stable")[: 4 * s.splits] if weight[i] > s.split_weight and c.squares[i].side > 1
        ]
        heavy = heavy[: s.splits]
        if not heavy:
            return self
        quarters = tuple(q for i in heavy for q in split_square(self.scenario, s.margin_m, c.squares[i]))
        maps = self.maps.indices([q.position for q in quarters])
        fresh = replace(
            self, candidates=Candidates(quarters, maps, np.empty((0, len(quarters)), np.float32), np.zeros(len(quarters)))
        )
        mean, variance = fresh._candidates_at(self.cells)
        std = np.sqrt(variance)
        L = np.tril(self.residual.W[:, self.cells].T, -1)
        np.fill_diagonal(L, self.residual.diagonal)
        whitened = solve_triangular(L, (self.values[:, None] - mean) / std, lower=True, check_finite=False)
        kept = np.setdiff1d(np.arange(len(c.squares)), heavy)
        return replace(
            self,
            candidates=Candidates(
                squares=(*(c.squares[i] for i in kept), *quarters),
                maps=np.append(c.maps[kept], maps),
                whitened=np.concatenate([c.whitened[:, kept], whitened.astype(np.float32)], axis=1),
                log_scale=np.append(c.log_scale[kept], np.log(std).sum(axis=0, dtype=np.float64)),
            ),
        )
