"""How the operator's standardised residual correlates over distance: what its Kriging of the
residual rests on.

    python benchmarks/residual_correlation.py DATA.zarr.zip

prints, over 64 random windows of T2 at 10 m with the transmitter known, the correlation of (y −
m)/s (cut at ±4) along rows and columns, beside the model that the predictor uses, and writes
benchmarks/results/residual_correlation.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from skygain.datasets.links import load_links
from skygain.fields.residual_field import CorrelationModel
from skygain.networks.operator.network import PropagationOperator
from skygain.networks.weights import load_network
from skygain.training.tasks.base import OperatorTask

WINDOWS = 64
OFFSETS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--weights", default="operator")
    options = parser.parse_args()
    network = PropagationOperator()
    load_network(network, options.weights)
    task = OperatorTask(altitude_odds=(1.0, 0.0, 0.0))
    batch = task.batch(
        load_links(options.data, "T2"), WINDOWS, np.random.default_rng(3), augment=False
    )
    with torch.inference_mode():
        parts = [network(part) for part in batch["inputs"].split(8)]
    mean, log_variance = (torch.cat(p).numpy() for p in zip(*parts, strict=True))
    mask = batch["mask"].numpy()
    z = np.clip((batch["truth"].numpy() - mean) * np.exp(-0.5 * log_variance), -4, 4) * mask
    variance = (z[mask] ** 2).mean()
    lines = [
        f"{WINDOWS} windows of T2, 10 m, transmitter known.",
        "",
        "| distance, m | measured | model |",
        "|---|---|---|",
    ]
    for d in OFFSETS:
        rows = (z[:, d:] * z[:, :-d]).sum() / (mask[:, d:] & mask[:, :-d]).sum()
        cols = (z[:, :, d:] * z[:, :, :-d]).sum() / (mask[:, :, d:] & mask[:, :, :-d]).sum()
        model = float(CorrelationModel().correlation(np.array(4.0 * d)))
        lines.append(f"| {4 * d} | {(rows + cols) / 2 / variance:.2f} | {model:.2f} |")
    text = "\n".join(lines) + "\n"
    (Path(__file__).parent / "results" / "residual_correlation.md").write_text(
        text, encoding="utf-8"
    )
    print(text)


if __name__ == "__main__":
    main()
