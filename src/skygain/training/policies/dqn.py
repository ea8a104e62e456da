"""Multi-agent distributional Q-learning (paper, sections VI-D and VI-E): one network for all UAVs,
one replay memory.

The run is a function of its settings. Joint step k explores with the stream (seed, 1, k), update k
samples with (seed, 2, k), lane ℓ plays its episode e in the world (seed, ℓ, e), and the checkpoint
holds the networks, the optimiser and the moves of the episodes under way, which are flown again
when the run goes on. So a killed run ends with the same weights, bit for bit, as one left alone.

Deep Q-learning from demonstrations (Hester et al., 2018) is an option: before the first step, and
beside the temporal-difference loss of every update, the network learns to value the move of an
expert most, by the cross entropy of softmax(Q/τ) over the legal moves. Shaped rewards tell good
moves from bad ones so faintly beside the noise of the prediction error that this is what makes
hours enough.
"""

from __future__ import annotations

__all__ = ["DqnConfig", "DqnResult", "train_dqn"]

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from skygain.environments.rewards import RewardConfig
from skygain.environments.surveys import EnvironmentConfig, SurveyBatch
from skygain.environments.worlds import LinkWorlds
from skygain.ground.errors import InputError
from skygain.networks.checkpoints import load_checkpoint, save_checkpoint
from skygain.networks.policies.inputs import Seen, moves_of, turned_moves
from skygain.networks.policies.network import NETWORKS, policy_network
from skygain.networks.policies.weights import policy_file
from skygain.networks.quantised import dequantised
from skygain.networks.weights import runs_folder
from skygain.survey.methods import MethodSpec
from skygain.training.policies.c51 import cross_entropy, expected, masked_argmax, projected, support
from skygain.training.policies.demonstrations import Demonstrations
from skygain.training.policies.imitation import expert_loss
from skygain.training.policies.replay import Replay, ReplayConfig, Transitions
from skygain.training.run import autocast, optimiser_tensors, restore_optimiser, under

Moves = NDArray[np.int64]


@dataclass(frozen=True)
class DqnConfig:
    """One run.

    Raises:
        InputError: an unknown network, or numbers that cannot be.
    """

    data: str = "sample"
    """path of the data set"""
    out: str = ""
    """folder of the run: checkpoint.safetensors, log.jsonl, config.json, replay/; an existing
    checkpoint is continued"""
    predictor: str = "paper-unet"
    """predictor text as in `skygain.survey.methods`; ``+tx`` tells it the transmitter"""
    network: str = "paper"
    """``"paper"`` or ``"centred"``"""
    dueling: bool = False
    """split into value and advantage (centred network only)"""
    double: bool = False
    """the online network chooses the next move, the target network judges it"""
    split: str = "T3"
    """split to fly in"""
    start: str = "cluster"
    """kind of start"""
    side: int = 96
    """cells along the edge of the map"""
    n_uavs: int = 3
    """N"""
    steps: int = 200
    """T"""
    lanes: int = 8
    """surveys flown together"""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """r_e, r_r, γ and whether rewards are shaped"""
    v_min: float = -20.0
    """lower end of the returns' support"""
    v_max: float = 5.0
    """upper end of it"""
    atoms: int = 40
    """N_a"""
    n_steps: int = 5
    """M"""
    exploration: float = 0.03
    """ε; random moves are legal ones"""
    learning_rate: float = 1e-5
    """of Adam"""
    adam_epsilon: float = 1e-8
    """of Adam; the paper gives one for the predictor only"""
    batch_size: int = 256
    """transitions per update"""
    learn_every: int = 4
    """τ_L, joint steps of the batch of surveys between updates"""
    target_every: int = 1000
    """τ_DQN, updates between copies to the target network"""
    warmup: int = 5000
    """transitions in the memory before learning begins"""
    capacity: int = 6_000_000
    """transitions in the memory"""
    augment: bool = False
    """turn and mirror what is sampled, all eight ways at random"""
    bf16: bool = True
    """bfloat16 autocast where the CPU has it"""
    start_from: str = ""
    """name or file of a policy whose tensors, as far as they fit, begin this run"""
    demonstrations: str = ""
    """flights of an expert: the name of an imitation run, or a folder of its demonstrations; none
    if empty"""
    demonstration_weight: float = 0.0
    """λ, of the expert's cross entropy beside the temporal-difference loss"""
    temperature: float = 0.05
    """τ, difference in value that counts as a clear preference"""
    pretraining: int = 0
    """updates on demonstrations alone before the first step, at ten times the learning rate"""
    seed: int = 0
    """of everything"""
    total_steps: int = 1_000_000
    """joint steps per lane after which the run is over"""
    max_seconds: float = float("inf")
    """stop this call after so long"""
    checkpoint_steps: int = 2000
    """joint steps per lane between checkpoints"""
    log_steps: int = 50
    """joint steps per lane between lines of the log"""

    def __post_init__(self) -> None:
        if self.network not in NETWORKS:
            raise InputError(
                f"unknown policy network {self.network!r}; known: {', '.join(NETWORKS)}"
            )
        if (self.pretraining or self.demonstration_weight) and not self.demonstrations:
            raise InputError(
                "learning from demonstrations needs a folder of them; make one with: skygain train "
                "policy --recipe imitation"
            )
        if (
            self.n_steps < 1
            or self.atoms < 2
            or not self.v_min < self.v_max
            or not 0 <= self.exploration <= 1
        ):
            raise InputError(
                "a DQN needs n_steps >= 1, atoms >= 2, v_min < v_max and exploration in 0..1"
            )

    @property
    def environment(self) -> EnvironmentConfig:
        """The kind of episode."""
        return EnvironmentConfig(self.n_uavs, self.steps, self.reward)


@dataclass(frozen=True)
class DqnResult:
    """Where a run stands."""

    step: int
    """joint steps per lane"""
    updates: int
    """of the network"""
    seconds: float
    """over every call"""
    scores: dict[str, float]
    """last line of the log"""
    checkpoint: Path
    """file with everything"""


def _new_network(config: DqnConfig) -> nn.Module:
    """The network of a run, weights from PyTorch's global generator."""
    return policy_network(
        {
            "network": config.network,
            "atoms": config.atoms,
            "side": config.side,
            "dueling": config.dueling,
        }
    )


def train_dqn(
    config: DqnConfig, report: Callable[[dict[str, Any]], None] = lambda record: None
) -> DqnResult:
    """Fly and learn until ``total_steps`` or ``max_seconds``; every log record also goes to
    ``report``."""
    folder = Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "checkpoint.safetensors"
    method = MethodSpec(config.predictor, "")
    worlds = LinkWorlds(config.data, config.split, start=config.start, side=config.side)
    known = config.predictor.endswith("+tx")
    surveys = SurveyBatch(
        worlds,
        method.build_predictor(),
        config.environment,
        config.lanes,
        seed=config.seed,
        transmitter_known=known,
    )
    torch.manual_seed(config.seed)
    online, target = _new_network(config), _new_network(config)
    optimiser = torch.optim.Adam(online.parameters(), config.learning_rate, eps=config.adam_epsilon)
    z = support(config.v_min, config.v_max, config.atoms)
    step, updates, seconds, scores, last = 0, 0, 0.0, {}, np.full(surveys.cells.shape[:2], -1)
    if path.exists():
        tensors, meta = load_checkpoint(path)
        step, updates, seconds, scores = (
            meta["step"],
            meta["updates"],
            meta["seconds"],
            meta["scores"],
        )
        last = np.array(meta["last"])
        online.load_state_dict(under("network.", tensors))
        target.load_state_dict(under("target.", tensors))
        restore_optimiser(optimiser, under("optimiser.", tensors))
        surveys.restore(meta["lanes"])
        watched = meta["demonstrations"]
    else:
        watched = [str(file) for file in _demonstration_files(config)]
        if config.start_from:
            _warm_start(online, config.start_from)
        if watched:
            _pretrain(
                online, Demonstrations.load([Path(file) for file in watched]), z, config, report
            )
        target.load_state_dict(online.state_dict())
    expert = (
        Demonstrations.load([Path(file) for file in watched])
        if watched and config.demonstration_weight
        else None
    )
    memory = ReplayConfig(
        config.lanes,
        config.n_uavs,
        config.side,
        config.steps,
        config.capacity,
        config.checkpoint_steps,
    )
    replay = Replay(folder / "replay", memory, step)
    (folder / "config.json").write_text(json.dumps(asdict(config), indent=2, default=str))
    contexts = autocast(config.bf16)
    begun, earlier = time.monotonic(), seconds
    recent: dict[str, list[float]] = {
        "loss": [],
        "q": [],
        "return": [],
        "rmse_db": [],
        "agreement": [],
    }
    saved = step

    def save() -> None:
        replay.flush()
        parts = {
            "network": online.state_dict(),
            "target": target.state_dict(),
            "optimiser": optimiser_tensors(optimiser),
        }
        tensors = {
            f"{name}.{k}": v.clone() for name, state in parts.items() for k, v in state.items()
        }
        meta = {
            "step": step,
            "updates": updates,
            "seconds": seconds,
            "scores": scores,
            "last": last.tolist(),
        }
        meta["demonstrations"] = (
            watched  # the same ones when the run goes on, whatever was flown since
        )
        plain = json.loads(json.dumps(asdict(config), default=str))
        save_checkpoint(path, tensors, {**meta, "lanes": surveys.lanes_state(), "config": plain})

    logged, logged_at = step, begun
    while step < config.total_steps and time.monotonic() - begun < config.max_seconds:
        replay.remember(surveys, last)
        moves, q = _explored(
            online,
            surveys,
            last,
            z,
            config,
            np.random.default_rng([config.seed, 1, step]),
            contexts,
        )
        held = surveys.cells.copy()
        result = surveys.step(moves)
        replay.complete(moves, result.reward, result.ended)
        last = _last_moves(held, surveys.cells, last, result.ended)
        recent["q"].append(float(q.mean()))
        recent["return"] += result.returns[result.ended].tolist()
        recent["rmse_db"] += result.rmse_db[result.ended].tolist()
        step += 1
        if (
            step % config.learn_every == 0
            and len(replay) >= config.warmup
            and replay.written > config.n_steps
        ):
            rng = np.random.default_rng([config.seed, 2, updates])
            batch = replay.sample(rng, config.batch_size, config.n_steps, config.reward.discount)
            symmetry = int(rng.integers(8)) if config.augment else 0
            loss, agreed = _learned(
                online, target, optimiser, batch, z, config, symmetry, contexts, expert, rng
            )
            recent["loss"].append(loss)
            if expert is not None:
                recent["agreement"].append(agreed)
            updates += 1
            if updates % config.target_every == 0:
                target.load_state_dict(online.state_dict())
        if step % config.log_steps == 0:
            now = time.monotonic()
            seconds = earlier + now - begun
            rate = (step - logged) * config.lanes / max(now - logged_at, 1e-9)
            logged, logged_at = step, now
            scores = {key: round(float(np.mean(v)), 4) for key, v in recent.items() if v}
            line = {
                "step": step,
                "updates": updates,
                "seconds": round(seconds, 1),
                **scores,
                "epsilon": config.exploration,
                "joint_steps_per_second": round(rate, 1),
                "transitions": len(replay),
            }
            with (folder / "log.jsonl").open("a") as log:
                log.write(json.dumps(line) + "\n")
            report(line)
            for values in recent.values():
                values.clear()
        if step - saved >= config.checkpoint_steps:
            save()
            saved = step
    seconds = earlier + time.monotonic() - begun
    save()
    return DqnResult(step, updates, seconds, scores, path)


def _explored(
    network: nn.Module,
    surveys: SurveyBatch,
    last: Moves,
    z: Tensor,
    config: DqnConfig,
    rng: np.random.Generator,
    contexts: Callable[[], Any],
) -> tuple[Moves, Moves]:
    """ε-greedy moves ``[survey, uav]`` and the value of the best move."""
    lanes, n = last.shape
    which, uav = np.repeat(np.arange(lanes), n), np.tile(np.arange(n), lanes)
    seen = Seen(
        mean=surveys.mean[which],
        std=surveys.std[which],
        height=surveys.height[which],
        flyable=surveys.flyable[which],
        cells=surveys.cells[which],
        uav=uav,
        last=last.ravel(),
        left=config.steps - surveys.steps_flown[which],
    )
    masks = surveys.masks().reshape(-1, 4)
    with torch.inference_mode(), contexts():
        logits = network(*network.inputs(seen))  # type: ignore[operator]
    q = expected(logits, z)
    best = masked_argmax(q, torch.from_numpy(masks)).numpy()
    legal = np.argmax(masks * (0.5 + rng.random(masks.shape)), axis=1)
    moves = np.where(rng.random(len(best)) < config.exploration, legal, best)
    return moves.reshape(lanes, n), q.numpy()[np.arange(len(best)), best]


def _learned(
    online: nn.Module,
    target: nn.Module,
    optimiser: torch.optim.Optimizer,
    batch: Transitions,
    z: Tensor,
    config: DqnConfig,
    symmetry: int,
    contexts: Callable[[], Any],
    expert: Demonstrations | None,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """One update; the temporal-difference loss, and the share of the expert's moves that the
    network makes."""
    turned = turned_moves(symmetry)
    mask = torch.from_numpy(batch.mask[:, np.argsort(turned)])
    with torch.no_grad(), contexts():
        then = online.inputs(batch.then, symmetry)  # type: ignore[operator]
        logits = target(*then)
        judge = online(*then) if config.double else logits
    with torch.no_grad():
        best = masked_argmax(expected(judge, z), mask)
        probability = torch.softmax(logits[torch.arange(len(best)), best], dim=-1)
        goal = projected(
            probability, torch.from_numpy(batch.reward), torch.from_numpy(batch.discount), z
        )
    with contexts():
        logits = online(*online.inputs(batch.now, symmetry))  # type: ignore[operator]
    loss = total = cross_entropy(logits, torch.from_numpy(turned[batch.move]), goal).mean()
    agreed = torch.zeros(())
    if expert is not None:
        entropy, agreed = expert_loss(
            online, expert, rng, config.batch_size, symmetry, _preference(z, config)
        )
        total = loss + config.demonstration_weight * entropy
    optimiser.zero_grad(set_to_none=True)
    total.backward()
    optimiser.step()
    return float(loss.detach()), float(agreed)


def _preference(z: Tensor, config: DqnConfig) -> Callable[[Tensor], Tensor]:
    """Logits of the moves: their values in units of τ."""
    return lambda logits: expected(logits, z) / config.temperature


def _demonstration_files(config: DqnConfig) -> list[Path]:
    if not config.demonstrations:
        return []
    folders = (
        Path(config.demonstrations),
        runs_folder() / config.demonstrations / "demonstrations",
    )
    files = next((found for folder in folders if (found := sorted(folder.glob("*.npz")))), [])
    if not files:
        raise InputError(
            f"no demonstrations in {config.demonstrations}; make some with: skygain train policy "
            "--recipe imitation --data CITIES.zarr.zip"
        )
    return files


def _pretrain(
    network: nn.Module,
    expert: Demonstrations,
    z: Tensor,
    config: DqnConfig,
    report: Callable[[dict[str, Any]], None],
) -> None:
    """Updates on demonstrations alone; a run killed here begins again."""
    optimiser = torch.optim.Adam(
        network.parameters(), 10 * config.learning_rate, eps=config.adam_epsilon
    )
    agreements = []
    for k in range(config.pretraining):
        rng = np.random.default_rng([config.seed, 3, k])
        symmetry = int(rng.integers(8)) if config.augment else 0
        loss, agreed = expert_loss(
            network, expert, rng, config.batch_size, symmetry, _preference(z, config)
        )
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        agreements.append(float(agreed))
        if (k + 1) % config.log_steps == 0:
            report(
                {
                    "pretraining": k + 1,
                    "of": config.pretraining,
                    "agreement": round(float(np.mean(agreements)), 4),
                }
            )
            agreements.clear()


def _last_moves(held: Moves, cells: Moves, last: Moves, ended: NDArray[np.bool_]) -> Moves:
    """``[survey, uav]`` moves just made, −1 where a new episode has begun; a UAV that hovered keeps
    its last one."""
    made = moves_of(cells - held)
    return np.where(ended[:, None], -1, np.where(made < 0, last, made))


def _warm_start(network: nn.Module, file: str) -> None:
    """Take over the tensors of a policy, or of a run's checkpoint, that have the same name and
    shape."""
    state = network.state_dict()
    path = policy_file(file)
    tensors = load_checkpoint(path)[0]
    tensors = under("network.", tensors) or dequantised(tensors)
    if not any(key in state and state[key].shape == value.shape for key, value in tensors.items()):
        raise InputError(
            f"nothing in {path} fits the network of this run; give the weights of a policy with "
            "the same kind of network"
        )
    network.load_state_dict(
        {
            key: tensors[key].float()
            if key in tensors and tensors[key].shape == value.shape
            else value
            for key, value in state.items()
        }
    )
