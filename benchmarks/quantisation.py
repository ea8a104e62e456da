"""What storing the dense layers in few bits, and answering in bfloat16, costs the paper's U-Nets.

    python benchmarks/quantisation.py DATA.zarr.zip --checkpoint RUN/checkpoint.safetensors
    --windows 512

scores one run's weights on random windows of T2 (random waypoints, three UAVs, as in training): as
they were trained (single precision), as they ship (dense layers in 8 and in 4 bits, the rest in
half precision), and as the predictor uses them (also answering in bfloat16). Table:
benchmarks/results/quantisation.md.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
from pathlib import Path

import numpy as np
import torch

from skygain.datasets.links import load_links
from skygain.networks.weights import export_weights, load_network, runs_folder
from skygain.training.recipes import RECIPES
from skygain.training.tasks.base import GainTask


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--recipe", default="paper-unet")
    parser.add_argument(
        "--checkpoint", type=Path, help="by default that of the recipe's run in the user's cache"
    )
    parser.add_argument("--windows", default=512, type=int)
    parser.add_argument(
        "--earlier",
        action="append",
        default=[],
        type=Path,
        help="checkpoint of another run, for comparison",
    )
    options = parser.parse_args()
    checkpoint = options.checkpoint or runs_folder() / options.recipe / "checkpoint.safetensors"
    task = RECIPES[options.recipe].task
    assert isinstance(task, GainTask)
    links = load_links(options.data, "T2")
    batches = [
        task.batch(links, 32, np.random.default_rng([7, k]), augment=False)
        for k in range(-(-options.windows // 32))
    ]
    rows: list[tuple[str, float, dict[str, float]]] = []

    def scored(name: str, file: Path, frozen: bool) -> None:
        network = task.network()
        load_network(network, file)
        if frozen:
            network.frozen()  # type: ignore[operator]
        else:
            network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        scores = task.scores(network, batches, contextlib.nullcontext)
        rows.append((name, file.stat().st_size / 1e6, scores))
        print(name, scores, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        scored("as trained, single precision", checkpoint, frozen=False)
        for bits in (8, 4):
            file = Path(folder) / f"{bits}.safetensors"
            export_weights(checkpoint, file, {"name": options.recipe}, bits)
            scored(f"dense layers in {bits} bits", file, frozen=False)
            scored(f"dense layers in {bits} bits, answering in bfloat16", file, frozen=True)
    for file in options.earlier:
        scored(f"run {file.parent.name}, single precision", file, frozen=False)
    key = next(k for k in rows[0][2] if k.startswith("rmse_db@")).removeprefix("rmse_db@")
    base = rows[0][2][f"rmse_db@{key}"]
    lines = [
        f"{options.recipe}, {32 * len(batches)} windows of T2 at {key} m. The first file holds "
        "optimiser and running state too.",
        "",
        "| weights | file, MB | RMSE dB | change | NLL |",
        "|---|---|---|---|---|",
    ]
    for name, size, scores in rows:
        rmse = scores[f"rmse_db@{key}"]
        lines.append(
            f"| {name} | {size:.1f} | {rmse:.3f} | {rmse - base:+.3f} | {scores[f'nll@{key}']:.4f} "
            "|"
        )
    (Path(__file__).parent / "results" / "quantisation.md").write_text(
        "\n".join(lines) + "\n", encoding="utf-8"
    )
    print("\n" + "\n".join(lines))


if __name__ == "__main__":
    main()
