"""The propagation-operator predictor: a learned (city, transmitter) → gain map, a transmitter
inferred from the survey, and Kriging on top.

Two networks say where the transmitter is. The path model (`skygain.networks.operator.path_model`)
predicts every reading from every square of an 8 m grid over the map and 102 m around it; the sums
of its errors are the input of the locator (`skygain.networks.operator.locator`), which answers with
the probability of every square. The propagation operator (`skygain.networks.operator.network`) is
better and dear. Several hundred candidate positions, evenly spread, get a map with the first
updates, the likeliest first, and every square is represented by the candidate nearest to it. A
third network, the judge (`skygain.networks.operator.judge`), weighs the candidates by how their
maps agree with the readings. With each update a candidate is added where that takes most of the
probability closest to its representative.

The posterior is the mixture of the candidates' maps, each corrected by Kriging of its residual
(`residual_field`), summarised by its first two moments, the disagreement between candidates
included. With the transmitter known there is one candidate and the same code.
"""

from __future__ import annotations

__all__ = ["OperatorBelief", "OperatorPredictor", "OperatorSettings"]

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from skygain.fields.mixture_posterior import MixturePosterior
from skygain.fields.residual_field import CorrelationModel, ResidualField
from skygain.ground.errors import InputError
from skygain.measurements import Measurements
from skygain.networks.operator.judge import TERMS, error_terms, judge_inputs
from skygain.predictors.base import Belief, Predictor
from skygain.predictors.interpolators.readings import checked_flat, combined
from skygain.predictors.networks.operator_maps import (
    OperatorMaps,
    OperatorNetwork,
    frequency_shift_db,
)
from skygain.predictors.networks.trained_for import TrainedFor
from skygain.predictors.networks.transmitter_search import TransmitterSearch
from skygain.scenario import Scenario

KEPT_SCENARIOS = 2
"""scenarios whose candidate maps a predictor keeps, the latest ones"""
MIXTURE_SHARE = 0.998
"""candidates beyond this share of the weight are left out of the posterior"""
MIXTURE_WORK = 40_000
"""as are those for which candidates × measurements would exceed this"""
READINGS_PER_MAP = 3
"""an update computes a new candidate's map for so many readings"""
MAPS_AT_ONCE = 16
"""but never more than this"""
NETWORKS_BYTES = 4e8
"""what the networks take while they compute"""
FIRST_WORK = 8_000_000
"""largest number of first candidates × cells of the map, which is what their maps cost in time and
memory"""
FIRST_ALWAYS = 300
"""but so many are allowed on any map"""


@dataclass(frozen=True)
class OperatorSettings:
    """Everything that was chosen on validation cities."""

    correlation: CorrelationModel = field(default_factory=CorrelationModel)
    """of the operator's standardised residual"""
    soften: float = 3.0
    """a, where large standardised residuals begin to count with their logarithm only: z becomes
    a·arcsinh(z/a)"""
    blur_db_per_m: float = 0.2
    """standard deviation added per metre between a candidate and the squares it represents"""
    margin_m: float = 102.0
    """how far outside the map a transmitter may stand"""
    coarse_m: float = 24.0
    """spacing of the first candidates"""
    at_most: int = 1000
    """largest number of first candidates; their spacing grows until it holds"""
    first_maps: int = 64
    """so many of them have a map before the first reading"""
    woken: int = 128
    """largest number of them that get one with an update, the likeliest first"""
    fine_m: float = 8.0
    """side of the squares whose probability is judged"""
    fine_at_most: int = 8000
    """largest number of squares; their side doubles until it holds"""
    gain_m: float = 0.25
    """a candidate is added only if it brings the probability closer to its representatives by so
    much on average"""
    sharpen: float = 1.25
    """power of the judge's probabilities (of the locator's where there is no judge)"""
    vertical_m: float = 10.0
    """decay length of the residual's correlation between the measured and the predicted altitude"""
    variance_factor: float = 1.0
    """calibration of the variance, see docs/deep-predictors.md"""


@dataclass(frozen=True)
class OperatorPredictor(Predictor):
    """See the module; the transmitter's position is used when the scenario gives it.

    Raises:
        InputError: ``covered`` is not a share.
    """

    weights: str | Path = "operator"
    """name or file of the network's weights"""
    paths: str | Path = "path-model"
    """name or file of the path model's weights"""
    locator: str | Path = "locator"
    """name or file of the locator's weights"""
    judge: str | Path = "judge"
    """name or file of the judge's weights; empty for none: then the locator alone weighs the
    candidates"""
    covered: float = 1.0
    """share of the locator's probability from which on the other candidates need no map; with less
    than 1 a survey is quicker and a little less accurate"""
    settings: OperatorSettings = field(default_factory=OperatorSettings)
    """inference settings"""
    runtime: str = "onnx"
    """what runs the networks, see `skygain.networks.runtime`"""
    transmitter: Literal["required", "optional", "unused"] = field(
        init=False, repr=False, default="optional"
    )
    """used when known, inferred when not"""
    _kept: OrderedDict = field(init=False, repr=False, compare=False, default_factory=OrderedDict)

    def __post_init__(self) -> None:
        if not 0.0 < self.covered <= 1.0:
            raise InputError(f"covered must be above 0 and at most 1, got {self.covered:g}")

    def memory_bytes(self, cells: int, readings: int) -> float:
        """Each reading is tied to every cell in a buffer that doubles when it is full; each
        candidate has two maps, which are first computed in single precision."""
        first = min(self.settings.at_most, max(FIRST_ALWAYS, FIRST_WORK // cells))
        held = (12.0 * readings + 12.0 * first) * cells
        return super().memory_bytes(cells, readings) + held + NETWORKS_BYTES

    needs_gain: ClassVar[bool] = True

    def outside_training(
        self, scenario: Scenario, *, uavs: int | None = None, quantity: str = "gain"
    ) -> str:
        return TrainedFor((10.0, 30.0)).unlike(self.weights, scenario, uavs, quantity)

    def begin(self, scenario: Scenario) -> OperatorBelief:
        """The belief before the first measurement; evaluates all first candidates unless this city
        was one of the last used."""
        maps, settings = self._maps(scenario), self.settings
        residual = ResidualField.empty(
            settings.correlation, scenario.grid.shape, scenario.grid.spacing_m
        )
        if scenario.transmitter_m is not None:
            x, y, z = scenario.transmitter_m
            spacing, (x0, y0) = scenario.grid.spacing_m, scenario.grid.origin_m
            search = None
            indices = maps.indices([((y - y0) / spacing, (x - x0) / spacing, float(z))])
        else:
            search = TransmitterSearch.begun(
                scenario,
                margin_m=settings.margin_m,
                fine_m=settings.fine_m,
                fine_at_most=settings.fine_at_most,
                coarse_m=settings.coarse_m,
                at_most=min(
                    settings.at_most, max(FIRST_ALWAYS, FIRST_WORK // scenario.outdoor.size)
                ),
                first_maps=settings.first_maps,
                height_z_m=maps.height_z_m,
            )
            indices = maps.indices(search.positions(search.candidates()))
        whitened, terms = (
            np.empty((0, len(indices)), dtype=np.float32),
            np.zeros((len(TERMS), len(indices)), dtype=np.float32),
        )
        nothing = np.empty(0, dtype=np.int64)
        none = np.empty(0)
        return OperatorBelief(
            scenario,
            Measurements.none(),
            settings,
            maps,
            indices,
            whitened,
            terms,
            search,
            residual,
            nothing,
            none,
            none,
            {},
            self.covered,
        )

    def _maps(self, scenario: Scenario) -> OperatorMaps:
        key = (
            id(scenario.city),
            scenario.uav_altitude_m,
            scenario.prediction_altitude_m,
            scenario.frequency_hz,
        )
        if key not in self._kept or self._kept[key].scenario.city is not scenario.city:
            kept = next(iter(self._kept.values()), None)
            network = (
                kept.network
                if kept is not None
                else OperatorNetwork(
                    self.weights, self.paths, self.locator, self.judge, self.runtime
                )
            )
            self._kept[key] = OperatorMaps(network, scenario)
            while len(self._kept) > KEPT_SCENARIOS:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


@dataclass(frozen=True, eq=False)
class OperatorBelief(Belief):
    """Probabilities of the candidates and the shared residual field. Built by
    `OperatorPredictor.begin`."""

    scenario: Scenario
    measurements: Measurements
    settings: OperatorSettings
    """inference settings"""
    maps: OperatorMaps
    """candidate maps, shared with other beliefs over the same city"""
    candidates: NDArray[np.int64]
    """``[c]`` index of the map of each candidate that has one"""
    whitened: NDArray[np.float32]
    """``[n, c]`` L⁻¹ z_c of the softened residuals, for Kriging"""
    terms: NDArray[np.float32]
    """``[term, c]`` sums over the readings that the judge looks at"""
    search: TransmitterSearch | None
    """probability of every square; None with the transmitter known"""
    residual: ResidualField
    """factor of the residual's correlation, for Kriging"""
    cells: NDArray[np.int64]
    """``[n]`` raveled cells taken in"""
    values: NDArray[np.float64]
    """``[n]`` their gains"""
    noise_db2: NDArray[np.float64]
    """``[n]`` their noise variances"""
    exact: dict[int, float]
    """raveled cell → gain, of exact readings"""
    covered: float = 1.0
    """share of the locator's probability that candidates with a map have to reach"""

    def weights(self) -> NDArray[np.float64]:
        """``[c]`` posterior probability of each candidate."""
        return np.ones(1) if self.search is None else self.search.weights()

    def judged(self) -> OperatorBelief:
        """With the candidates weighed by how well their maps agree with the readings; updates do
        that by themselves."""
        judge = self.maps.network.judge
        if self.search is None or judge is None:
            return self
        inputs = judge_inputs(self.terms, len(self.cells), *self.search.standing())
        return replace(
            self, search=self.search.judged(judge.probability(inputs, self.settings.sharpen))
        )

    def updated(self, measurements: Measurements) -> OperatorBelief:
        """The belief after ``measurements``; exact readings of a cell already known exactly carry
        no news.

        A reading at the receiver's floor is left out where less was expected anyway, and is
        otherwise taken as one of that value with the map's own uncertainty as noise.
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
        order = np.argsort(
            readings.cells
        )  # the same rows of L whatever the order the readings came in
        cells, gain, noise = (
            readings.cells[order],
            readings.gain_db[order],
            readings.noise_db2[order],
        )
        grown = self._grown(cells, gain, noise)
        exact = {
            int(cell): float(value)
            for cell, value in zip(cells[noise == 0], gain[noise == 0], strict=True)
        }
        return replace(grown, measurements=everything, exact={**self.exact, **exact})._refined(
            len(cells)
        )

    def posterior(self) -> MixturePosterior:
        """First two moments of the mixture; exact at cells measured exactly."""
        weights, n = self.weights(), len(self.cells)
        order = np.argsort(-weights, kind="stable")
        enough = int(np.searchsorted(np.cumsum(weights[order]), MIXTURE_SHARE)) + 1
        kept = order[: min(enough, max(16, MIXTURE_WORK // (n + 16)))]
        weight = (weights[kept] / weights[kept].sum()).astype(np.float32)
        scenario = self.scenario
        mean, std = self.maps.whole(self.candidates[kept], scenario.prediction_altitude_m)
        tie = float(
            np.exp(
                -abs(scenario.prediction_altitude_m - scenario.uav_altitude_m)
                / self.settings.vertical_m
            )
        )
        mean += tie * std * (self.whitened[:, kept].T @ self.residual.W)
        variance = std**2 + self._blur()[kept, None] ** 2
        mixed = weight @ mean
        left = 1.0 - tie**2 * (1.0 - self.residual.left)
        spread = weight @ (variance * left + (mean - mixed) ** 2) * self.settings.variance_factor
        mixed, spread = mixed.astype(float), spread.astype(float)
        known = np.zeros(len(mixed), dtype=bool)
        if scenario.prediction_altitude_m == scenario.uav_altitude_m:
            cells = np.fromiter(self.exact, dtype=np.int64, count=len(self.exact))
            mixed[cells], spread[cells] = (
                np.fromiter(self.exact.values(), dtype=float, count=len(cells)),
                0.0,
            )
            known[cells] = True
        return MixturePosterior(
            mean_db=mixed.reshape(scenario.grid.shape),
            variance_db2=spread.reshape(scenario.grid.shape),
            weight=weight,
            means_db=mean,
            stds_db=np.sqrt(variance),
            correlation=self.residual.table,
            whitened=self.residual.W,
            tie=tie,
            known=known,
            factor=self.settings.variance_factor,
        )

    def _blur(self) -> NDArray[np.float32]:
        away_m = np.zeros(1) if self.search is None else self.search.spread_m()
        return (self.settings.blur_db_per_m * away_m).astype(np.float32)

    def _scale_at(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        _, std = self.maps.at(self.candidates, cells, self.scenario.uav_altitude_m)
        return (std**2 + self._blur() ** 2) @ self.weights()

    def _residuals(
        self,
        candidates: NDArray[np.int64],
        cells: NDArray[np.int64],
        gain: NDArray[np.float64],
        noise_db2: NDArray[np.float64],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Standardised residuals softened to a·arcsinh(z/a), those that the judge sees, and the
        standard deviation of these.

        Each ``[cell, candidate]``. To the judge the noise of a reading adds to a candidate's own
        uncertainty.
        """
        mean, std = self.maps.at(candidates, cells, self.scenario.uav_altitude_m)
        a, error = np.float32(self.settings.soften), gain[:, None].astype(np.float32) - mean
        whole: NDArray[np.float32] = np.sqrt(std**2 + noise_db2[:, None].astype(np.float32))
        return a * np.arcsinh(error / (a * std)), error / whole, whole

    def _terms(
        self,
        z: NDArray[np.float32],
        whitened: NDArray[np.float32],
        std: NDArray[np.float32],
        gain: NDArray[np.float64],
    ) -> NDArray[np.float32]:
        if self.search is None:
            return np.zeros((len(TERMS), z.shape[1]), dtype=np.float32)
        return error_terms(z, whitened, std, gain - frequency_shift_db(self.scenario))

    def _grown(
        self, cells: NDArray[np.int64], gain: NDArray[np.float64], noise_db2: NDArray[np.float64]
    ) -> OperatorBelief:
        residual, whitened = self.residual, self.whitened
        noise_share = noise_db2 / self._scale_at(cells)
        places = np.stack(np.divmod(cells, self.scenario.grid.shape[1]), axis=-1)
        soft, z, std = self._residuals(self.candidates, cells, gain, noise_db2)
        residual, rows = residual.grown(cells, noise_share)
        old = len(self.cells)
        news = solve_triangular(
            rows[:, old:], soft - rows[:, :old] @ whitened, lower=True, check_finite=False
        )
        whitened = np.concatenate([whitened, news])
        return replace(
            self,
            whitened=whitened,
            terms=self.terms + self._terms(z, news, std, gain),
            search=None
            if self.search is None
            else self.search.grown(self.maps, places, gain, self.settings.sharpen),
            residual=residual,
            cells=np.append(self.cells, cells),
            values=np.append(self.values, gain),
            noise_db2=np.append(self.noise_db2, noise_db2),
        ).judged()

    def _refined(self, news: int) -> OperatorBelief:
        """With maps for likely candidates and with candidates added for ``news`` readings; a map is
        computed if no belief over this city has asked for it before."""
        if self.search is None:
            return self
        search = self.search.woken(self.covered, self.settings.woken).refined(
            min(-(-news // READINGS_PER_MAP), MAPS_AT_ONCE), self.settings.gain_m
        )
        joining = self.maps.indices(search.positions(search.candidates()[len(self.candidates) :]))
        if not len(joining):
            return self
        L = np.tril(self.residual.W[:, self.cells].T, -1)
        np.fill_diagonal(L, self.residual.diagonal)
        soft, z, std = self._residuals(joining, self.cells, self.values, self.noise_db2)
        whitened = solve_triangular(L, soft, lower=True, check_finite=False).astype(np.float32)
        return replace(
            self,
            candidates=np.append(self.candidates, joining),
            whitened=np.concatenate([self.whitened, whitened], axis=1),
            terms=np.concatenate([self.terms, self._terms(z, whitened, std, self.values)], axis=1),
            search=search,
        ).judged()
