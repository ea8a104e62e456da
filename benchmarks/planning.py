"""How good sequential greedy's plans are, and what its weights rest on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.city import City
from skygain.datasets.cases import Case, survey_cases
from skygain.datasets.store import ChannelDataset
from skygain.fields.planning import planning_field
from skygain.flight.moves import MOVES
from skygain.flight.swarm import Swarm
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.planners import create_planner
from skygain.planners.search.certificate import information
from skygain.predictors import Belief, create_predictor
from skygain.predictors.kriging.known_source import KrigingPredictor
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario

PARAMETERS = KrigingParameters.known_trend(27.0, 72.0, sill_db2=380.0, range_m=57.0)
RATIO = "F / F_optimal"
KRIGING = KrigingPredictor(parameters=PARAMETERS, refit=False)


def setting(free: np.ndarray, cells: np.ndarray, steps: int) -> tuple[Swarm, Belief]:
    """UAVs at ``cells`` on a map with the given free cells, and what Kriging knows there."""
    scenario = Scenario(
        City(Grid(free.shape, 4.0), np.where(free, 0, 30).astype(np.float32)),
        transmitter_m=(2.0, 2.0, 40.0),
    )
    return Swarm.deployed(scenario, cells, steps), measured(KRIGING.begin(scenario), cells)


def measured(belief: Belief, cells: np.ndarray) -> Belief:
    """The belief after readings at ``cells``; their values do not matter to the planners measured
    here."""
    return belief.updated(Measurements.at(cells, -110.0 + 5 * np.sin(cells.sum(axis=-1))))


@study("exhaustion", settings=Option(100, "random settings"))
def exhaustion(run: Run) -> list[Table]:
    """Sequential greedy against exhaustive joint search: two UAVs, five steps, entropy objective.

    The share is (F − F_random)/(F_optimal − F_random), in random settings with obstacles.
    """
    found: list[Any] = []
    trial = 0
    while len(found) < run.options.settings:
        if numbers := run.once((trial,), lambda k=trial: exhausted(k)):
            found.append(numbers)
        trial += 1
    share, ratio, sound = np.array(found, dtype=float).T
    rows = [
        [name, f"{values.mean():.4f}", f"{values.min():.4f}"]
        for name, values in (("share of the way from random to optimal", share), (RATIO, ratio))
    ]
    title = (
        f"Two UAVs, horizon 5, {len(found)} random settings; "
        f"{round(sound.sum())} of {len(found)} certificates hold."
    )
    return [Table(title, ["", "mean", "worst"], rows)]


def exhausted(trial: int) -> list[float] | None:
    """(share, F/F_optimal, whether the certificate holds), nothing where the UAVs are walled in."""
    rng = np.random.default_rng(trial)
    free = rng.random((12, 12)) > rng.uniform(0, 0.3)
    reachable = np.argwhere(free)
    cells = reachable[rng.choice(len(reachable), 2, replace=False)]
    near = reachable[np.abs(reachable - cells[0]).sum(axis=1) <= 3]
    cells[1] = near[rng.integers(len(near))]
    if (cells[0] == cells[1]).all():
        return None
    swarm, belief = setting(free, cells, 5)
    belief = measured(belief, reachable[rng.choice(len(reachable), 8, replace=False)])
    number = np.arange(free.size).reshape(free.shape)
    source = planning_field(belief).conditioned()
    everything = np.argwhere(np.ones_like(free))
    first, second = (all_paths(swarm, uav, 5, number) for uav in range(2))
    if not (len(first) and len(second)):
        return None
    among = source.covariance(everything, everything)
    best, mean, pairs = best_and_mean(first, second, among, 1.0)
    if pairs == 0:
        return None
    plan = create_planner("sequential-greedy", objective="entropy").plan(swarm, belief, 5, rng)
    value = information(source, np.unique(plan.paths[:, 1:].reshape(-1, 2), axis=0), 1.0)
    assert plan.certificate is not None
    sound = best <= plan.certificate.upper_bound_nats + 1e-9 and value <= best + 1e-6
    return [(value - mean) / (best - mean) if best > mean else 1.0, value / best, float(sound)]


def all_paths(swarm: Swarm, uav: int, steps: int, number: np.ndarray) -> np.ndarray:
    """``[path, step]`` cell numbers of every path of one UAV that obstacles allow."""
    paths = [[tuple(swarm.cells[uav].tolist())]]
    for _ in range(steps):
        paths = [
            [*path, to]
            for path in paths
            for to in ((path[-1][0] + int(m[0]), path[-1][1] + int(m[1])) for m in MOVES)
            if 0 <= to[0] < number.shape[0] and 0 <= to[1] < number.shape[1] and swarm.flyable[to]
        ]
    return np.array([[number[cell] for cell in path] for path in paths])


@njit(cache=True)
def best_and_mean(first, second, among, noise):
    """Best and mean information over all pairs of legal paths ``[path, step]`` (cell numbers), as
    (best, mean, pairs)."""
    steps = first.shape[1] - 1
    factor = np.zeros((2 * steps, 2 * steps))
    cells = np.empty(2 * steps, dtype=np.int64)
    best, total, pairs = 0.0, 0.0, 0
    for p in range(len(first)):
        settled, settled_value = 0, 0.0
        for t in range(1, steps + 1):
            settled, settled_value = _appended(
                first[p, t], cells, settled, settled_value, factor, among, noise
            )
        for q in range(len(second)):
            clash = False
            for t in range(1, steps + 1):
                same = first[p, t] == second[q, t]
                swap = first[p, t] == second[q, t - 1] and first[p, t - 1] == second[q, t]
                if same or swap:
                    clash = True
                    break
            if clash:
                continue
            count, value = settled, settled_value
            for t in range(1, steps + 1):
                count, value = _appended(second[q, t], cells, count, value, factor, among, noise)
            best = max(best, value)
            total += value
            pairs += 1
    return best, total / max(pairs, 1), pairs


@njit(cache=True)
def _appended(cell, cells, count, value, factor, among, noise):
    for j in range(count):
        if cells[j] == cell:
            return count, value
    left = among[cell, cell] + noise
    for j in range(count):
        entry = among[cell, cells[j]]
        for i in range(j):
            entry -= factor[count, i] * factor[j, i]
        factor[count, j] = entry / factor[j, j]
        left -= factor[count, j] ** 2
    factor[count, count] = np.sqrt(left)
    cells[count] = cell
    return count + 1, value + 0.5 * np.log(left / noise)


@study(
    "certificates",
    data="DATA",
    surveys=Option(10, "surveys of T2"),
    horizons=Option((10, 20, 40), "steps planned and flown"),
)
def certificates(run: Run) -> list[Table]:
    """What the certificates of the entropy objective say along surveys of T2."""
    o = run.options
    cases = survey_cases(ChannelDataset.open(run.data), "T2", n_uavs=3, max_surveys=o.surveys)
    rows = []
    for horizon in o.horizons:
        proofs = [
            proof
            for case in cases
            for proof in run.once(
                (horizon, case.link), lambda c=case, h=horizon: certificates_of(c, h)
            )
        ]
        value, gap, ratio, share = np.median(np.array(proofs), axis=0)
        rows.append(
            [
                f"{horizon}",
                f"{len(proofs)}",
                f"{value:.1f}",
                f"{gap:.1f}",
                f"{ratio:.3f}",
                f"{share:.3f}",
            ]
        )
    head = ["horizon", "plans", "F, nats", "gap, nats", "F / bound"]
    head.append("share of the way from random to the bound")
    return [Table("Medians along surveys of three UAVs.", head, rows)]


def certificates_of(case: Case, horizon: int) -> list[list[float]]:
    """(value, gap, ratio, share) of the plans of one survey of 80 steps."""
    planner = create_planner(
        "sequential-greedy", objective="entropy", horizon=horizon, commit_steps=horizon
    )
    swarm = Swarm.deployed(case.scenario(), case.start_cells, 80)
    belief = measured(KRIGING.begin(case.scenario()), case.start_cells)
    found, rng = [], case.rng()
    for left in range(80, 0, -horizon):
        plan = planner.plan(swarm, belief, left, rng)
        proof = plan.certificate
        if proof is not None and proof.share is not None:
            found.append([proof.value_nats, proof.gap_nats, proof.ratio, proof.share])
        for step in range(1, plan.commit_steps + 1):
            swarm = swarm.advanced(plan.paths[:, step])
        belief = measured(belief, plan.paths[:, 1:].reshape(-1, 2))
    return found


BINS = 12


@study(
    "volatility",
    data="DATA",
    surveys=Option(40, "surveys of T1"),
    steps=Option((40, 100, 200), "lengths of the flights"),
)
def volatility(run: Run) -> list[Table]:
    """Squared error of Kriging over its own variance, by the gain it predicts.

    Random waypoints and lawnmowers over training cities; unvisited outdoor cells. A weight by this
    ratio is judged on cities that it was not taken from.
    """
    o = run.options
    every, city = [], []
    for case in survey_cases(ChannelDataset.open(run.data), "T1", max_surveys=o.surveys):
        found = run.once((case.link, *o.steps), lambda c=case: squares(c, o.steps))
        every.append(np.array(found))
        city.append(np.full(len(found), case.city_index))
    rows, cities = np.concatenate(every), np.concatenate(city)
    held_out = cities % 3 == 0
    middle, ratio = fitted(rows[~held_out])
    square, variance = rows[held_out, 1], rows[held_out, 2]

    def nats(factor: np.ndarray | float) -> float:
        return float(np.mean(0.5 * (np.log(variance * factor) + square / (variance * factor))))

    won = nats(ratio.mean()) - nats(np.interp(rows[held_out, 0], middle, ratio))
    title = (
        f"{o.surveys} training surveys, random waypoints and lawnmower, "
        f"{', '.join(map(str, o.steps))} steps. On held-out cities the scaled variance wins "
        f"{won:.3f} nats per cell over a constant factor."
    )
    cells = [[f"{m:.1f}", f"{r:.2f}"] for m, r in zip(*fitted(rows), strict=True)]
    return [Table(title, ["predicted gain, dB", "squared error / variance"], cells)]


def squares(case: Case, lengths: tuple[int, ...]) -> np.ndarray:
    """Rows (predicted gain, squared error, variance) of every seventh cell of a survey's maps."""
    scenario, truth = case.scenario(), case.truth_db
    swarm = Swarm.deployed(scenario, case.start_cells, max(lengths))
    rows = []
    for name in ("random-waypoint", "lawnmower"):
        for steps in lengths:
            paths = create_planner(name).plan(swarm, None, steps, case.rng()).paths  # type: ignore[arg-type]
            cells = paths.transpose(1, 0, 2).reshape(-1, 2)
            belief = create_predictor("kriging").begin(scenario)
            posterior = belief.updated(Measurements.at(cells, truth[tuple(cells.T)])).posterior()
            wanted = scenario.outdoor.copy()
            wanted[tuple(cells.T)] = False
            mean, variance = posterior.mean_db[wanted], posterior.variance_db2[wanted]
            rows.append(np.stack([mean, (truth[wanted] - mean) ** 2, variance], axis=1)[::7])
    return np.concatenate(rows)


def fitted(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle of each bin of predicted gain (equal counts) and the ratio there."""
    edges = np.quantile(rows[:, 0], np.linspace(0, 1, BINS + 1))
    where = np.clip(np.searchsorted(edges, rows[:, 0]) - 1, 0, BINS - 1)
    middle = np.array([np.median(rows[where == k, 0]) for k in range(BINS)])
    ratio = np.array([rows[where == k, 1].sum() / rows[where == k, 2].sum() for k in range(BINS)])
    return middle, ratio
