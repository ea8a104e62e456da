"""The propagation operator with the transmitter known and no measurement, by altitude, on training
cities and on others.

    python benchmarks/operator_scores.py DATA.zarr.zip --windows 256

draws random windows of every split but the test cities (T1 trained the network, T2 and T3 did not)
and writes RMSE, that on ray-traced cells and on the rest, likelihood, goodness of fit and cover to
benchmarks/results/operator_scores.md. Scores on T1 far below those on T2 would say that the network
knows its training cities by heart.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from skygain.ground.errors import InputError
from skygain.networks.operator.network import PropagationOperator
from skygain.networks.weights import load_network
from skygain.training.tasks.base import OperatorTask
from skygain.training.train import native_autocast

SPLITS = ("T1", "T2", "T3")
ALTITUDES_M = (10.0, 20.0, 30.0)
COLUMNS = ("rmse_db", "rmse_traced_db", "rmse_rest_db", "nll", "gof", "cover90")
AT_ONCE = 32


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--weights", default="operator")
    parser.add_argument("--windows", default=256, type=int)
    options = parser.parse_args()
    network = PropagationOperator()
    load_network(network, options.weights)
    lines = [
        f"{options.windows} random windows each, transmitter known, no measurement.",
        "",
        "| split | altitude | RMSE dB | ray-traced | rest | NLL | GoF | 90 % cover |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for split in SPLITS:
        for k, altitude in enumerate(ALTITUDES_M):
            task = OperatorTask(altitude_odds=tuple(float(i == k) for i in range(len(ALTITUDES_M))))  # type: ignore[arg-type]
            links = task.load(options.data, split, print)
            try:
                batches = [
                    task.batch(links, AT_ONCE, np.random.default_rng([5, part]), augment=False)
                    for part in range(-(-options.windows // AT_ONCE))
                ]
            except InputError:  # the split has no maps at this altitude
                continue
            scores = task.scores(network, batches, native_autocast(True))
            rmse, traced, rest, nll, fit, cover = (
                scores[f"{name}@{altitude:g}"] for name in COLUMNS
            )
            lines.append(
                f"| {split} | {altitude:g} m | {rmse:.2f} | {traced:.2f} | {rest:.2f} | {nll:.3f} "
                f"| {fit:+.2f} | {100 * cover:.1f} % |"
            )
            print(lines[-1], flush=True)
    (Path(__file__).parent / "results" / "operator_scores.md").write_text(
        "\n".join(lines) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
