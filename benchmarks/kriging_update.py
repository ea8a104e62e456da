"""How long a Kriging belief takes to learn three more values, against four libraries doing the
same.

    python benchmarks/kriging_update.py [--measured 600] [--new 3] [--side 96] [--rounds 15]

The task: a map of side × side cells, v exact measurements taken in, n more arrive; give mean and
variance at every cell. Covariance and mean are fixed and the same for all; nothing is fitted. All
methods take turns within every round, so that whatever else the machine does falls on all of them
alike; the table gives medians over the rounds. Before timing, every answer is compared with ours.
The libraries:

- PyKrige: ordinary Kriging (it has no simple Kriging), which solves all v + n equations anew;
- GSTools: simple Kriging, the same;
- scikit-learn: GaussianProcessRegressor without optimiser, the same;
- GPyTorch, anew: an exact GP conditioned on all v + n values;
- GPyTorch, growing: ``get_fantasy_model`` on a model that has the v values in its caches, then the
  map.

Prints the table and writes it to benchmarks/results/kriging_update.md and .json.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from skygain.city import City
from skygain.grid import Grid
from skygain.measurements import Measurements
from skygain.predictors.kriging.known_source import blind_kriging
from skygain.predictors.kriging.parameters import KrigingParameters
from skygain.scenario import Scenario

MEAN_DB, SILL_DB2, RANGE_M = -110.0, 380.0, 57.0
Answer = tuple[np.ndarray, np.ndarray]


def skygain(grid: Grid, cells: np.ndarray, gain: np.ndarray, new: int) -> Callable[[], Answer]:
    parameters = KrigingParameters.known_trend(MEAN_DB, sill_db2=SILL_DB2, range_m=RANGE_M)
    belief = blind_kriging(parameters=parameters, refit=False).begin(
        Scenario(City(grid, np.zeros(grid.shape)))
    )
    belief = belief.updated(Measurements.at(cells[:-new], gain[:-new]))
    belief.posterior()
    more = Measurements.at(cells[-new:], gain[-new:])

    def update() -> Answer:
        posterior = belief.updated(more).posterior()
        return posterior.mean_db, posterior.variance_db2

    return update


def pykrige(grid: Grid, cells: np.ndarray, gain: np.ndarray, new: int) -> Callable[[], Answer]:
    from pykrige.ok import OrdinaryKriging

    x, y = grid.xy_m(cells).T
    parameters = {"psill": SILL_DB2, "range": 3 * RANGE_M, "nugget": 0.0}

    def update() -> Answer:
        model = OrdinaryKriging(
            x, y, gain, variogram_model="exponential", variogram_parameters=parameters
        )
        mean, variance = model.execute("grid", grid.x_m, grid.y_m, backend="vectorized")
        return np.asarray(mean), np.asarray(variance)

    return update


def gstools(grid: Grid, cells: np.ndarray, gain: np.ndarray, new: int) -> Callable[[], Answer]:
    import gstools as gs

    xy = grid.xy_m(cells).T

    def update() -> Answer:
        model = gs.Exponential(dim=2, var=SILL_DB2, len_scale=RANGE_M)
        mean, variance = gs.krige.Simple(model, xy, gain, mean=MEAN_DB).structured(
            [grid.x_m, grid.y_m]
        )
        return mean.T, variance.T

    return update


def scikit_learn(grid: Grid, cells: np.ndarray, gain: np.ndarray, new: int) -> Callable[[], Answer]:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern

    xy, everywhere = grid.xy_m(cells), grid.xy_m(grid.cells)
    kernel = ConstantKernel(SILL_DB2, "fixed") * Matern(RANGE_M, "fixed", nu=0.5)

    def update() -> Answer:
        model = GaussianProcessRegressor(kernel, alpha=1e-9, optimizer=None).fit(xy, gain - MEAN_DB)
        mean, std = model.predict(everywhere, return_std=True)
        return (mean + MEAN_DB).reshape(grid.shape), (std**2).reshape(grid.shape)

    return update


def _gpytorch_model(xy: Any, gain: Any) -> Any:
    import gpytorch
    import torch

    class Model(gpytorch.models.ExactGP):  # type: ignore[misc]
        def __init__(self, x: Any, y: Any) -> None:
            super().__init__(
                x,
                y,
                gpytorch.likelihoods.GaussianLikelihood(
                    noise_constraint=gpytorch.constraints.GreaterThan(1e-9)
                ),
            )
            self.mean_module = gpytorch.means.ConstantMean()
            self.covar_module = gpytorch.kernels.ScaleKernel(gpytorch.kernels.MaternKernel(nu=0.5))

        def forward(self, x: Any) -> Any:
            return gpytorch.distributions.MultivariateNormal(
                self.mean_module(x), self.covar_module(x)
            )

    model = Model(xy, gain).double()
    model.likelihood.noise = 1e-6
    model.mean_module.initialize(constant=MEAN_DB)
    model.covar_module.outputscale = SILL_DB2
    model.covar_module.base_kernel.lengthscale = RANGE_M
    model.requires_grad_(False)
    torch.set_num_threads(os.cpu_count() or 1)
    return model.eval()


def _gpytorch_map(model: Any, everywhere: Any, grid: Grid) -> Answer:
    import gpytorch
    import torch

    # Exact factors (no Lanczos, no conjugate gradients), and the cached variance that the library
    # advertises as fast.
    with (
        torch.no_grad(),
        gpytorch.settings.fast_pred_var(),
        gpytorch.settings.fast_computations(False, False, False),
    ):
        answer = model(everywhere)
        return answer.mean.numpy().reshape(grid.shape), answer.variance.numpy().reshape(grid.shape)


def gpytorch_anew(
    grid: Grid, cells: np.ndarray, gain: np.ndarray, new: int
) -> Callable[[], Answer]:
    import torch

    xy, everywhere, values = (
        torch.as_tensor(a) for a in (grid.xy_m(cells), grid.xy_m(grid.cells), gain)
    )

    def update() -> Answer:
        return _gpytorch_map(_gpytorch_model(xy, values), everywhere, grid)

    return update


def gpytorch_growing(
    grid: Grid, cells: np.ndarray, gain: np.ndarray, new: int
) -> Callable[[], Answer]:
    import gpytorch
    import torch

    xy, everywhere, values = (
        torch.as_tensor(a) for a in (grid.xy_m(cells), grid.xy_m(grid.cells), gain)
    )
    model = _gpytorch_model(xy[:-new], values[:-new])
    _gpytorch_map(model, everywhere, grid)

    def update() -> Answer:
        with (
            torch.no_grad(),
            gpytorch.settings.fast_pred_var(),
            gpytorch.settings.fast_computations(False, False, False),
        ):
            grown = model.get_fantasy_model(xy[-new:], values[-new:])
        return _gpytorch_map(grown, everywhere, grid)

    return update


METHODS = {
    "skygain": skygain,
    "PyKrige": pykrige,
    "GSTools": gstools,
    "scikit-learn": scikit_learn,
    "GPyTorch, anew": gpytorch_anew,
    "GPyTorch, growing": gpytorch_growing,
}


def run(measured: int, new: int, side: int, rounds: int, seed: int = 0) -> dict[str, Any]:
    """Times in milliseconds ``{method: [per round]}``, differences from our answer, and what could
    not run."""
    rng = np.random.default_rng(seed)
    grid = Grid((side, side), 4.0)
    cells = rng.permutation(grid.cells)[: measured + new]
    distance = np.linalg.norm(grid.xy_m(cells)[:, None] - grid.xy_m(cells)[None], axis=-1)
    root = np.linalg.cholesky(SILL_DB2 * np.exp(-distance / RANGE_M) + 1e-9 * np.eye(len(cells)))
    gain = MEAN_DB + root @ rng.standard_normal(len(cells))
    free = np.ones(grid.shape, dtype=bool)
    free[tuple(cells.T)] = False

    updates: dict[str, Callable[[], Answer]] = {}
    skipped: dict[str, str] = {}
    difference: dict[str, list[float]] = {}
    ours: Answer | None = None
    for name, build in METHODS.items():
        try:
            updates[name] = build(grid, cells, gain, new)
            answer = updates[name]()
        except ImportError as error:
            skipped[name] = str(error)
            updates.pop(name, None)
            continue
        ours = ours or answer
        difference[name] = [
            float(np.abs(a - b)[free].max()) for a, b in zip(ours, answer, strict=True)
        ]
    times: dict[str, list[float]] = {name: [] for name in updates}
    for _ in range(rounds):
        for name, update in updates.items():
            start = time.perf_counter()
            update()
            times[name].append(1e3 * (time.perf_counter() - start))
    return {"times_ms": times, "difference": difference, "skipped": skipped}


def markdown(result: dict[str, Any]) -> str:
    """The table."""
    times = {name: np.asarray(values) for name, values in result["times_ms"].items()}
    ours = times["skygain"]
    task = result["task"]
    lines = [
        f"# Kriging: {task['new']} new values on {task['measured']} measured, {task['side']} × "
        f"{task['side']} cells",
        "",
        f"{result['machine']}; {task['rounds']} rounds, all methods in turn; load average "
        f"{result['load_average']:.1f} at the end.",
        "",
        "| method | median ms | best ms | times ours (median of the rounds' ratios) | largest "
        "difference: mean, dB | variance, dB² |",
        "|---|---|---|---|---|---|",
    ]
    for name, values in times.items():
        mean, variance = result["difference"][name]
        lines.append(
            f"| {name} | {np.median(values):.2f} | {values.min():.2f} | "
            f"{np.median(values / ours):.1f} | {mean:.1e} | {variance:.1e} |"
        )
    lines += [
        f"| {name} | not installed: {reason} | | | | |"
        for name, reason in result["skipped"].items()
    ]
    rivals = {name: np.median(values / ours) for name, values in times.items() if name != "skygain"}
    fastest = min(rivals, key=rivals.__getitem__)
    lines += ["", f"The fastest of the others is {fastest}: {rivals[fastest]:.1f} times our time."]
    lines += [
        "PyKrige solves ordinary Kriging, whose mean is estimated, so its answer differs a little."
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--measured", type=int, default=600)
    parser.add_argument("--new", type=int, default=3)
    parser.add_argument("--side", type=int, default=96)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    result = run(options.measured, options.new, options.side, options.rounds)
    result["task"] = {k: getattr(options, k) for k in ("measured", "new", "side", "rounds")}
    result["machine"] = (
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    result["load_average"] = os.getloadavg()[0]
    text = markdown(result)
    print(text)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "kriging_update.md").write_text(text, encoding="utf-8")
    (options.out / "kriging_update.json").write_text(
        json.dumps(result, indent=1) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
