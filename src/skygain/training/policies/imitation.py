"""Imitation of a planner that looks ahead, in rounds of DAgger.

Round 0 watches the expert from random states; round r > 0 watches it from the states that the
learner of round r − 1 gets into. After each round the network is trained on all demonstrations so
far by the cross entropy of the expert's move among the legal ones, each batch under a random
symmetry of the square. One network serves any number of UAVs.

Flights are files, one per survey, so that a killed run loses at most the surveys under way;
training from one checkpoint to the next draws batch k of round r from the stream (seed, r, k).
"""

from __future__ import annotations

__all__ = ["ImitationConfig", "ImitationResult", "expert_loss", "train_imitation"]

import json
import time
from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from skygain.environments.worlds import LinkWorlds
from skygain.ground.executor import process_pool
from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.policies.inputs import SYMMETRIES, turned_moves
from skygain.networks.policies.network import policy_network
from skygain.networks.policies.planes import action_masks
from skygain.networks.policies.weights import export_policy
from skygain.planners.learned import PolicyPlanner
from skygain.training.policies.demonstrations import (
    DemonstrationConfig,
    Demonstrations,
    fly_demonstration,
)
from skygain.training.run import optimiser_tensors, restore_optimiser, under

SHAPE = {"network": "centred", "atoms": 1, "side": 0, "dueling": False}


@dataclass(frozen=True)
class ImitationConfig:
    """One run."""

    data: str = "sample"
    """path of the data set"""
    out: str = ""
    """folder of the run: demonstrations/, checkpoint.safetensors, policy-ROUND.safetensors,
    log.jsonl, config.json"""
    predictors: tuple[str, ...] = ("paper-unet", "paper-unet", "operator", "kriging")
    """predictor texts whose beliefs are flown on, in turn"""
    expert: str = "sequential-greedy"
    """planner text of the expert"""
    split: str = "T1"
    """split to fly in"""
    start: str = "mixed"
    """kind of start"""
    side: int = 96
    """cells along the edge of the map"""
    steps: int = 200
    """T"""
    surveys: tuple[int, ...] = (40, 32)
    """surveys flown in each round"""
    updates: tuple[int, ...] = (500, 1200)
    """of the network in each round"""
    held_out: int = 4
    """surveys of each round that are not trained on but scored"""
    batch_size: int = 256
    """moves per update"""
    learning_rate: float = 1e-3
    """of AdamW at the beginning of each round; falls to nothing by a cosine"""
    weight_decay: float = 1e-2
    """decoupled weight decay"""
    workers: int = 2
    """processes that fly"""
    seed: int = 0
    """of everything"""
    max_seconds: float = float("inf")
    """stop this call after so long; the run continues with the next call"""
    checkpoint_steps: int = 250
    """updates between checkpoints and lines of the log"""


@dataclass(frozen=True)
class ImitationResult:
    """Where a run stands."""

    round: int
    """rounds finished"""
    step: int
    """updates in all"""
    seconds: float
    """training and flying, over every call"""
    scores: dict[str, float]
    """cross entropy and share of the expert's moves that the policy makes, on held-out surveys"""
    checkpoint: Path
    """file with everything"""


def train_imitation(
    config: ImitationConfig, report: Callable[[dict[str, Any]], None] = lambda record: None
) -> ImitationResult:
    """Watch and learn until all rounds are done or ``max_seconds`` have passed."""
    folder = Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "checkpoint.safetensors"
    torch.manual_seed(config.seed)
    network = policy_network(SHAPE)
    optimiser = torch.optim.AdamW(
        network.parameters(), config.learning_rate, weight_decay=config.weight_decay
    )
    round_, step, total, seconds, scores = 0, 0, 0, 0.0, {}
    if path.exists():
        tensors, meta = load_checkpoint(path)
        round_, step, total, seconds, scores = (
            meta[k] for k in ("round", "step_in_round", "step", "seconds", "scores")
        )
        network.load_state_dict(under("network.", tensors))
        restore_optimiser(optimiser, under("optimiser.", tensors))
    (folder / "config.json").write_text(json.dumps(asdict(config), indent=2, default=str))
    begun, earlier, threads = time.monotonic(), seconds, torch.get_num_threads()
    torch.set_num_threads(1)  # the network is so small that threads would only wait for each other

    def spent() -> float:
        return earlier + time.monotonic() - begun

    def save() -> None:
        tensors = {f"network.{k}": v for k, v in network.state_dict().items()}
        tensors |= {f"optimiser.{k}": v for k, v in optimiser_tensors(optimiser).items()}
        meta = {
            "round": round_,
            "step_in_round": step,
            "step": total,
            "seconds": spent(),
            "scores": scores,
        }
        save_checkpoint(
            path, tensors, {**meta, "config": json.loads(json.dumps(asdict(config), default=str))}
        )

    def say(**values: Any) -> None:
        line = {"round": round_, "step": total, "seconds": round(spent(), 1), **values}
        with (folder / "log.jsonl").open("a") as log:
            log.write(json.dumps(line) + "\n")
        report(line)

    while round_ < len(config.surveys) and time.monotonic() - begun < config.max_seconds:
        learner = None if round_ == 0 else folder / f"policy-{round_ - 1}.safetensors"
        deadline = begun + config.max_seconds
        if not _fly_round(
            config, round_, learner, deadline, lambda done, of: say(flown=done, surveys=of)
        ):
            break
        files = [sorted((folder / "demonstrations").glob(f"{r}-*.npz")) for r in range(round_ + 1)]
        trained = Demonstrations.load([f for part in files for f in part[config.held_out :]])
        held_out = Demonstrations.load([f for part in files for f in part[: config.held_out]])
        steps = config.updates[round_]
        network.train()
        losses = []
        while step < steps and time.monotonic() - begun < config.max_seconds:
            for group in optimiser.param_groups:
                group["lr"] = config.learning_rate * 0.5 * (1 + np.cos(np.pi * step / steps))
            rng = np.random.default_rng([config.seed, round_, step])
            loss, _ = expert_loss(
                network, trained, rng, config.batch_size, int(rng.integers(SYMMETRIES))
            )
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            losses.append(float(loss.detach()))
            step, total = step + 1, total + 1
            if step % config.checkpoint_steps == 0 or step == steps:
                scores = _held_out(network, held_out)
                say(loss=round(float(np.mean(losses)), 4), **scores)
                losses.clear()
                save()
        if step < steps:
            break
        card = {"name": f"imitation, round {round_}", "policy": SHAPE, "scores": scores}
        export_policy(network.state_dict(), folder / f"policy-{round_}.safetensors", card)
        round_, step = round_ + 1, 0
        save()
    torch.set_num_threads(threads)
    return ImitationResult(round_, total, spent(), scores, path)


def expert_loss(
    network: nn.Module,
    demonstrations: Demonstrations,
    rng: np.random.Generator,
    size: int,
    symmetry: int = 0,
    preference: Callable[[Tensor], Tensor] = lambda logits: logits[..., 0],
) -> tuple[Tensor, Tensor]:
    """Cross entropy of the expert's moves among the legal ones, and the share of them that the
    network makes too.

    ``size`` pairs are drawn and turned by ``symmetry``; ``preference`` makes logits of moves of
    ``[sample, move, atom]``.
    """
    seen, moves = demonstrations.sample(rng, size)
    turned = turned_moves(symmetry)
    legal = action_masks(seen.flyable, seen.cells.clip(min=0))[np.arange(size), seen.uav][
        :, np.argsort(turned)
    ]
    logits = preference(network(*network.inputs(seen, symmetry)))  # type: ignore[operator]
    logits = logits.masked_fill(~torch.from_numpy(legal), -1e9)
    target = torch.from_numpy(turned[moves])
    return F.cross_entropy(logits, target), (logits.argmax(dim=1) == target).float().mean()


def _held_out(network: nn.Module, demonstrations: Demonstrations) -> dict[str, float]:
    network.eval()
    with torch.inference_mode():
        parts = [
            expert_loss(network, demonstrations, np.random.default_rng([2**32 - 1, k]), 256)
            for k in range(8)
        ]
    network.train()
    loss, agreed = (float(torch.stack([p[i] for p in parts]).mean()) for i in range(2))
    return {"held_out_loss": round(loss, 4), "agreement": round(agreed, 4)}


def _fly_round(
    config: ImitationConfig,
    round_: int,
    learner: Path | None,
    deadline: float,
    report: Callable[[int, int], None],
) -> bool:
    """Fly what is missing of a round; whether all of it is there."""
    folder = Path(config.out) / "demonstrations"
    folder.mkdir(exist_ok=True)
    worlds = LinkWorlds(config.data, config.split, start=config.start, side=config.side)
    how = DemonstrationConfig(worlds, config.predictors, config.expert, steps=config.steps)
    count = config.surveys[round_]
    paths = {k: folder / f"{round_}-{k:05d}.npz" for k in range(count)}
    missing = [k for k, path in paths.items() if not path.exists()]
    done = count - len(missing)
    if not missing:
        return True
    if config.workers <= 1:
        for k in missing:
            if time.monotonic() > deadline:
                return False
            _fly_one(how, learner, (config.seed, round_, k), paths[k])
        return True
    with process_pool(config.workers) as pool:
        futures = [
            pool.submit(_fly_one, how, learner, (config.seed, round_, k), paths[k]) for k in missing
        ]
        for future in as_completed(futures):
            future.result()
            done += 1
            if done % 10 == 0 or done == count:
                report(done, count)
            if time.monotonic() > deadline:
                return done == count
    return True


_learners: dict[Path, PolicyPlanner] = {}


def _fly_one(
    how: DemonstrationConfig, learner: Path | None, seed: tuple[int, ...], path: Path
) -> None:
    """One survey, in a worker process."""
    pilot = (
        None
        if learner is None
        else _learners.setdefault(learner, PolicyPlanner(learner, symmetries=1))
    )
    fly_demonstration(how, pilot, seed, path)
