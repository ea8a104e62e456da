"""Trained networks by themselves: scores by split, how errors go together, what files cost."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.record import Table
from benchmarks.study import Option, Run, study
from skygain.datasets.links import load_links
from skygain.fields.residual_field import CorrelationModel
from skygain.ground.errors import InputError
from skygain.networks.processor import bf16_instructions
from skygain.networks.torch_runtime import load_network
from skygain.networks.weights import export_weights, runs_folder

ALTITUDES_M = (10.0, 20.0, 30.0)
OFFSETS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
COLUMNS = ("rmse_db", "rmse_traced_db", "rmse_rest_db", "nll", "gof", "cover90")
AT_ONCE = 32


@study(
    "operator_scores",
    data="DATA",
    weights=Option("operator", "weights"),
    windows=Option(256, "random windows of each split and altitude"),
)
def operator_scores(run: Run) -> list[Table]:
    """The operator with the transmitter known and no measurement, on training cities and others.

    T1 trained the network, T2 and T3 did not. Scores on T1 far below those on T2 would say that the
    network knows its training cities by heart.
    """
    from skygain.networks.operator.network import PropagationOperator
    from skygain.training.compute import autocast
    from skygain.training.tasks.base import OperatorTask

    o = run.options
    network = PropagationOperator()
    load_network(network, o.weights)

    def scores(split: str, k: int) -> list[float] | None:
        task = OperatorTask(altitude_odds=tuple(float(i == k) for i in range(len(ALTITUDES_M))))  # type: ignore[arg-type]
        links = task.load(run.data, split, print)
        try:
            batches = [
                task.batch(links, AT_ONCE, np.random.default_rng([5, n]), augment=False)
                for n in range(-(-o.windows // AT_ONCE))
            ]
        except InputError:  # the split has no maps at this altitude
            return None
        found = task.scores(network, batches, autocast(True))
        return [found[f"{name}@{ALTITUDES_M[k]:g}"] for name in COLUMNS]

    rows = []
    for split in ("T1", "T2", "T3"):
        for k, altitude in enumerate(ALTITUDES_M):
            key = (o.weights, o.windows, split, altitude)
            if found := run.once(key, lambda s=split, k=k: scores(s, k)):
                rmse, (nll, fit, cover) = [f"{v:.2f}" for v in found[:3]], found[3:]
                rows.append(
                    [
                        split,
                        f"{altitude:g} m",
                        *rmse,
                        f"{nll:.3f}",
                        f"{fit:+.2f}",
                        f"{100 * cover:.1f} %",
                    ]
                )
    head = ["split", "altitude", "RMSE dB", "ray-traced", "rest", "NLL", "GoF", "90 % cover"]
    title = f"{o.windows} random windows each, transmitter known, no measurement."
    return [Table(title, head, rows)]


@study(
    "residual_correlation",
    data="DATA",
    weights=Option("operator", "weights"),
    windows=Option(64, "random windows of T2"),
)
def residual_correlation(run: Run) -> list[Table]:
    """How the operator's standardised residual correlates over distance, beside the model in use.

    Of (y − m)/s, cut at ±4, along rows and columns, with the transmitter known, at 10 m.
    """
    import torch

    from skygain.networks.operator.network import PropagationOperator
    from skygain.training.tasks.base import OperatorTask

    o = run.options
    network = PropagationOperator()
    load_network(network, o.weights)
    task = OperatorTask(altitude_odds=(1.0, 0.0, 0.0))
    links = load_links(run.data, "T2")
    batch = task.batch(links, o.windows, np.random.default_rng(3), augment=False)
    with torch.inference_mode():
        parts = [network(inputs) for inputs in batch["inputs"].split(8)]
    mean, log_variance = (torch.cat(p).numpy() for p in zip(*parts, strict=True))
    mask = batch["mask"].numpy()
    z = np.clip((batch["truth"].numpy() - mean) * np.exp(-0.5 * log_variance), -4, 4) * mask
    variance = (z[mask] ** 2).mean()
    rows = []
    for d in OFFSETS:
        along = (z[:, d:] * z[:, :-d]).sum() / (mask[:, d:] & mask[:, :-d]).sum()
        across = (z[:, :, d:] * z[:, :, :-d]).sum() / (mask[:, :, d:] & mask[:, :, :-d]).sum()
        model = float(CorrelationModel().correlation(np.array(4.0 * d)))
        rows.append([f"{4 * d}", f"{(along + across) / 2 / variance:.2f}", f"{model:.2f}"])
    title = f"{o.windows} windows of T2, 10 m, transmitter known."
    return [Table(title, ["distance, m", "measured", "model"], rows)]


@study(
    "quantisation",
    data="DATA",
    recipe=Option("paper-unet", "recipe whose run is looked at"),
    windows=Option(512, "random windows of T2"),
    earlier=Option((), "checkpoints of other runs, for comparison"),
)
def quantisation(run: Run) -> list[Table]:
    """What storing dense layers in few bits, and answering in bfloat16, costs the paper's U-Nets.

    Random waypoints, three UAVs, as in training. The checkpoint is that of the recipe's run in the
    user's cache.
    """
    import torch

    from skygain.training.recipes import RECIPES
    from skygain.training.tasks.base import GainTask

    o = run.options
    checkpoint = runs_folder() / o.recipe / "checkpoint.safetensors"
    task = RECIPES[o.recipe].task
    assert isinstance(task, GainTask)
    links = load_links(run.data, "T2")
    batches = [
        task.batch(links, AT_ONCE, np.random.default_rng([7, k]), augment=False)
        for k in range(-(-o.windows // AT_ONCE))
    ]

    def scores(file: Path, frozen: bool) -> dict[str, float]:
        network = task.network()
        load_network(network, file)
        if frozen:
            network.frozen(torch.bfloat16 if bf16_instructions() else torch.float32)  # type: ignore[operator]
        else:
            network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return task.scores(network, batches, contextlib.nullcontext)

    def files(folder: Path) -> Iterator[tuple[str, Path, bool]]:
        yield "as trained, single precision", checkpoint, False
        for bits in (8, 4):
            file = folder / f"{bits}.safetensors"
            export_weights(checkpoint, file, {"name": o.recipe}, bits)
            yield f"dense layers in {bits} bits", file, False
            yield f"dense layers in {bits} bits, answering in bfloat16", file, True
        for file in map(Path, o.earlier):
            yield f"run {file.parent.name}, single precision", file, False

    with tempfile.TemporaryDirectory() as folder:
        found = [(n, f.stat().st_size / 1e6, scores(f, z)) for n, f, z in files(Path(folder))]
    key = next(k for k in found[0][2] if k.startswith("rmse_db@")).removeprefix("rmse_db@")
    base = found[0][2][f"rmse_db@{key}"]
    rows = [
        [
            name,
            f"{size:.1f}",
            f"{each[f'rmse_db@{key}']:.3f}",
            f"{each[f'rmse_db@{key}'] - base:+.3f}",
            f"{each[f'nll@{key}']:.4f}",
        ]
        for name, size, each in found
    ]
    title = (
        f"{o.recipe}, {AT_ONCE * len(batches)} windows of T2 at {key} m. The first file holds "
        "optimiser and running state too."
    )
    return [Table(title, ["weights", "file, MB", "RMSE dB", "change", "NLL"], rows)]


@study(
    "policy_quantisation",
    runs=Option(("dqn", "paper-dqn"), "runs whose checkpoints lie in the user's cache"),
    demonstrations=Option("imitation", "run whose demonstrations give the states"),
    states=Option(2048, "states"),
)
def policy_quantisation(run: Run) -> list[Table]:
    """Whether a policy's weight file decides as the network that was trained does.

    In the file, dense layers of more than a million weights have 8 bits and the rest half
    precision.
    """
    import torch

    from skygain.networks.policies.network import policy_network
    from skygain.networks.policies.planes import action_masks
    from skygain.networks.policies.weights import export_policy
    from skygain.networks.torch_runtime import load_policy
    from skygain.training.checkpoints import load_checkpoint
    from skygain.training.policies.c51 import expected, masked_argmax, support
    from skygain.training.policies.demonstrations import Demonstrations
    from skygain.training.run import under

    o = run.options
    kept = runs_folder() / o.demonstrations / "demonstrations"
    flights = Demonstrations.load(sorted(kept.glob("*.npz")))
    rows = []
    for name in o.runs:
        tensors, meta = load_checkpoint(runs_folder() / name / "checkpoint.safetensors")
        wanted = ("network", "atoms", "side", "dueling", "v_min", "v_max")
        shape = {key: meta["config"][key] for key in wanted}
        trained = policy_network(shape).eval()
        trained.load_state_dict(under("network.", tensors))
        z = support(shape["v_min"], shape["v_max"], shape["atoms"])
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "policy.safetensors"
            export_policy(under("network.", tensors), file, {"policy": shape})
            size, shipped = file.stat().st_size / 1e6, load_policy(file)
        same = total = 0
        for k in range(-(-o.states // 64)):
            seen, _ = flights.sample(np.random.default_rng([11, k]), 64)
            masks = action_masks(seen.flyable, seen.cells.clip(min=0))
            legal = torch.from_numpy(masks[np.arange(64), seen.uav])
            with torch.inference_mode():
                one, other = (
                    masked_argmax(expected(net(*net.inputs(seen)), z), legal)
                    for net in (trained, shipped)
                )
            same, total = same + int((one == other).sum()), total + 64
        weights = sum(p.numel() for p in trained.parameters())
        rows.append(
            [
                f"{name}, {meta['updates']:,} updates",
                f"{weights:,}",
                f"{size:.1f} MB",
                f"{100 * same / total:.2f} % of {total:,}",
            ]
        )
    return [Table("", ["run", "weights", "file", "equal decisions"], rows)]
