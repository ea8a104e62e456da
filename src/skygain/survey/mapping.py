"""A map from all readings of a campaign: no flight, every reading is used.

`radio_map` predicts every cell from the recorded ones. `cross_validated` says how good that is, on
readings that were left out, and `next_places` where further readings would teach the most.
"""

from __future__ import annotations

__all__ = [
    "LARGE_WORK",
    "RadioMap",
    "Score",
    "chosen_predictor",
    "cross_validated",
    "next_legs",
    "next_places",
    "radio_map",
]

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from skygain.city import City
from skygain.grid import Grid
from skygain.ground.errors import InputError
from skygain.instruments.gridded import GriddedRecording
from skygain.posterior import Posterior
from skygain.scenario import Scenario
from skygain.survey.methods import for_quantity
from skygain.survey.methods import predictor as named_predictor

LARGE_WORK = 2e10
"""measured cells squared times cells of the map, from which one covariance matrix of all readings
is too slow"""
_VALIDATED_CELLS = 1000
"""at most so many measured cells are cross-validated, the nearest ones to the campaign's middle"""
_VALIDATED_SIDE = 63
"""and at most so many cells around it"""
_FOLDS = 5
_DRAWS = 1000
_REACH_M = 100.0
"""correlation length taken where a predictor states none"""


@dataclass(frozen=True)
class Score:
    """Error of one predictor on readings that were left out, in dB."""

    rmse_db: float
    """root of the mean squared error"""
    low_db: float
    """lower end of its 90 % interval"""
    high_db: float
    """upper end"""
    coverage90: float
    """share of the left-out readings within the predicted 90 % interval; NaN without a variance"""


@dataclass(frozen=True, eq=False)
class RadioMap:
    """A campaign's map."""

    label: str
    """which signal, empty where there is only one"""
    gridded: GriddedRecording
    """the readings, cell by cell"""
    scenario: Scenario
    """where: grid, buildings, altitude"""
    predictor: str
    """name of the predictor, with its options"""
    posterior: Posterior
    """level and variance of every cell"""
    correlation: NDArray[np.float64]
    """``[d]`` correlation of the field between cells d cells apart"""
    scores: Mapping[str, Mapping[str, Score]]
    """how well left-out readings are predicted: ``scores["random" or "blocks"][predictor]``"""
    notes: tuple[str, ...]
    """what was chosen or left out on the way"""

    @property
    def grid(self) -> Grid:
        """The map's raster."""
        return self.scenario.grid

    @property
    def wanted(self) -> NDArray[np.bool_]:
        """``[row, col]`` cells that the map is for: outdoors, and inside the area asked for."""
        wanted = self.scenario.outdoor
        return wanted if self.scenario.no_fly is None else wanted & ~self.scenario.no_fly

    @property
    def mean_db(self) -> NDArray[np.float64]:
        """``[row, col]`` the map, NaN where it is not wanted."""
        return np.where(self.wanted, self.posterior.mean_db, np.nan)

    @property
    def std_db(self) -> NDArray[np.float64]:
        """``[row, col]`` its standard deviation, NaN where it is not wanted."""
        return np.where(self.wanted, self.posterior.std_db, np.nan)


def radio_map(
    gridded: GriddedRecording,
    city: City | None = None,
    *,
    predictor: str = "auto",
    label: str = "",
    altitude_m: float = 1.5,
    area: NDArray[np.bool_] | None = None,
    transmitter_m: tuple[float, float, float] | None = None,
    frequency_hz: float = 5e9,
    validate: bool = True,
    seed: int = 0,
    notes: Sequence[str] = (),
) -> RadioMap:
    """The map of all readings.

    Args:
        gridded: the readings on the map's grid.
        city: buildings on the same grid; open ground when left out.
        predictor: a name as in `skygain methods`, or ``"auto"`` for what suits so many readings.
        label: which signal it is.
        altitude_m: of the readings and of the map, above ground.
        area: ``[row, col]`` where the map is wanted; everywhere when left out.
        transmitter_m: (x, y, z) if known.
        frequency_hz: carrier frequency.
        validate: leave readings out and predict them, for `RadioMap.scores`.
        seed: draws the readings that are left out.
        notes: what was told of the city and the logs before.

    Raises:
        InputError: the predictor needs a transmitter, or there is no such predictor.
    """
    grid = gridded.grid
    scenario = Scenario(
        city
        if city is not None
        else City(grid, np.zeros(grid.shape, dtype=np.float32), name=gridded.source),
        uav_altitude_m=altitude_m,
        prediction_altitude_m=altitude_m,
        no_fly=None if area is None else ~area,
        transmitter_m=transmitter_m,
        frequency_hz=frequency_hz,
    )
    notes = [*notes, *gridded.notes]
    if predictor == "auto":
        predictor, told = chosen_predictor(gridded)
        notes += told
    predictor = for_quantity(predictor, gridded.quantity)
    method = named_predictor(predictor)
    if method.transmitter == "required" and transmitter_m is None:
        raise InputError(
            f"predictor {predictor!r} must be told where the transmitter is; give `transmitter`, "
            "or choose one that does without, such as kriging-blind"
        )
    if unlike := method.outside_training(scenario, quantity=gridded.quantity):
        notes.append(unlike)
    readings = gridded.measurements()
    belief = method.begin(scenario).updated(readings)
    scores: Mapping[str, Mapping[str, Score]] = {}
    if validate:
        scores, told = cross_validated(gridded, scenario, (predictor, "idw"), seed)
        notes += told
    inside = int(scenario.city.obstructed(altitude_m)[tuple(gridded.cell.T)].sum())
    if inside:
        notes.append(
            f"{inside} of {len(gridded)} measured cells lie inside buildings at {altitude_m:g} m; "
            "their readings are used for the cells around"
        )
    return RadioMap(
        label,
        gridded,
        scenario,
        predictor,
        belief.posterior(),
        _correlation(belief, grid),
        scores,
        tuple(notes),
    )


def chosen_predictor(gridded: GriddedRecording) -> tuple[str, list[str]]:
    """The predictor that suits so many measured cells, and a line that says so."""
    n = len(gridded)
    if n**2 * gridded.grid.size < LARGE_WORK:
        return "kriging-blind", []
    return "local-kriging", [
        f"{n} measured cells: each cell is predicted from its neighbours (local-kriging)"
    ]


def _correlation(belief: object, grid: Grid) -> NDArray[np.float64]:
    """Correlation by distance in cells, from the belief's own field if it has one."""
    cells = np.arange(max(grid.shape))
    try:
        values = np.asarray(belief.prior_covariance_db2(cells * grid.spacing_m), dtype=float)  # type: ignore[attr-defined, type-var]
    except (AttributeError, NotImplementedError, TypeError):
        return np.exp(-cells * grid.spacing_m / _REACH_M)
    return values / values[0] if values[0] > 0 else np.exp(-cells * grid.spacing_m / _REACH_M)


def cross_validated(
    gridded: GriddedRecording, scenario: Scenario, predictors: Sequence[str], seed: int = 0
) -> tuple[dict[str, dict[str, Score]], list[str]]:
    """Error on readings left out, a fifth of them at a time: cells drawn at random, and whole
    blocks of the map, which is as hard as mapping between the streets that were driven.

    The intervals resample blocks, since errors of neighbours are alike.

    Returns:
        ``scores["random" or "blocks"][predictor]``, and what to tell.
    """
    told = []
    rows, cols = gridded.cell.T
    middle = np.median(gridded.cell, axis=0)
    far = np.sort(np.abs(gridded.cell - middle).max(axis=1))
    side = int(far[:_VALIDATED_CELLS][-1]) + 2
    if len(gridded) > _VALIDATED_CELLS or gridded.grid.size > (2 * _VALIDATED_SIDE) ** 2:
        side = min(side, _VALIDATED_SIDE)
        n = len(gridded)
        scenario, gridded = _window(gridded, scenario, middle.astype(int), side)
        rows, cols = gridded.cell.T
        if len(gridded) < n:
            told.append(
                f"cross-validated on the {len(gridded)} measured cells nearest to the middle"
            )
    if len(gridded) < 2 * _FOLDS:
        return {}, [*told, f"{len(gridded)} measured cells are too few to cross-validate"]
    block = _blocks(rows, cols)
    rng = np.random.default_rng(seed)
    names = np.unique(block)
    folds = {
        "random": rng.permutation(len(rows)) % _FOLDS,
        "blocks": (rng.permutation(len(names)) % _FOLDS)[np.searchsorted(names, block)],
    }
    readings = gridded.measurements()
    scores: dict[str, dict[str, Score]] = {}
    for how, fold in folds.items():
        scores[how] = {}
        for predictor in dict.fromkeys(predictors):
            mean, std = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
            for k in range(_FOLDS):
                out = fold == k
                if out.all() or not out.any():
                    continue
                belief = named_predictor(predictor).begin(scenario)
                posterior = belief.updated(readings.taken(~out)).posterior()
                at = (rows[out], cols[out])
                mean[out], std[out] = posterior.mean_db[at], posterior.std_db[at]
            scores[how][predictor] = _score(gridded, mean, std, block, seed)
    return scores, told


def _window(
    gridded: GriddedRecording, scenario: Scenario, middle: NDArray, side: int
) -> tuple[Scenario, GriddedRecording]:
    """The scenario and readings of the square of ``side`` cells around ``middle``."""
    shape = np.asarray(gridded.grid.shape)
    first = np.clip(middle - side, 0, shape - 1)
    last = np.clip(middle + side, first + 1, shape)
    size = (int(last[0] - first[0]), int(last[1] - first[1]))
    city = scenario.city.cropped(int(first[0]), int(first[1]), size)
    inside = ((gridded.cell >= first) & (gridded.cell < last)).all(axis=1)
    window = replace(
        gridded,
        grid=city.grid,
        cell=gridded.cell[inside] - first,
        **{
            name: getattr(gridded, name)[inside]
            for name in ("level_db", "noise_std_db", "spread_db", "count", "distinct", "censored")
        },
    )
    return replace(scenario, city=city, no_fly=None), window


def _blocks(rows: NDArray, cols: NDArray) -> NDArray[np.int64]:
    """Square of the map that each cell lies in, with about 25 squares in all."""
    extent = max(int(np.ptp(rows)), int(np.ptp(cols))) + 1
    side = max(1, -(-extent // 6))
    return (rows - rows.min()) // side * 1000 + (cols - cols.min()) // side


def _score(
    gridded: GriddedRecording, mean: NDArray, std: NDArray, block: NDArray, seed: int
) -> Score:
    error = mean - gridded.level_db
    square, known = error**2, np.isfinite(error)
    names, group = np.unique(block[known], return_inverse=True)
    total, count = np.bincount(group, square[known]), np.bincount(group)
    drawn = np.random.default_rng(seed).integers(len(names), size=(_DRAWS, len(names)))
    rmse = np.sqrt(total[drawn].sum(axis=1) / count[drawn].sum(axis=1))
    spread = np.sqrt(std**2 + gridded.noise_std_db**2)
    within = np.abs(error[known]) <= 1.6449 * spread[known]
    low, high = np.quantile(rmse, (0.05, 0.95))
    return Score(
        float(np.sqrt(square[known].mean())), float(low), float(high), float(within.mean())
    )


def next_places(
    chart: RadioMap, n: int, where: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """``[n, (row, col)]`` cells where the next readings would teach the most, best first.

    Each is the cell whose reading would lower the map's total variance most, given the ones before
    it: a reading at c lowers the variance at q by the share ρ(c, q)², with the correlation ρ of the
    field.

    Args:
        chart: the map so far.
        n: how many.
        where: ``[row, col]`` cells that can be visited; all that are wanted when left out.
    """
    wanted = chart.wanted
    allowed = (wanted if where is None else wanted & where) & ~chart.gridded.recorded
    worth = _Worth(chart)
    picked: list[tuple[int, int]] = []
    for _ in range(min(n, int(allowed.sum()))):
        score = np.where(allowed, worth.gain, -np.inf)
        row, col = (int(v) for v in np.unravel_index(int(score.argmax()), score.shape))
        picked.append((row, col))
        allowed[row, col] = False
        worth.read(row, col)
    return np.array(picked, dtype=np.int64).reshape(-1, 2)


def next_legs(
    chart: RadioMap, legs: Sequence[NDArray[np.float64]], n: int
) -> list[NDArray[np.float64]]:
    """The ``n`` legs ``[point, (x, y)]`` along which readings would teach most, best first, each
    given the ones before: by the mean over a leg's cells of what a reading there would teach.

    Args:
        chart: the map so far.
        legs: what can be walked, in metres of the map.
        n: how many.
    """
    worth, grid = _Worth(chart), chart.grid
    cells = [_along(leg, grid) for leg in legs]
    cells = [c[chart.wanted[tuple(c.T)]] for c in cells]
    left = {i for i, c in enumerate(cells) if len(c)}
    picked: list[NDArray[np.float64]] = []
    while left and len(picked) < n:
        best = max(sorted(left), key=lambda i: float(worth.gain[tuple(cells[i].T)].mean()))
        left.remove(best)
        picked.append(legs[best])
        for row, col in cells[best].tolist():
            worth.read(row, col)
    return picked


def _along(leg: NDArray[np.float64], grid: Grid) -> NDArray[np.int64]:
    """``[k, (row, col)]`` the cells of the map under a line."""
    length = np.r_[0.0, np.cumsum(np.hypot(*np.diff(leg, axis=0).T))]
    steps = np.linspace(0.0, length[-1], max(2, int(2 * length[-1] / grid.spacing_m)))
    points = np.column_stack([np.interp(steps, length, leg[:, k]) for k in (0, 1)])
    cells = np.unique(grid.cells_at(points), axis=0)
    return cells[grid.contains(cells)]


class _Worth:
    """What a reading in each cell would teach, given those that are to come first."""

    def __init__(self, chart: RadioMap) -> None:
        self.variance = np.where(chart.wanted, np.nan_to_num(chart.posterior.variance_db2), 0.0)
        self.share = _share(chart.correlation)
        self.reach = len(self.share) // 2
        self.gain = fftconvolve(self.variance, self.share, mode="same")

    def read(self, row: int, col: int) -> None:
        """Take a reading in a cell for granted."""
        rows, cols = self.variance.shape
        reach, share = self.reach, self.share
        # The variance changes within reach of the cell, the score within twice that.
        near = _span(row, reach, rows), _span(col, reach, cols)
        offset = tuple(slice(s.start - c + reach, s.stop - c + reach) for s, c in
                       zip(near, (row, col), strict=True))  # fmt: skip
        lost = self.variance[near] * share[offset]
        self.variance[near] -= lost
        wide = _span(row, 2 * reach, rows), _span(col, 2 * reach, cols)
        change = np.zeros((wide[0].stop - wide[0].start, wide[1].stop - wide[1].start))
        inner = tuple(slice(s.start - w.start, s.stop - w.start) for s, w in
                      zip(near, wide, strict=True))  # fmt: skip
        change[inner] = lost
        self.gain[wide] -= fftconvolve(change, share, mode="same")


def _span(at: int, reach: int, size: int) -> slice:
    return slice(max(0, at - reach), min(size, at + reach + 1))


def _share(correlation: NDArray[np.float64]) -> NDArray[np.float64]:
    """``[2r + 1, 2r + 1]`` ρ² around a cell, as far as it counts."""
    heard = np.flatnonzero(correlation**2 > 0.01)
    reach = int(min(heard.max() if len(heard) else 1, 60, len(correlation) - 1)) or 1
    offset = np.arange(-reach, reach + 1)
    distance = np.hypot(offset[:, None], offset[None, :])
    table = np.interp(distance, np.arange(len(correlation)), correlation)
    return np.where(distance <= reach, table**2, 0.0)
