"""Imitation of a planner that looks ahead, in rounds of DAgger.

Round 0 watches the expert from random states; round r > 0 watches it from the states that the
learner of round r − 1 gets into. After each round the network is trained on all demonstrations so
far by the cross entropy of the expert's move among the legal ones, each batch under a random
symmetry of the square. One network serves any number of UAVs.

Flights are files, one per survey, so that a killed run loses at most the surveys under way;
training from one checkpoint to the next draws batch k of round r from the stream (seed, r, k).
"""

from __future__ import annotations

__all__ = ["ImitationConfig", "expert_loss", "train_imitation"]

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from skygain.environments.worlds import LinkWorlds
from skygain.grid import SYMMETRIES
from skygain.ground.executor import units
from skygain.networks.policies.inputs import turned_moves
from skygain.networks.policies.network import policy_network
from skygain.networks.policies.planes import action_masks
from skygain.networks.policies.weights import export_policy
from skygain.planners.learned import PolicyPlanner
from skygain.training.compute import threads
from skygain.training.policies.demonstrations import (
    DemonstrationConfig,
    Demonstrations,
    fly_demonstration,
)
from skygain.training.run import Part, Report, Result, Run, set_rate

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
    cluster: str = ""
    """a Dask cluster that flies instead"""
    seed: int = 0
    """of everything"""
    max_seconds: float = float("inf")
    """stop this call after so long; the run continues with the next call"""
    checkpoint_steps: int = 250
    """updates between checkpoints and lines of the log"""


def train_imitation(config: ImitationConfig, report: Report = lambda record: None) -> Result:
    """Watch and learn until all rounds are done or ``max_seconds`` have passed."""
    torch.manual_seed(config.seed)
    network = policy_network(SHAPE)
    optimiser = torch.optim.AdamW(network.parameters(), weight_decay=config.weight_decay)
    parts: dict[str, Part] = {"network": network, "optimiser": optimiser}
    run = Run(config.out, config, parts, report, round=0, step_in_round=0)
    with threads(1):  # the network is small
        while run.state["round"] < len(config.surveys) and not run.over:
            if not _fly_round(config, run) or not _train_round(config, run, network, optimiser):
                break
            card = {
                "name": f"imitation, round {run.state['round']}",
                "policy": SHAPE,
                "scores": run.scores,
            }
            export_policy(network.state_dict(), _policy(run, run.state["round"]), card)
            run.state = {"round": run.state["round"] + 1, "step_in_round": 0}
            run.save()
    return run.result(run.step * config.batch_size)


def _policy(run: Run, round_: int) -> Path:
    """The weight file of the policy after ``round_``."""
    return run.folder / f"policy-{round_}.safetensors"


def _train_round(
    config: ImitationConfig, run: Run, network: nn.Module, optimiser: torch.optim.Optimizer
) -> bool:
    """Make the updates that a round lacks; whether all of them were made."""
    round_ = run.state["round"]
    files = [sorted((run.folder / "demonstrations").glob(f"{r}-*.npz")) for r in range(round_ + 1)]
    trained = Demonstrations.load([f for part in files for f in part[config.held_out :]])
    held_out = Demonstrations.load([f for part in files for f in part[: config.held_out]])
    network.train()
    losses, steps = [], config.updates[round_]
    while (step := run.state["step_in_round"]) < steps:
        if run.over:
            run.save()
            return False
        set_rate(optimiser, config.learning_rate * 0.5 * (1 + np.cos(np.pi * step / steps)))
        rng = np.random.default_rng([config.seed, round_, step])
        loss, _ = expert_loss(
            network, trained, rng, config.batch_size, int(rng.integers(SYMMETRIES))
        )
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
        run.step += 1
        run.state["step_in_round"] = step = step + 1
        if step % config.checkpoint_steps == 0 or step == steps:
            run.scores = _held_out(network, held_out)
            run.record(round=round_, loss=round(float(np.mean(losses)), 4), **run.scores)
            losses.clear()
            run.save()
    return True


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


def _fly_round(config: ImitationConfig, run: Run) -> bool:
    """Fly what is missing of a round; whether all of it is there."""
    round_, folder = run.state["round"], run.folder / "demonstrations"
    folder.mkdir(exist_ok=True)
    worlds = LinkWorlds(config.data, config.split, start=config.start, side=config.side)
    how = DemonstrationConfig(worlds, config.predictors, config.expert, steps=config.steps)
    learner = None if round_ == 0 else _policy(run, round_ - 1)
    count = config.surveys[round_]
    jobs = [
        (how, learner, (config.seed, round_, k), path)
        for k in range(count)
        if not (path := folder / f"{round_}-{k:05d}.npz").exists()
    ]
    if config.workers <= 1 and not config.cluster:
        for job in jobs:
            if run.over:
                return False
            _fly_one(*job)
        return True
    done = count - len(jobs)
    with closing(units(_fly_one, jobs, workers=config.workers, cluster=config.cluster)) as flown:
        for _ in flown if jobs else ():
            done += 1
            if done % 10 == 0 or done == count:
                run.record(round=round_, flown=done, surveys=count)
            if run.over:
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
