"""Whether a policy's weight file decides as the network that was trained does.

    python benchmarks/policy_quantisation.py --run paper-dqn --demonstrations imitation

takes the network of a run's checkpoint, exports it (dense layers of more than a million weights in
8 bits, the rest in half precision), and asks both for their best legal move in states that
demonstrations recorded. Prints the size of the file and the share of equal decisions, and adds a
line to benchmarks/results/policy_quantisation.md.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch

from skygain.networks.checkpoints import load_checkpoint
from skygain.networks.policies.network import policy_network
from skygain.networks.policies.planes import action_masks
from skygain.networks.policies.weights import export_policy, load_policy
from skygain.networks.weights import runs_folder
from skygain.training.policies.c51 import expected, masked_argmax, support
from skygain.training.policies.demonstrations import Demonstrations
from skygain.training.run import under


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", default="paper-dqn")
    parser.add_argument("--demonstrations", default="imitation")
    parser.add_argument("--states", default=2048, type=int)
    options = parser.parse_args()
    tensors, meta = load_checkpoint(runs_folder() / options.run / "checkpoint.safetensors")
    shape = {
        key: meta["config"][key]
        for key in ("network", "atoms", "side", "dueling", "v_min", "v_max")
    }
    trained = policy_network(shape).eval()
    trained.load_state_dict(under("network.", tensors))
    z = support(shape["v_min"], shape["v_max"], shape["atoms"])
    flights = Demonstrations.load(
        sorted((runs_folder() / options.demonstrations / "demonstrations").glob("*.npz"))
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.safetensors"
        export_policy(under("network.", tensors), file, {"policy": shape})
        size, (shipped, _) = file.stat().st_size / 1e6, load_policy(file)
    same = total = 0
    for k in range(-(-options.states // 64)):
        seen, _ = flights.sample(np.random.default_rng([11, k]), 64)
        legal = torch.from_numpy(
            action_masks(seen.flyable, seen.cells.clip(min=0))[np.arange(64), seen.uav]
        )
        with torch.inference_mode():
            moves = [
                masked_argmax(expected(net(*net.inputs(seen)), z), legal)
                for net in (trained, shipped)
            ]
        same, total = same + int((moves[0] == moves[1]).sum()), total + 64
    line = (
        f"| {options.run}, {meta['updates']:,} updates | "
        f"{sum(p.numel() for p in trained.parameters()):,} | {size:.1f} MB | "
        f"{100 * same / total:.2f} % of {total:,} |"
    )
    results = Path(__file__).parent / "results" / "policy_quantisation.md"
    head = ["| run | weights | file | equal decisions |", "|---|---|---|---|"]
    kept = (
        [
            row
            for row in results.read_text().splitlines()[2:]
            if not row.startswith(f"| {options.run},")
        ]
        if results.exists()
        else []
    )
    results.write_text("\n".join([*head, *kept, line]) + "\n", encoding="utf-8")
    print(line)


if __name__ == "__main__":
    main()
