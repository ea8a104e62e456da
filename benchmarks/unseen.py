"""Cities of another kind than those that networks were trained on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.cities.scenes import scene_city
from skygain.city import City
from skygain.evaluation.rollout import flown
from skygain.flight.starts import start_cells
from skygain.grid import Grid
from skygain.instruments.simulated import PerfectInstrument
from skygain.networks.weights import runs_folder
from skygain.propagation.truth import trace_truth
from skygain.scenario import Scenario
from skygain.survey.methods import MethodSpec

SCENES = ("munich", "etoile")
SIDE, MARGIN, SPACING_M, ALTITUDE_M = 96, 26, 4.0, 10.0
INNER = (slice(MARGIN, MARGIN + SIDE),) * 2
"""the window without its margin"""
OPEN_SHARE, BUILT_SHARE = 0.3, 0.1
"""a window with less open ground or fewer buildings than this is drawn again"""
KEYS = ("rmse_db", "rmse_ray_traced_db", "gof", "coverage90")


def drawn_window(
    whole: City, rng: np.random.Generator
) -> tuple[NDArray[np.float32], tuple[int, int], NDArray[np.int64]]:
    """Heights of a window of ``whole`` with its margin, its first row and column, and an open cell
    of it for the transmitter."""
    wide = SIDE + 2 * MARGIN
    while True:
        row, col = (int(rng.integers(n - wide + 1)) for n in whole.grid.shape)
        height = np.ascontiguousarray(whole.height_m[row : row + wide, col : col + wide])
        outdoor = height[INNER] < ALTITUDE_M
        if outdoor.mean() >= OPEN_SHARE and (~outdoor).mean() >= BUILT_SHARE:
            break
    open_cells = np.argwhere(height <= 0)
    return height, (row, col), open_cells[rng.integers(len(open_cells))]


def window(scene: str, number: int) -> dict[str, Any]:
    """City heights, transmitter and truth of one window, from the cache if it was traced before."""
    path = runs_folder().parent / "unseen" / f"{scene}-{number}.npz"
    if path.exists():
        with np.load(path) as found:
            return dict(found)
    rng = np.random.default_rng([number, len(scene)])
    height, _, cell = drawn_window(scene_city(scene, spacing_m=SPACING_M), rng)
    city = City(Grid(height.shape, SPACING_M), height, name=scene)
    x, y = city.grid.xy_m(cell)
    transmitter = np.array([float(x), float(y), 1.5])
    truth = trace_truth(city, [transmitter], [ALTITUDE_M])
    found = {
        "height_m": height[INNER],
        "gain_db": truth.gain_db[0, 0][INNER],
        "ray_traced": truth.ray_traced[0, 0][INNER],
        "transmitter_m": transmitter - [MARGIN * SPACING_M, MARGIN * SPACING_M, 0.0],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **found)
    return found


def fly(found: dict[str, Any], name: str, number: int, steps: tuple[int, ...]) -> Any:
    """Scores at ``steps`` of one survey of a window."""
    city = City(Grid((SIDE, SIDE), SPACING_M), found["height_m"])
    scenario = replace(
        Scenario(city, transmitter_m=tuple(found["transmitter_m"].tolist())),
        uav_altitude_m=ALTITUDE_M,
        prediction_altitude_m=ALTITUDE_M,
    )
    rng = np.random.default_rng([number, 7])
    result = flown(
        scenario,
        MethodSpec(name, "random-waypoint"),
        PerfectInstrument(found["gain_db"]),
        found["gain_db"],
        start_cells("cluster", scenario, 3, rng),
        steps=max(steps),
        record_steps=steps,
        rng=rng,
        ray_traced=found["ray_traced"],
    )
    return [result["scores"][key] for key in KEYS]


@study(
    "unseen_cities",
    predictors=Option(("kriging", "operator", "operator+tx"), "predictors"),
    windows=Option(10, "windows of each scene"),
    steps=Option((0, 50, 100, 200), "steps at which scores are taken"),
)
def unseen_cities(run: Run) -> list[Table]:
    """Predictors in windows of Munich and Paris (Sionna RT's scenes), traced by our own simulator.

    A window has 96 × 96 cells of 4 m and one transmitter at 1.5 m on open ground, up to 102 m
    outside of it. No network is trained again. Traced windows are kept in the user's cache.
    """
    o = run.options
    rows = []
    for scene in SCENES:
        for name in o.predictors:
            scores = [
                run.once(
                    (scene, number, name, *o.steps),
                    lambda s=scene, k=number, n=name: fly(window(s, k), n, k, o.steps),
                )
                for number in range(o.windows)
            ]
            rmse, traced, fit, cover = np.nanmean(np.array(scores, dtype=float), axis=0)
            rows.append(
                [
                    scene,
                    name,
                    *(f"{v:.2f}" for v in rmse),
                    f"{traced[-1]:.2f}",
                    f"{fit[-1]:+.2f}",
                    f"{100 * cover[-1]:.1f} %",
                ]
            )
    title = (
        f"{o.windows} windows of each scene, 96 × 96 cells of 4 m at 10 m, random "
        f"waypoints, 3 UAVs, cluster start; RMSE in dB over "
        "unvisited outdoor cells, mean over windows."
    )
    head = ["scene", "predictor", *(f"T={t}" for t in o.steps), f"ray-traced, T={o.steps[-1]}"]
    return [Table(title, [*head, "GoF", "90 % cover"], rows)]
