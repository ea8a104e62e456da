"""The propagation-operator predictor: a learned (city, transmitter) → gain map, a transmitter inferred from the survey, and Kriging on top.

Two models judge where the transmitter is. The path model (`skygain.learning.path_model`) is cheap: after every reading it weighs all
positions on an 8 m grid over the map and 102 m around it. The propagation operator (`skygain.learning.operator_net`) is better and
dear: its maps exist for the squares of a quadtree, coarse at first, and each update cuts the square that either model finds
heaviest into quarters, down to one cell. Each candidate's weight is prior · likelihood^τ with the likelihood of `evidence`; τ falls with
the number of readings.

The posterior is the mixture of the candidates' maps, each corrected by Kriging of its residual (`residual_field`), summarised by its mean
and full variance, the disagreement between candidates included. With the transmitter known there is one candidate and the same code.
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
from skygain.predictors.evidence import Evidence, Factor, posterior_weights
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
    misfit_correlation: CorrelationModel = field(
        default_factory=lambda: CorrelationModel(length_m=30.0, far_share=0.1, nugget=0.7)
    )
    """of the softened residual in the likelihood of a candidate, where trusting the correlation less found the transmitter more often"""
    temper: float = 2.0
    """κ, the likelihood's power is κ/√n"""
    degrees: float = 3.0
    """ν, degrees of freedom of the residual's scale"""
    soften: float = 3.0
    """a, where large residuals begin to count with their logarithm only"""
    blur_db_per_m: float = 0.2
    """standard deviation added per metre of a candidate square's side, since its map is that of one point of it"""
    margin_m: float = 102.0
    """how far outside the map a transmitter may stand"""
    coarse_m: float = 32.0
    """side of the first squares"""
    fine_m: float = 8.0
    """spacing of the path model's positions"""
    at_most: int = 300
    """largest number of first squares"""
    fine_at_most: int = 4000
    """largest number of the path model's positions"""
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
    paths: str | Path = "path-model"
    """name or file of the path model's weights"""
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
            fine = Search.over([], maps.height_z_m)
        else:
            squares = tuple(coarse_squares(scenario, settings.margin_m, settings.coarse_m, settings.at_most))
            indices = maps.indices([square.position for square in squares])
            fine_squares = coarse_squares(scenario, settings.margin_m, settings.fine_m, settings.fine_at_most)
            fine = Search.over(fine_squares, maps.height_z_m)
        candidates = Candidates(squares, indices, np.empty((0, len(squares)), np.float32), Evidence.none(len(squares)))
        residual = ResidualField.empty(settings.correlation, scenario.grid.shape, scenario.grid.spacing_m)
        factor = Factor.empty(settings.misfit_correlation, scenario.grid.spacing_m)
        nothing = np.empty(0, dtype=np.int64)
        return OperatorBelief(
            scenario, Measurements.none(), settings, maps, candidates, fine, residual, factor, nothing, np.empty(0), {}
        )

    def _maps(self, scenario: Scenario) -> OperatorMaps:
        key = (id(scenario.city), scenario.uav_altitude_m, scenario.prediction_altitude_m, scenario.frequency_hz)
        if key not in self._kept or self._kept[key].scenario.city is not scenario.city:
            network = next(iter(self._kept.values())).network if self._kept else OperatorNetwork(self.weights, self.paths)
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
    """``[n, c]`` L⁻¹ z_c, for Kriging"""
    evidence: Evidence
    """for the weights"""

    @property
    def prior(self) -> NDArray[np.float64]:
        """``[c]`` unnormalised."""
        return np.array([square.prior for square in self.squares])


@dataclass(frozen=True, eq=False)
class Search:
    """All positions, as the path model judges them."""

    position: NDArray[np.float64]
    """``[k, (row, col, z)]``"""
    prior: NDArray[np.float64]
    """``[k]`` unnormalised"""
    evidence: Evidence
    """of each"""

    @classmethod
    def over(cls, squares: list[Square], height_z_m: float) -> Search:
        """Before the first measurement."""
        position = np.array([(*square.position, height_z_m) for square in squares]).reshape(-1, 3)
        return cls(position, np.array([square.prior for square in squares]), Evidence.none(len(squares)))

    def inside(self, square: Square) -> NDArray[np.int64]:
        """Positions that lie in ``square``."""
        low = np.array([square.row, square.col])
        return np.flatnonzero(((self.position[:, :2] >= low) & (self.position[:, :2] < low + square.side)).all(axis=1))


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
    """positions with a map, and their evidence"""
    search: Search
    """all positions"""
    residual: ResidualField
    """factor of the residual's correlation, for Kriging"""
    factor: Factor
    """the same for the likelihood"""
    cells: NDArray[np.int64]
    """``[n]`` raveled cells taken in"""
    values: NDArray[np.float64]
    """``[n]`` their gains"""
    exact: dict[int, float]
    """raveled cell → gain, of exact readings"""

    def weights(self) -> NDArray[np.float64]:
        """``[c]`` posterior probability of each candidate."""
        c = self.candidates
        return posterior_weights(c.prior, c.evidence.log_likelihood(self.settings.degrees), self._power)

    @property
    def _power(self) -> float:
        return min(1.0, self.settings.temper / np.sqrt(max(len(self.cells), 1)))

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
        residual, c, soften = self.residual, self.candidates, self.settings.soften
        places = np.stack(np.divmod(cells, self.scenario.grid.shape[1]), axis=-1)
        mean, variance = self._candidates_at(cells)
        std = np.sqrt(variance)
        z = (gain[:, None].astype(np.float32) - mean) / std
        whitened = c.whitened
        for k, (row, col) in enumerate(places.tolist()):
            residual, tie = residual.grown((row, col), float(noise_share[k]))
            whitened = np.concatenate([whitened, (z[k] - tie @ whitened)[None] / residual.diagonal[-1]])
        factor, rows = self.factor.grown(places, noise_share)
        c = replace(c, whitened=whitened, evidence=c.evidence.grown(z, std, rows, soften))
        search = self.search
        if len(search.prior):
            path_mean, path_std = self.maps.path_gain(search.position, places)
            path_z = (gain[:, None].astype(np.float32) - path_mean) / path_std
            search = replace(search, evidence=search.evidence.grown(path_z, path_std, rows, soften))
        return replace(
            self,
            candidates=c,
            search=search,
            residual=residual,
            factor=factor,
            cells=np.append(self.cells, cells),
            values=np.append(self.values, gain),
        )

    def _refined(self) -> OperatorBelief:
        """The heaviest square cut into quarters, whose maps are computed if no belief over this city has asked for them before."""
        s, c = self.settings, self.candidates
        if not len(self.search.prior):
            return self
        found = posterior_weights(self.search.prior, self.search.evidence.log_likelihood(s.degrees), self._power)
        heavy = self._heaviest(found)
        if not heavy:
            return self
        quarters = [q for i in heavy for q in split_square(self.scenario, s.margin_m, c.squares[i])]
        for k, quarter in enumerate(quarters):
            inside = self.search.inside(quarter)
            if len(inside) > 1:  # where the path model has a choice, the quarter is represented by its favourite
                row, col = self.search.position[inside[np.argmax(found[inside])], :2].tolist()
                quarters[k] = replace(quarter, position=(row, col))
        maps = self.maps.indices([q.position for q in quarters])
        joining = Candidates(tuple(quarters), maps, c.whitened[:, :0], Evidence.none(len(quarters)))
        mean, variance = replace(self, candidates=joining)._candidates_at(self.cells)
        std = np.sqrt(variance)
        z = (self.values[:, None].astype(np.float32) - mean) / std
        L = np.tril(self.residual.W[:, self.cells].T, -1)
        np.fill_diagonal(L, self.residual.diagonal)
        whitened = solve_triangular(L, z, lower=True, check_finite=False).astype(np.float32)
        kept = np.setdiff1d(np.arange(len(c.squares)), heavy)
        return replace(
            self,
            candidates=Candidates(
                squares=(*(c.squares[i] for i in kept), *quarters),
                maps=np.append(c.maps[kept], maps),
                whitened=np.concatenate([c.whitened[:, kept], whitened], axis=1),
                evidence=c.evidence.joined(kept, Evidence.solved(z, std, self.factor, s.soften)),
            ),
        )

    def _heaviest(self, found: NDArray[np.float64]) -> list[int]:
        """Squares worth cutting, by the larger of the operator's weight and the path model's, heaviest first."""
        c, s = self.candidates, self.settings
        weight = self.weights()
        for i in np.flatnonzero([square.side * self.scenario.grid.spacing_m > s.fine_m for square in c.squares]):
            weight[i] = max(weight[i], found[self.search.inside(c.squares[i])].sum())
        weight[[square.side <= 1 for square in c.squares]] = 0.0
        order = np.argsort(-weight, kind="stable")[: s.splits]
        return [int(i) for i in order if weight[i] > s.split_weight]
